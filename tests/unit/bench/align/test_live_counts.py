"""Slices counted in whole periods: the same events as the decoder finds, up to where the last period ends."""

import numpy as np
import pytest

from bench.align.live_image import LiveSetting, count_slice, measure_signal, read_image, whole_periods
from bench.stations.station import load_station
from calib.events.event_image import make_images
from drivers.camera.raw_file import RawFile
from simulators.pixels.evt3_writer import Evt3Writer
from tests.support.live_slices import HEADER, bench, drive, seen, write_slice

SETTING = LiveSetting.of_station(load_station("simulated").value, frequency_hz=60.0, light_on=True)


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
    found = count_slice(raw_of(tmp_path / "slice.raw", t, origin_us), 4000.0)
    assert found.periods == 2
    assert found.counts[1, 1, 1] == found.counts.sum() == np.count_nonzero(t < 8000)
    assert found.statistics.events == len(t)


def test_a_slice_shorter_than_a_period_is_counted_as_a_whole(tmp_path):
    found = count_slice(raw_of(tmp_path / "slice.raw", [0, 900, 3000]), 4000.0)
    assert (found.periods, int(found.counts.sum())) == (0, 3)
    assert whole_periods(np.zeros(0, "<u2"), 4000.0) == (0, 0)


@pytest.mark.parametrize("waveform", ["square", "sine"])
def test_the_image_by_counts_is_that_of_the_events(tmp_path, waveform):
    """A wrong sign or a half of the period left out would lower the correlation."""
    path = write_slice(tmp_path / "slice.raw", seen(bench()), light=drive(waveform=waveform), periods=2)
    quick = read_image(path, SETTING, compare=False)
    raw = RawFile.open(path)
    events, triggers = raw.read()
    signal = measure_signal(events, triggers, 1, 60.0)
    size, window_us = (raw.width, raw.height), (0.0, float(events.t[-1]) + 1.0)
    exact = make_images(*events, size, signal.flicker, window_us=window_us).best()
    assert quick.kind == {"fired-per-edge": "fired-per-edge", "lock-in": "events-per-edge"}[exact.name]
    assert np.corrcoef(quick.values[::3, ::3].ravel(), exact.image[::3, ::3].ravel())[0, 1] > 0.97
    assert quick.signal.trigger_hz == pytest.approx(signal.trigger_hz)
    assert quick.signal.events == signal.events
    assert quick.signal.on_share == pytest.approx(signal.on_share)
    assert quick.signal.events_per_s == pytest.approx(signal.events_per_s, rel=0.01)
    assert quick.signal.event_hz is None
    assert read_image(path, SETTING, compare=True).signal.event_hz == pytest.approx(60.0, rel=0.02)
