"""Files of events to files of events: the same events, whatever the way, and never half a file."""

import os
from datetime import UTC, datetime
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imported import import_events
from slow_cases import first_quick

from drivers.camera.event_arrays import MAX_TIME_US, Events, Triggers, empty_events, empty_triggers
from drivers.camera.evt3 import Evt3Decoder
from drivers.camera.formats.event_conversion import KINDS, Evt3Encoder, convert
from drivers.camera.raw_file import RawFile
from drivers.camera.raw_writer import new_file
from drivers.errors import NotARecording, RecordingFileError
from tests.support.made_event_files import drawn_stream, same

NOW = datetime(2026, 11, 20, 4, 5, 6, tzinfo=UTC)


ENDINGS = {"raw": ".raw", "metavision": ".hdf5", "hdf5": ".h5", "numpy": ".npz"}


WITH_EDGES = [kind for kind in KINDS if kind not in {"parquet", "csv"}]


@pytest.mark.parametrize("first", [kind for kind in WITH_EDGES if kind != "raw"])
@pytest.mark.parametrize("second", first_quick(WITH_EDGES))
def test_every_way_between_kinds_keeps_every_event_and_edge(raw, tmp_path, first, second):
    events, triggers = drawn_stream()
    between, end = tmp_path / f"between{ENDINGS[first]}", tmp_path / f"end{ENDINGS[second]}"
    convert(raw, between, first)
    summary = convert(between, end, second)
    assert (summary.events, summary.triggers, summary.moved_events) == (5000, 40, 0)
    if second == "raw":
        streams = RawFile.open(end).read()
    else:
        imported = import_events(end)
        streams = imported.events, imported.triggers
    assert same(streams[0], events)
    assert same(streams[1], triggers)


def test_csv_is_read_again_with_its_size_and_unit_of_times_and_names_what_it_leaves_out(raw, tmp_path):
    written = convert(raw, tmp_path / "pose.csv", "csv")
    assert (written.events, written.triggers, written.edges_left_out) == (5000, 0, 40)
    imported = import_events(tmp_path / "pose.csv")
    assert same(imported.events, drawn_stream()[0])
    assert (imported.width, imported.height) == (1280, 720)
    again = convert(tmp_path / "pose.csv", tmp_path / "again.npz", "numpy")
    assert not again.assumed


def test_a_converted_raw_file_says_so_and_keeps_whose_it_was(raw, tmp_path):
    convert(raw, tmp_path / "pose.hdf5", "metavision")
    convert(tmp_path / "pose.hdf5", tmp_path / "again.raw", "raw")
    again = RawFile.open(tmp_path / "again.raw")
    assert again.header["converted_from"].startswith("pose.hdf5;")
    assert (again.serial, again.width, again.height) == ("00051234", 1280, 720)
    assert (again.header["date"], again.header["sensor_name"]) == ("2026-03-01 12:00:00", "IMX636")
    assert again.scan().gap_count == 0


@settings(max_examples=30)
@given(
    st.lists(
        st.tuples(st.integers(0, 60_000_000), st.integers(0, 1279), st.integers(0, 719), st.integers(0, 1))
    ),
    st.lists(st.tuples(st.integers(0, 60_000_000), st.integers(0, 1), st.integers(0, 15))),
    st.integers(1, 50),
)
def test_what_is_encoded_in_pieces_is_decoded_the_same(rows, edges, piece):
    rows, edges = sorted(rows), sorted(edges)
    columns = [np.array(c) for c in zip(*rows, strict=True)] or [np.zeros(0)] * 4
    events = Events(*(c.astype(d) for c, d in zip(columns, ("i8", "u2", "u2", "u1"), strict=True)))
    columns = [np.array(c) for c in zip(*edges, strict=True)] or [np.zeros(0)] * 3
    triggers = Triggers(*(c.astype(d) for c, d in zip(columns, ("i8", "u1", "u1"), strict=True)))
    encoder, decoder = Evt3Encoder(), Evt3Decoder(1280, 720)
    words = [encoder.words(empty_events(0), triggers)] if not rows else []
    done = 0
    for begin in range(0, len(rows), piece):
        part = events.part(begin, begin + piece)
        until = int(np.searchsorted(triggers.t, part.t[-1], "right"))
        words.append(encoder.words(part, Triggers(*(field[done:until] for field in triggers))))
        done = until
    if rows:
        words.append(encoder.words(empty_events(0), Triggers(*(field[done:] for field in triggers))))
    pieces = [piece for part in words for piece in decoder.decode([part])]
    assert encoder.moved_events == 0
    assert all(
        np.array_equal(np.concatenate([getattr(e, name) for e, _ in pieces] or [[]]), getattr(events, name))
        for name in Events._fields
    )
    assert all(
        np.array_equal(np.concatenate([getattr(e, name) for _, e in pieces] or [[]]), getattr(triggers, name))
        for name in Triggers._fields
    )


