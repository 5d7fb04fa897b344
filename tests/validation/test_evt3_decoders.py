"""Our EVT3 decoder beside the PyPI package ``evt3``, written by others: the same events from the same words."""

import numpy as np
import pytest

from drivers.camera.evt3 import Evt3Decoder
from drivers.camera.formats.event_conversion import convert
from drivers.camera.raw_file import RawFile
from simulators.pixels.evt3_writer import Evt3Writer

evt3 = pytest.importorskip("evt3", reason="the PyPI package evt3 is not built for this platform")

HEADER = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% geometry 1280x720\n% end\n"


def assert_same(path):
    """Both decoders read the file alike; returns how many events and triggers it has."""
    events, triggers = RawFile.open(path).read()
    theirs, their_triggers = evt3.decode_file_with_triggers(str(path))
    for name, ours in zip(("t", "x", "y", "p"), events, strict=True):
        assert np.array_equal(ours, getattr(theirs, name)), name
    for name, ours in zip(("timestamp", "value", "id"), triggers, strict=True):
        assert np.array_equal(ours, getattr(their_triggers, name)), name
    return len(events.t), len(triggers.t)


def sensor_words(seed, bursts, *, start_us):
    """Words as a busy IMX636 sends them: rows of singles and vectors, counters, triggers, clock words."""
    rng = np.random.default_rng(seed)
    words: list[int] = []
    t, ticked = start_us, -1
    for _ in range(bursts):
        t += int(rng.integers(1, 60))
        for tick in range(max(ticked + 1, t // 16), t // 16 + 1):
            words += [0x8000 | (tick >> 8 & 0xFFF), 0x6000 | (tick << 4 & 0xFFF)]
        ticked = t // 16
        words += [0x6000 | (t & 0xFFF), int(rng.integers(720))]
        polarity = int(rng.integers(2)) << 11
        match rng.integers(10):
            case 0:
                words.append(0xA000 | int(rng.integers(2)))
            case 1:
                count = int(rng.integers(1 << 20))
                words += [0xE014, 0xF000 | count & 0xFFF, 0xF000 | count >> 12, 0x7000]
            case 2 | 3 | 4 | 5:
                words.append(0x3000 | polarity | int(rng.integers(1280 - 96)))
                for _ in range(int(rng.integers(1, 4))):
                    bits = int(rng.integers(1 << 32))
                    words += [0x4000 | bits & 0xFFF, 0x4000 | bits >> 12 & 0xFFF, 0x5000 | bits >> 24]
            case _:
                words += [0x2000 | polarity | int(x) for x in np.sort(rng.integers(0, 1280, 5))]
    return np.array(words, "<u2")


@pytest.mark.parametrize("seed", range(5))
def test_generated_recordings_decode_alike(tmp_path, seed):
    path = tmp_path / "generated.raw"
    path.write_bytes(HEADER + sensor_words(seed, 20_000, start_us=seed * 3_000_000).tobytes())
    events, triggers = assert_same(path)
    assert events > 250_000
    assert triggers > 1000


def test_a_recording_over_the_wrap_of_the_clock_decodes_alike(tmp_path):
    path = tmp_path / "wrap.raw"
    path.write_bytes(HEADER + sensor_words(9, 20_000, start_us=(1 << 24) - 300_000).tobytes())
    assert_same(path)
    assert RawFile.open(path).scan().last_t_us > 1 << 24


@pytest.mark.parametrize("density", [0.001, 0.05, 0.5])
def test_what_the_simulated_sensor_writes_is_what_both_decoders_read(tmp_path, density):
    rng = np.random.default_rng(11)
    read, x = np.nonzero(rng.random((400, 1280)) < density)
    t, y, p = read * 37, (read * 7 % 720).astype(np.uint16), (read % 2).astype(np.uint8)
    edges = np.arange(0, t[-1], 1000)
    words = Evt3Writer().write(
        t,
        x.astype(np.uint16),
        y,
        p,
        until_us=int(t[-1]) + 1000,
        trigger_t=edges,
        trigger_value=(edges // 1000 % 2).astype(np.uint8),
    )
    path = tmp_path / "simulated.raw"
    path.write_bytes(HEADER + words.tobytes())
    assert assert_same(path) == (len(t), len(edges))
    decoded = RawFile.open(path).read()[0]
    assert all(np.array_equal(ours, theirs) for ours, theirs in zip(decoded, (t, x, y, p), strict=True))
    assert RawFile.open(path).scan().mismatched_windows == 0


def test_the_real_recording_decodes_alike_and_has_the_published_counts(evk4_recording):
    path = evk4_recording
    assert assert_same(path) == (82_469, 2)


def test_the_real_recording_accounts_for_its_events_and_its_trigger_pulse(evk4_recording):
    recording = RawFile.open(evk4_recording)
    scan = recording.scan()
    triggers = recording.triggers()
    assert scan.rate_controller_in == scan.rate_controller_out == 82_460
    assert (scan.gap_count, scan.truncated) == (0, False)
    assert (scan.lost_events, scan.mismatched_windows) == (0, 0)
    assert triggers.value.tolist() == [0, 1]
    assert int(triggers.t[1] - triggers.t[0]) == 2000
    assert scan.duration_s == pytest.approx(1.25, abs=0.01)


def test_a_recording_converted_from_events_is_read_alike(evk4_recording, tmp_path):
    """Out of the recording, through a file of arrays, and back into words that we made ourselves."""
    source = evk4_recording
    convert(source, tmp_path / "events.npz", "numpy")
    convert(tmp_path / "events.npz", tmp_path / "again.raw", "raw")
    assert assert_same(tmp_path / "again.raw") == (82_469, 2)
    for ours, theirs in zip(
        RawFile.open(tmp_path / "again.raw").read(), RawFile.open(source).read(), strict=True
    ):
        assert all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))


@pytest.mark.parametrize("reports", [1, 2, 7, 40])
def test_whole_windows_lost_are_counted_and_their_events_at_least(evk4_recording, tmp_path, reports):
    """A stretch of the real recording is cut out, with the sensor's own reports in it."""
    whole = evk4_recording.read_bytes()
    start = RawFile.open(evk4_recording).raw_header.size_bytes
    words = np.frombuffer(whole, "<u2", offset=start)
    reported = np.flatnonzero(words == 0xE016)
    clocks = np.flatnonzero(words >> 12 == 0x8)
    begin, end = clocks[np.searchsorted(clocks, reported[[1000, 1000 + reports]])]
    path = tmp_path / "lossy.raw"
    path.write_bytes(whole[:start] + words[:begin].tobytes() + words[end:].tobytes())
    scan = RawFile.open(path).scan()
    lost = 82_469 - scan.events
    assert lost > 5 * reports
    assert scan.missing_windows == reports
    assert scan.lost_events <= lost
    messages = " ".join(scan.loss_messages())
    assert f"{reports} event count reports of the sensor are missing" in messages
    assert f"at least {scan.lost_events} events" in messages


@pytest.mark.parametrize("seed", range(4))
def test_no_report_is_missed_where_bursts_are_followed_by_silence(seed):
    """Flicker in the dark: the clock says nothing but TIME_HIGH for up to milliseconds."""
    rng = np.random.default_rng(seed)
    bursts = np.cumsum(rng.integers(1, 3000, 60))
    t = np.sort(np.concatenate([at + rng.integers(0, 40, 30) for at in bursts]))
    x, y = rng.integers(0, 640, t.size).astype(np.uint16), rng.integers(0, 360, t.size).astype(np.uint16)
    p = np.zeros(t.size, np.uint8)
    until_us = int(t[-1]) // 16 * 16 + 3200
    words = Evt3Writer(width=640, height=360).write(t, x, y, p, until_us=until_us)
    decoder = Evt3Decoder(640, 360)
    for part in np.split(words, np.sort(rng.integers(0, words.size, 5))):
        decoder.tally(part)
    tally = decoder.statistics()
    assert (tally.events, tally.mismatched_windows, tally.missing_windows) == (t.size, 0, 0)
