"""Arrays that grow while a stream is decoded hold the same events, whatever their length was at first."""

import numpy as np
import pytest

from drivers.camera import evt3_threads, raw_file
from drivers.camera.growing_events import GrowingEvents
from drivers.camera.raw_file import RawFile
from tests.unit.drivers.evt3_words import decode, rows
from tests.unit.drivers.test_evt3_streams import sparse_words
from tests.unit.drivers.test_raw_file import HEADER


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("expected", [0, 700, 5000])
def test_a_wrong_estimate_changes_nothing(tmp_path, monkeypatch, threads, expected):
    words = sparse_words(np.random.default_rng(threads), 8000)
    path = tmp_path / "file.raw"
    path.write_bytes(HEADER + words.astype("<u2").tobytes())
    monkeypatch.setattr(raw_file, "threads_for", lambda _: threads)
    monkeypatch.setattr(raw_file, "BLOCK_WORDS", 500)
    monkeypatch.setattr(evt3_threads, "LEAST_BLOCK_WORDS", 500)
    monkeypatch.setattr(evt3_threads, "MOST_BLOCK_WORDS", 500)
    monkeypatch.setattr(RawFile, "_expected_events", lambda *_: expected)
    events, triggers = RawFile.open(path).read()
    assert (rows(events), rows(triggers)) == decode(*words)[:2]


def test_the_estimate_is_near_the_number_of_events(tmp_path, monkeypatch):
    monkeypatch.setattr(raw_file, "SAMPLE_WORDS", 100)
    monkeypatch.setattr(raw_file, "SPARE", 0)
    words = sparse_words(np.random.default_rng(1), 20_000)
    path = tmp_path / "file.raw"
    path.write_bytes(HEADER + words.astype("<u2").tobytes() + b"\0")
    recording = RawFile.open(path)
    count = len(recording.read()[0].t)
    assert recording._expected_events(path.stat().st_size) == pytest.approx(1.02 * count, rel=0.1)


def block(room, values):
    """Fill the first places of a room, and return them."""
    part = room.part(0, len(values))
    for field in part:
        field[:] = values
    return part


def test_blocks_that_found_no_room_follow_those_before_them():
    events = GrowingEvents(3)
    rooms = [events.room(2), events.room(2), events.room(2)]
    parts = [block(room, [2 * k, 2 * k + 1]) for k, room in enumerate(rooms)]
    events.add(parts[0])
    events.add(parts[1])
    late = events.room(3)
    last = block(late, [6, 7, 8])
    events.add(parts[2])
    events.add(last)
    found = events.finished()
    assert [field.tolist() for field in found] == [list(range(9))] * 4


def test_much_empty_room_is_given_back():
    events = GrowingEvents(1_000_000)
    events.add(block(events.room(10), range(10)))
    found = events.finished()
    assert found.t.tolist() == list(range(10))
    assert len(found.t.base if found.t.base is not None else found.t) == 10
