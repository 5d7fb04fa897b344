"""The compression of Metavision's HDF5 files."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera.event_arrays import Events
from drivers.camera.formats.ecf import MAX_EVENTS, decode, encode


def chunk(t, x, y, p):
    return Events(np.array(t, "i8"), np.array(x, "u2"), np.array(y, "u2"), np.array(p, "u1"))


def assert_equal(a, b):
    for name, ours, theirs in zip("txyp", a, b, strict=True):
        assert ours.dtype == theirs.dtype
        assert np.array_equal(ours, theirs), name


def style(data):
    return data[0] & 3


def test_one_event_reads_as_its_bytes_say():
    data = encode(chunk([1_000_000], [3], [5], [1]))
    assert data[:12] == bytes([1 << 2 | 0]) + bytes(3) + (1_000_000).to_bytes(8, "little")
    assert data[12:] == b"\x01" + struct.pack("<HH", 5 << 5 | 1, 3 << 5) + b"\x81"


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 14, 15, 30, 31, 126, 127, 128, 16384, MAX_EVENTS])
def test_runs_of_every_length_come_back(n):
    events = chunk([7] * n, [9] * n, [11] * n, [1] * n)
    assert_equal(decode(encode(events)), events)


@pytest.mark.parametrize("step", [1, 14, 15, 16, 255, 256, 10**6, 2**40])
def test_time_steps_of_every_size_come_back(step):
    events = chunk(np.arange(50) * step, range(50), range(50), [0] * 50)
    assert_equal(decode(encode(events)), events)


@pytest.mark.parametrize(
    ("few_rows", "packed_as", "bytes_each"),
    [pytest.param(False, 2, 4.01, id="24 bits, a time"), pytest.param(True, 1, 2.6, id="few rows: 12 bits")],
)
def test_scattered_events_are_packed_by_their_rows(few_rows, packed_as, bytes_each):
    rng = np.random.default_rng(1)
    y = np.arange(4001) // 50 if few_rows else rng.integers(0, 720, 4001)
    events = chunk(np.arange(4001), rng.integers(0, 1280, 4001), y, rng.integers(0, 2, 4001))
    data = encode(events)
    assert style(data) == packed_as
    assert len(data) < bytes_each * 4001
    assert_equal(decode(data), events)


def test_rows_of_neighbours_are_run_lengths():
    events = chunk([5] * 4000, np.tile(np.arange(1000), 4), np.repeat(range(4), 1000), [1] * 4000)
    data = encode(events)
    assert style(data) == 0
    assert len(data) < 0.4 * 4000
    assert_equal(decode(data), events)


def test_a_time_that_steps_back_becomes_its_predecessors():
    assert decode(encode(chunk([10, 7, 12], [0, 1, 2], [0, 0, 0], [0, 0, 0]))).t.tolist() == [10, 10, 12]


@st.composite
def chunks(draw):
    n = draw(st.integers(1, 60))
    steps = draw(st.lists(st.sampled_from([0, 0, 0, 1, 3, 20, 5000]), min_size=n, max_size=n))
    x = draw(st.lists(st.integers(0, 2047) | st.integers(100, 106), min_size=n, max_size=n))
    y = draw(st.lists(st.integers(0, 2047) | st.just(3), min_size=n, max_size=n))
    p = draw(st.lists(st.integers(0, 1), min_size=n, max_size=n))
    t = draw(st.integers(0, 2**40)) + np.cumsum(steps)
    if draw(st.booleans()):
        x = sorted(x)
    return chunk(t, x, y, p)


@given(chunks())
def test_every_chunk_comes_back(events):
    assert_equal(decode(encode(events)), events)


@given(chunks(), st.integers(0, 400))
def test_a_chunk_that_was_cut_is_refused(events, kept):
    data = encode(events)
    if kept < len(data):
        with pytest.raises(ValueError, match="chunk"):
            decode(data[:kept])


@given(st.binary(max_size=200), st.integers(0, 2**18))
def test_garbage_is_refused_or_gives_the_events_it_promises(data, info):
    data = info.to_bytes(4, "little") + data
    try:
        events = decode(data)
    except ValueError:
        return
    assert len(events.t) == info >> 2
    assert (events.x <= 2047 + 5).all()
    assert (events.p <= 1).all()


@pytest.mark.parametrize(
    "events",
    [
        chunk([], [], [], []),
        chunk([0] * (MAX_EVENTS + 1), [0] * (MAX_EVENTS + 1), [0] * (MAX_EVENTS + 1), [0] * (MAX_EVENTS + 1)),
        chunk([0], [2048], [0], [0]),
        chunk([0], [0], [2048], [0]),
    ],
)
def test_what_a_chunk_cannot_hold_is_refused(events):
    with pytest.raises(ValueError, match=r"chunk|column or row"):
        encode(events)
