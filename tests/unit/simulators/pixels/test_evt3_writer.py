"""EVT3 words: decoded word by word by a small reader that belongs to this test."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.errors import SimulationMisuse
from simulators.pixels.evt3_writer import Evt3Writer

DURATION_US = 6000


def read(words):
    """Decode words in plain Python, from the format's description: events, triggers, counters and TIME_HIGH times."""
    events, triggers, counters, highs = [], [], {0x14: [], 0x16: []}, []
    high, low, y, base, polarity, fresh, loops = None, None, None, None, None, False, 0
    i = 0
    while i < len(words):
        kind, value = int(words[i]) >> 12, int(words[i]) & 0xFFF
        if kind == 0x8:
            if high is not None and value < high:
                assert (high, value) == (0xFFF, 0), "TIME_HIGH steps by one"
                loops += 1
            assert high is None or (value - high) % 4096 in (0, 1), "TIME_HIGH steps by one"
            high, fresh = value, False
            highs.append((loops << 24) | (high << 12))
        elif kind == 0x6:
            low, fresh = value, True
        elif kind == 0xE:
            parts = [int(w) for w in words[i + 1 : i + 4]]
            assert [p >> 12 for p in parts] == [0xF, 0xF, 0x7]
            counters[value].append((parts[0] & 0xFFF) | (parts[1] & 0xFFF) << 12 | (parts[2] & 0xF) << 24)
            i += 3
        elif kind == 0x0:
            y = value & 0x7FF
        else:
            assert fresh, "a time stands before everything that has one"
            t = (loops << 24) | (high << 12) | low
            if kind == 0xA:
                triggers.append((t, value & 1, value >> 8))
            elif kind == 0x2:
                events.append((t, value & 0x7FF, y, value >> 11))
            elif kind == 0x3:
                base, polarity = value & 0x7FF, value >> 11
            elif kind in (0x4, 0x5):
                width = 12 if kind == 0x4 else 8
                assert value < 1 << width
                events += [(t, base + b, y, polarity) for b in range(width) if value >> b & 1]
                base += width
        i += 1
    return events, triggers, counters, highs


def random_stream(seed, n, start_us=0, density=1.0):
    """Row reads: monotone times, one row each, ON before OFF, left to right."""
    rng = np.random.default_rng(seed)
    rows = []
    for t in np.sort(rng.integers(start_us, start_us + DURATION_US, n)):
        y = rng.integers(720)
        for p in (1, 0):
            count = min(1280, rng.geometric(min(1.0, 0.2 / density)))
            first = rng.integers(0, 1280)
            x = np.unique(np.minimum(first + rng.integers(0, 3 * count, count), 1279))
            rows += [(t, xi, y, p) for xi in x]
    t, x, y, p = np.array(rows).T if rows else np.empty((4, 0))
    return t.astype(np.int64), x.astype(np.uint16), y.astype(np.uint16), p.astype(np.uint8)


def as_tuples(stream):
    return [tuple(int(v) for v in row) for row in zip(*stream, strict=True)]


@given(seed=st.integers(0, 10_000), n=st.integers(0, 60), density=st.floats(0.3, 30))
@settings(max_examples=60, deadline=None)
def test_every_event_comes_back_in_order(seed, n, density):
    stream = random_stream(seed, n, density=density)
    words = Evt3Writer().write(*stream, until_us=DURATION_US)
    events, _, _, _ = read(words)
    assert events == as_tuples(stream)


def test_time_goes_on_through_silence_and_starts_with_high_and_low():
    words = Evt3Writer().write(*random_stream(0, 0), until_us=10_000)
    assert words[0] >> 12 == 0x8
    assert words[1] >> 12 == 0x6
    _, _, _, highs = read(words)
    assert len(highs) == 10_000 // 16
    lows = [i for i, w in enumerate(words) if w >> 12 == 0x6]
    assert [int(words[i]) & 0xFFF for i in lows] == [t & 0xFFF for t in range(0, 10_000, 2000)]


def test_trigger_edges_keep_their_time_and_value():
    edges = np.array([0, 16, 17, 2000, 5999])
    values = np.array([1, 0, 1, 0, 1], np.uint8)
    words = Evt3Writer().write(*random_stream(1, 30), until_us=6000, trigger_t=edges, trigger_value=values)
    assert read(words)[1] == [(int(t), int(v), 0) for t, v in zip(edges, values, strict=True)]


@pytest.mark.parametrize(("width", "words_of_kinds"), [(1280, [0, 1, 80, 40]), (40, [8, 1, 2, 1])])
def test_dense_rows_are_sent_as_vectors_which_never_reach_beyond_the_sensor(width, words_of_kinds):
    row = np.full(width, 50), np.arange(width), np.full(width, 7), np.ones(width)
    stream = [a.astype(d) for a, d in zip(row, (np.int64, np.uint16, np.uint16, np.uint8), strict=True)]
    words = Evt3Writer(width=width, height=20).write(*stream, until_us=64)
    assert np.bincount(words >> 12, minlength=16)[0x2:0x6].tolist() == words_of_kinds
    assert read(words)[0] == as_tuples(stream)


@pytest.mark.parametrize(("t", "x", "y"), [(-1, 0, 0), (100, 0, 0), (5, 1280, 0), (5, 0, 720)])
def test_events_outside_the_slice_or_the_sensor_are_refused(t, x, y):
    event = np.array([t]), np.array([x], np.uint16), np.array([y], np.uint16), np.array([1], np.uint8)
    with pytest.raises(SimulationMisuse):
        Evt3Writer().write(*event, until_us=100)
