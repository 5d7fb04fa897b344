"""What align measures from slices: figures of the signal, whole periods, and the process that does it."""

import os
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from running import python

from bench.base import memory_folder
from bench.base.errors import BenchError
from bench.extras.pages.align import live_loop as slice_folder
from bench.extras.pages.align.live_figures import LiveMeter, LiveSlice
from bench.extras.pages.align.live_image import (
    CountedSlice,
    LiveSetting,
    count_slice,
    measure_signal,
    read_image,
    whole_periods,
)
from bench.extras.pages.align.meter import MeterProcess
from bench.stations.station import load_station
from calib import flicker_from_triggers, make_images
from drivers.camera.event_arrays import Triggers
from drivers.camera.evt3 import StreamStatistics
from drivers.camera.raw_file import RawFile
from simulators.pixels.evt3_writer import Evt3Writer
from tests.support.live_slices import HEADER, bench, drive, seen, write_slice

# ---------------------------------------------------------------- the process

SETTING = LiveSetting.of_station(load_station("simulated").value)


def test_the_process_measures_survives_a_kill_and_ends(tmp_path, children):
    part = LiveSlice(tmp_path / "nothing.raw", 1.5)
    with closing(MeterProcess()) as meter:
        jpeg, figures = meter.measure(part, SETTING)
        jpeg_here, here = LiveMeter().measure(part, SETTING)
        assert jpeg == jpeg_here
        assert figures.recording_faults == here.recording_faults != ()
        first = children[-1].pid
        environment = Path(f"/proc/{first}/environ")
        if environment.exists():  # on Linux
            assert b"OPENBLAS_NUM_THREADS=1" in environment.read_bytes().split(b"\0")
        os.kill(first, 9)
        with pytest.raises(BenchError, match="ended by itself"):
            meter.measure(part, SETTING)
        assert meter.measure(part, SETTING)[1].time_s == 1.5
        assert [child.pid == first for child in children] == [True, False]
    assert all(child.poll() is not None for child in children)
    began_s = time.monotonic()
    with pytest.raises(BenchError):
        meter.measure(part, SETTING)
    assert time.monotonic() - began_s < 1


# ---------------------------------------------------------------- the folder of slices


def test_a_folder_is_private_and_those_of_dead_processes_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(memory_folder, "MEMORY", tmp_path)
    ended = python("-c", "import os; print(os.getpid())")
    left = tmp_path / f"starbench-align-{ended.stdout.strip()}-abc"
    living = tmp_path / f"starbench-align-{os.getppid()}-abc"
    other = tmp_path / "starbench-align-notes"
    for folder in (left, living, other):
        folder.mkdir()
    made = slice_folder.make_slice_folder()
    assert made.parent == tmp_path
    assert made.stat().st_mode & 0o077 == 0
    assert not left.exists()
    assert living.exists()
    assert other.exists()


def test_without_room_in_memory_the_folder_is_on_the_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(memory_folder, "MEMORY", tmp_path / "none")
    monkeypatch.setattr(memory_folder.tempfile, "gettempdir", lambda: str(tmp_path))
    assert slice_folder.make_slice_folder().parent == tmp_path


# ---------------------------------------------------------------- whole periods

TIMING = LiveSetting.of_station(load_station("simulated").value, frequency_hz=60.0, light_on=True)


def raw_of(path, t, origin_us=0):
    """Write ON events of one pixel at some times."""
    t = np.asarray(t, np.int64) + origin_us
    ones = np.ones(len(t))
    words = Evt3Writer(origin_us).write(
        t, ones.astype(np.uint16), ones.astype(np.uint16), ones.astype(np.uint8), until_us=int(t[-1]) + 1
    )
    path.write_bytes(HEADER + words.astype("<u2").tobytes())
    return RawFile.open(path)


@pytest.mark.parametrize("origin_us", [0, 4096 * 4095])  # the clock wraps in the second slice
def test_events_of_whole_periods_are_counted(tmp_path, origin_us):
    t = np.arange(0, 10_500, 50)
    counted = count_slice(raw_of(tmp_path / "slice.raw", t, origin_us), 4000.0)
    assert counted.periods == 2
    assert counted.counts[1, 1, 1] == counted.counts.sum() == np.count_nonzero(t < 8000)
    assert counted.statistics.events == len(t)


