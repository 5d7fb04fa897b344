"""Blocks decoded in several threads give what one thread gives, whatever the stream holds and wherever it is cut."""

import errno
import io
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera import evt3_threads, raw_file
from drivers.camera.evt3 import Evt3Decoder
from drivers.camera.evt3_place import guess_place
from drivers.camera.growing_events import GrowingEvents
from drivers.camera.raw_file import RawFile
from drivers.errors import RecordingCorrupt, RecordingFileError
from tests.unit.drivers.evt3_words import (
    HEIGHT,
    WIDTH,
    base,
    decode,
    event,
    high,
    low,
    row,
    rows,
    vector8,
    vector12,
)
from tests.unit.drivers.test_evt3_streams import sparse_words, streams
from tests.unit.drivers.test_raw_file import HEADER


def in_threads(words, bounds, threads=2, expected=0):
    """Events and triggers of a stream, decoded in threads in blocks that end at bounds."""
    events = GrowingEvents(expected)

    def read(buffer, first_byte):
        begin = first_byte // 2
        end = next((bound for bound in sorted(bounds) if bound > begin), begin)
        some = words[begin : min(end, begin + len(buffer))]
        buffer[: len(some)] = some
        return len(some)

    found = evt3_threads.decode_in_threads(Evt3Decoder(WIDTH, HEIGHT), read, events, threads, len(words))
    return rows(events.finished()), [edge for some in found for edge in rows(some)]


@settings(max_examples=40)
@given(streams(), st.lists(st.integers(0, 200), max_size=6))
def test_where_a_stream_is_cut_into_blocks_does_not_matter(stream, cuts):
    words, events, triggers, _ = stream
    bounds = [0, *sorted(min(cut, len(words)) for cut in cuts), len(words)]
    assert in_threads(np.array(words, np.uint16), bounds) == (events, triggers)
    assert in_threads(np.array(words, np.uint16), bounds, expected=len(events)) == (events, triggers)


@pytest.mark.parametrize("seed", range(3))
def test_long_streams_decode_as_in_one_thread(seed):
    words = sparse_words(np.random.default_rng(seed), 6000)
    expected = decode(*words)[:2]
    assert in_threads(words, [*range(0, len(words), 700), len(words)]) == expected
    assert in_threads(words, [*range(0, len(words), 90), len(words)], threads=3) == expected


def test_a_wrong_guess_costs_time_only(monkeypatch):
    words = sparse_words(np.random.default_rng(9), 3000)
    wrong = guess_place(words, Evt3Decoder(WIDTH, HEIGHT).place)
    monkeypatch.setattr(
        evt3_threads, "guess_place", lambda *_: wrong._replace(y=700, base=3, t=5, wraps_us=1 << 24)
    )
    assert in_threads(words, [*range(0, len(words), 500), len(words)]) == decode(*words)[:2]


@settings(max_examples=60)
@given(streams(), st.integers(0, 300))
def test_a_guess_is_right_or_there_is_none(stream, end):
    words = np.array(stream[0], np.uint16)[:end]
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    guess = guess_place(words, decoder.place)
    decoder.tally(words)
    place = decoder.place  # these streams may wrap within a block, which no guess notices
    assert guess in (None, place._replace(wraps_us=0, t=place.t - place.wraps_us))


START = [high(5), low(9), row(3), base(8, 1)]


@pytest.mark.parametrize(
    ("more", "t", "next_column"),
    [
        ([], 5 << 12 | 9, 8),
        ([high(5)], 5 << 12 | 9, 8),
        ([high(6)], 6 << 12, 8),
        ([high(6), high(6)], 6 << 12, 8),
        ([high(6), low(4), high(6)], 6 << 12 | 4, 8),
        ([vector12(1), vector8(0)], 5 << 12 | 9, 28),
        ([low(11), event(5), row(2)], 5 << 12 | 11, 8),
        ([high(3)], (1 << 24) + (3 << 12), 8),
    ],
)
def test_the_place_after_words_is_read_from_them(more, t, next_column):
    if more == [high(3)]:  # the clock wraps only if it steps back by half of its range
        words = np.array([high(4000), *START[1:], *more], np.uint16)
    else:
        words = np.array([*START, *more], np.uint16)
    decoder = Evt3Decoder(WIDTH, HEIGHT)
    decoder.tally(words[:1])
    place = guess_place(words, decoder.place)
    decoder.tally(words[1:])
    assert place == decoder.place
    assert (place.t, place.base) == (t, next_column)