def test_a_step_back_of_some_us_is_kept_and_a_longer_one_counted():
    t = np.array([10_000, 9_990, 8_000, 10_001], np.int64)
    flat = np.zeros(4, np.uint16)
    encoder = Evt3Encoder()
    words = encoder.words(Events(t, flat, flat, np.zeros(4, np.uint8)), empty_triggers(0))
    [(events, _)] = Evt3Decoder(1280, 720).decode([words])
    assert events.t.tolist() == [10_000, 9_990, 9_990, 10_001]
    assert encoder.moved_events == 1


@pytest.mark.parametrize("t", [-1, MAX_TIME_US])
def test_times_that_would_fill_the_disk_with_clock_words_are_refused(tmp_path, t):
    zero = np.zeros(1, np.uint16)
    np.savez(
        tmp_path / "a.npz", t=np.array([t]), x=zero, y=zero, p=zero, size=np.array([1280, 720]),
        trigger_t=np.zeros(0, int), trigger_value=np.zeros(0, int), trigger_id=np.zeros(0, int),
    )  # fmt: skip
    with pytest.raises(RecordingFileError, match="one day"):
        convert(tmp_path / "a.npz", tmp_path / "a.raw", "raw")
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def npz(path, size=(1280, 720), x=0, edge_us=5, value=0, channel=0):
    """One event and one edge, as another program may have written them."""
    edge = {"trigger_t": edge_us, "trigger_value": value, "trigger_id": channel}
    columns = {"t": 10, "x": x, "y": 0, "p": 1, **edge}
    np.savez(path, size=np.array(size), **{name: np.array([number]) for name, number in columns.items()})
    return path


@pytest.mark.parametrize(
    ("holds", "words"),
    [
        ({"size": (4000, 3000), "x": 3000}, "a sensor of 4000 x 3000 px"),
        ({"size": (1280, 2049)}, "a sensor of 1280 x 2049 px"),
        ({"value": 2}, "a trigger's value of 2"),
        ({"channel": 16}, "a trigger's id of 16"),
    ],
)
def test_what_evt3_has_no_bits_for_is_refused_not_cut_and_kept_in_hdf5(tmp_path, holds, words):
    with pytest.raises(RecordingFileError, match=f"EVT3 cannot .*{words}"):
        convert(npz(tmp_path / "a.npz", **holds), tmp_path / "out", "raw")
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]
    convert(tmp_path / "a.npz", tmp_path / "a.h5", "hdf5")
    ours, theirs = import_events(tmp_path / "a.h5"), import_events(tmp_path / "a.npz")
    assert same((*ours.events, *ours.triggers), (*theirs.events, *theirs.triggers))
    assert (ours.width, ours.height) == (theirs.width, theirs.height)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "raw"])
def test_a_recording_that_was_cut_off_is_converted_and_told(raw, tmp_path, kind):
    assert not convert(raw, tmp_path / "whole", kind).cut_off
    raw.write_bytes(raw.read_bytes()[:-1])
    assert convert(raw, tmp_path / "cut", kind).cut_off


def numbers_for_events(path):
    with h5py.File(path, "w") as file:
        file.attrs["geometry"] = "1280x720"
        file["CD/events"] = file["EXT_TRIGGER/events"] = np.arange(5)


def endless_size(path):
    with path.open("xb") as file:
        np.savez(file, **dict.fromkeys("txyp", np.zeros(1, int)), size=np.array([np.inf, 720.0]))


@pytest.mark.parametrize("write", [numbers_for_events, endless_size])
def test_a_file_laid_out_otherwise_is_told_of_in_words(tmp_path, write):
    write(tmp_path / "a.bin")
    with pytest.raises(NotARecording, match="no readable events"):
        import_events(tmp_path / "a.bin")


def test_raw_to_raw_is_refused(raw, tmp_path):
    with pytest.raises(NotARecording, match="RAW recording already"):
        convert(raw, tmp_path / "again.raw", "raw")


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_that_is_there_is_never_written_over(raw, tmp_path, kind):
    convert(raw, tmp_path / "pose.npz", "numpy")
    (tmp_path / "out").write_bytes(b"precious")
    with pytest.raises(RecordingFileError, match="file exists already"):
        convert(tmp_path / "pose.npz", tmp_path / "out", kind)
    assert (tmp_path / "out").read_bytes() == b"precious"


@pytest.mark.parametrize("kind", KINDS)
def test_an_interrupt_leaves_neither_a_file_nor_a_part_of_one(raw, tmp_path, kind):
    convert(raw, tmp_path / "pose.npz", "numpy")

    def interrupt(_share):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        convert(tmp_path / "pose.npz", tmp_path / "out", kind, progress=interrupt)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pose.npz", "pose.raw"]


def test_a_file_system_without_links_is_served_too(tmp_path, monkeypatch):
    def no_links(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(os, "link", no_links)
    with new_file(tmp_path / "a") as part:
        part.write_bytes(b"whole")
    assert Path(tmp_path / "a").read_bytes() == b"whole"


@pytest.mark.parametrize("edge_us", [5, 20])
def test_an_edge_before_or_after_all_events_is_in_a_raw_file(tmp_path, edge_us):
    convert(npz(tmp_path / "a.npz", edge_us=edge_us), tmp_path / "a.raw", "raw")
    events, edges = RawFile.open(tmp_path / "a.raw").read()
    assert (events.t.tolist(), edges.t.tolist()) == ([10], [edge_us])