def test_a_slice_shorter_than_a_period_is_counted_as_a_whole(tmp_path):
    counted = count_slice(raw_of(tmp_path / "slice.raw", [0, 900, 3000]), 4000.0)
    assert (counted.periods, int(counted.counts.sum())) == (0, 3)
    assert whole_periods(np.zeros(0, "<u2"), 4000.0) == (0, 0)


@pytest.mark.parametrize("waveform", ["square", "sine"])
def test_the_image_by_counts_is_that_of_the_events(tmp_path, waveform):
    """A wrong sign or a half of the period left out would lower the correlation."""
    path = write_slice(tmp_path / "slice.raw", seen(bench()), light=drive(waveform=waveform), periods=2)
    quick = read_image(path, TIMING)
    raw = RawFile.open(path)
    events, triggers = raw.read()
    size, window_us = (raw.width, raw.height), (0.0, float(events.t[-1]) + 1.0)
    flicker = flicker_from_triggers(triggers.t, triggers.value)
    exact = make_images(*events, size, flicker, window_us=window_us).best()
    assert np.corrcoef(quick.values[::3, ::3].ravel(), exact.image[::3, ::3].ravel())[0, 1] > 0.97
    assert quick.signal.trigger_hz == pytest.approx(flicker.frequency_hz)
    whole = events.p[events.t < 2e6 / 60.0]
    assert quick.signal.on_share == pytest.approx(np.mean(whole), abs=1e-3)
    assert quick.signal.events_per_s == pytest.approx(30.0 * len(whole), rel=1e-3)


# ---------------------------------------------------------------- the signal

PERIOD_US = 16_667


def counted(periods, triggers):
    """A slice of 600 events in each of some periods, 400 of them ON."""
    counts = np.array([200 * periods, 400 * periods], np.uint16).reshape(2, 1, 1)
    duration_us = periods * PERIOD_US
    statistics = StreamStatistics(
        600 * periods, 400 * periods, 0, 0, duration_us, None, None, 0, 0, 0, (), 0, 0
    )
    return CountedSlice(counts, periods, triggers, statistics)


def triggers_of(times_us, values):
    return Triggers(
        t=np.array(times_us, np.int64), id=np.zeros(len(times_us), np.uint8), value=np.array(values, np.uint8)
    )


def edges(count, jitter_us=0.0):
    """Rising and falling sync edges of some periods."""
    random = np.random.default_rng(5)
    up = 1000.0 + PERIOD_US * np.arange(count)
    t = np.column_stack([up, up + PERIOD_US / 2]).ravel() + random.normal(0.0, jitter_us, 2 * count)
    return triggers_of(t, np.tile([1, 0], count))


@pytest.mark.parametrize("begin_us", [0, 1500, 3500])
def test_the_rate_does_not_depend_on_where_in_a_period_a_slice_begins(tmp_path, begin_us):
    bursts = (4000 * np.arange(5)[:, None] + np.arange(0, 200, 10)).ravel()
    seen_us = bursts[(bursts >= begin_us) & (bursts < begin_us + 8800)] - begin_us
    raw = raw_of(tmp_path / "slice.raw", np.unique([0, *seen_us, 8800]))
    assert measure_signal(count_slice(raw, 4000.0), 250.0).events_per_s == pytest.approx(20 * 250, rel=0.03)


def test_the_jitter_of_the_sync_is_the_drawn_one():
    signal = measure_signal(counted(40, edges(40, jitter_us=25.0)), None)
    assert signal.jitter_us == pytest.approx(25.0, rel=0.25)


def test_missing_sync_edges_are_counted():
    some = edges(12)
    kept = [0, 1, 2, 3, 20, 21, 22, 23]
    signal = measure_signal(counted(12, triggers_of(some.t[kept], some.value[kept])), 60.0)
    assert (signal.triggers, signal.triggers_expected) == (4, 12)


def test_edges_without_a_period_are_named():
    odd = triggers_of([1000, 1700, 9000, 9800, 40_000, 41_000], [1, 0, 1, 0, 1, 0])
    assert measure_signal(counted(4, odd), 60.0).sync_fault