@pytest.fixture
def large(tmp_path, monkeypatch):
    """Writes a RAW file that is decoded in two threads, in blocks of 500 words."""
    monkeypatch.setattr(raw_file, "threads_for", lambda _: 2)
    monkeypatch.setattr(evt3_threads, "LEAST_BLOCK_WORDS", 500)
    monkeypatch.setattr(evt3_threads, "MOST_BLOCK_WORDS", 500)

    def write(words):
        path = tmp_path / "large.raw"
        path.write_bytes(HEADER + np.asarray(words, "<u2").tobytes())
        return RawFile.open(path)

    return write


def test_a_large_file_is_read_in_threads(large):
    words = sparse_words(np.random.default_rng(4), 8000)
    expected, edges, _ = decode(*words)
    recording = large(words)
    events, triggers = recording.read()
    assert (rows(events), rows(triggers)) == (expected, edges)
    pieces = list(recording.pieces(max_events=100))
    assert [one for piece in pieces for one in rows(piece[0])] == expected
    assert [one for piece in pieces for one in rows(piece[1])] == edges
    assert max(len(piece[0].t) for piece in pieces) <= 100


def test_events_without_a_place_leave_no_holes(large):
    others = [0x1000 | 5, *[event(k) for k in range(700)]]
    words = np.array([*START, event(1), *others, row(4), event(2), *others, row(5), event(3)], np.uint16)
    assert rows(large(words).read()[0]) == decode(*words)[0]


def test_a_malformed_word_is_found_at_the_same_byte_after_the_same_events(large):
    words = sparse_words(np.random.default_rng(5), 4000)
    words[3210] = 0x9000
    recording = large(words)
    found = []
    with pytest.raises(RecordingCorrupt) as caught:
        found.extend(one for events in recording.chunks() for one in rows(events))
    assert caught.value.offset == len(HEADER) + 2 * 3210
    assert found == decode(*words[:3210])[0]
    with pytest.raises(RecordingCorrupt) as again:
        recording.read()
    assert again.value.offset == caught.value.offset


def test_a_file_that_cannot_be_read_on_ends_all_threads(large, monkeypatch):
    words = sparse_words(np.random.default_rng(6), 4000)
    recording, reads = large(words), []

    def read_words(file, room):
        reads.append(threading.current_thread())
        if len(reads) == 3:
            raise OSError(errno.EIO, "Input/output error")
        return file.readinto(memoryview(room).cast("B")) // 2

    monkeypatch.setattr(raw_file, "_read_words", read_words)
    with pytest.raises(RecordingFileError, match="Input/output error"):
        recording.read()
    assert len(reads) == 3
    assert not any(thread.name.startswith("evt3") for thread in threading.enumerate())


def test_a_read_that_returns_less_than_asked_is_continued():
    class Slow(io.RawIOBase):
        def __init__(self):
            self.left = bytearray(range(7))

        def readinto(self, room):
            part, self.left = self.left[:3], self.left[3:]
            room[: len(part)] = part
            return len(part)

    room = np.zeros(8, np.uint16)
    assert raw_file._read_words(Slow(), room) == 3
    assert room.tobytes()[:7] == bytes(range(7))


def test_few_or_many_threads_by_the_size_of_the_file():
    assert evt3_threads.threads_for(1000) == 1
    assert 1 <= evt3_threads.threads_for(1 << 30) <= evt3_threads.MOST_THREADS
