"""EVT2 and DAT files; test_events_of_other_programs.py reads those of programs that nobody here wrote."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from imported import import_events
from made_event_files import DAT_HEAD, assert_same, dat_rows, evt2_words, evt21_words, some_events

from drivers.camera.event_arrays import ReadingChoices
from drivers.camera.formats.event_files import open_events
from drivers.camera.formats.prophesee_words import Evt2Decoder
from drivers.camera.raw_check import WORD_BYTES
from drivers.errors import NotARecording, RecordingFileError


def test_evt2_by_hand(tmp_path):
    path = tmp_path / "a.raw"
    path.write_bytes(
        evt2_words(
            0x8000_0002,  # 128 us
            0x1000_0000 | 5 << 22 | 3 << 11 | 7,
            0xA000_0000 | 6 << 22 | 1 << 8 | 1,
            0x8FFF_FFFF,
            0x0000_0000 | 63 << 22 | 1279 << 11 | 719,
            0x8000_0000,  # the counter turns over
            0x1000_0000,
        )
    )
    imported = import_events(path)
    assert imported.events.t.tolist() == [133, (1 << 34) - 1, 1 << 34]
    assert (imported.events.x.tolist(), imported.events.y.tolist()) == ([3, 1279, 0], [7, 719, 0])
    assert imported.events.p.tolist() == [1, 0, 1]
    edges = imported.triggers
    assert (edges.t.tolist(), edges.value.tolist(), edges.id.tolist()) == ([134], [1], [1])


def test_events_before_the_first_time_of_evt2_are_dropped(tmp_path):
    """A stream may be joined in its middle."""
    path = tmp_path / "a.raw"
    path.write_bytes(evt2_words(0x1000_0000 | 9 << 11, 0xA000_0001, 0x8000_0002, 0x1000_0000 | 3 << 11 | 7))
    imported = import_events(path)
    assert (imported.events.t.tolist(), imported.events.x.tolist()) == ([128], [3])
    assert len(imported.triggers.t) == 0


@pytest.mark.parametrize("order", ["little", "legacy"])
def test_vectors_of_evt21_are_read_in_both_orders_of_their_halves(tmp_path, order):
    rows = some_events(4000, step_us=2)
    rows["t"][1::2] = rows["t"][::2]  # two events at a time, some of them in one vector
    rows["y"][1::2], rows["on"][1::2] = rows["y"][::2], rows["on"][::2]
    rows["x"][1::2] = np.minimum(rows["x"][::2] | 31, 639)
    head = f"% evt 2.1\n% format EVT21;endianness={order};height=480;width=640\n% end\n".encode()
    path = tmp_path / "a.raw"
    path.write_bytes(head + evt21_words(rows, legacy=order == "legacy") + b"\0\0\0")
    imported = import_events(path)
    assert (imported.width, imported.height) == (640, 480)
    assert_same(imported, rows)


@given(st.binary(max_size=600), st.sampled_from(["EVT2", "EVT21", "EVT21-legacy"]), st.integers(0, 600))
def test_any_words_are_decoded_the_same_in_pieces_of_any_length(data, encoding, cut):
    whole, parts = Evt2Decoder(encoding), Evt2Decoder(encoding)
    cut -= cut % WORD_BYTES[encoding]
    events, edges = whole.decode(data)
    pieces = [parts.decode(data[:cut]), parts.decode(data[cut:])]
    for own, columns in ((events, [piece[0] for piece in pieces]), (edges, [piece[1] for piece in pieces])):
        for name in own._fields:
            joined = np.concatenate([getattr(piece, name) for piece in columns])
            assert np.array_equal(getattr(own, name), joined)


def test_evt21_by_hand(tmp_path):
    path = tmp_path / "a.raw"
    words = [0, 0x8FFF_FFFF, 1 << 31 | 1, 0x1000_0000 | 63 << 22 | 32 << 11 | 7, 0, 0x8000_0000]
    words += [0, 0xA000_0000 | 6 << 22 | 1 << 8 | 1, 2, 0, 0xF000_1234, 0xE000_0014]
    path.write_bytes(b"% format EVT21;height=320;width=320\n% end\n" + np.array(words, "<u4").tobytes())
    imported = import_events(path)
    assert imported.events.t.tolist() == [(1 << 34) - 1, (1 << 34) - 1, 1 << 34]
    assert (imported.events.x.tolist(), imported.events.y.tolist()) == ([32, 63, 1], [7, 7, 0])
    assert imported.events.p.tolist() == [1, 1, 0]
    assert (imported.triggers.t.tolist(), imported.triggers.id.tolist()) == ([(1 << 34) + 6], [1])


def dat_head(version, kind=0x0C, size=True):
    lines = "% Data file containing CD events.\n" + (f"% Version {version}\n" if version else "")
    return (lines + ("% Height 240\n% Width 304\n" if size else "")).encode() + bytes([kind, 8])


@pytest.mark.parametrize("more", [0, 3])
def test_a_dat_file_that_ends_within_an_event_is_told(tmp_path, more):
    rows, path = some_events(50), tmp_path / "a.dat"
    path.write_bytes(b"% made by hand\n" + dat_rows(rows) + bytes(more))
    imported = import_events(path)
    assert_same(imported, rows)
    assert imported.truncated is (more > 0)


@pytest.mark.parametrize("version", ["1", ""])
def test_version_1_of_dat_has_another_layout(tmp_path, version):
    rows = some_events(600)
    rows["x"], rows["y"] = rows["x"] % 304, rows["y"] % 240
    table = np.zeros((len(rows), 2), "<u4")
    table[:, 0] = rows["t"]
    table[:, 1] = rows["x"] | rows["y"].astype("u4") << 9 | rows["on"].astype("u4") << 17
    path = tmp_path / "a.dat"
    path.write_bytes(dat_head(version) + table.tobytes())
    assert_same(import_events(path), rows)


def test_a_dat_file_without_a_size_is_read_with_one_that_is_given(tmp_path):
    rows, path = some_events(50), tmp_path / "a.dat"
    own_line = b"% This DAT file has been generated through expelliarmus \n"  # before Prophesee's lines
    path.write_bytes(own_line + dat_head(2, size=False) + dat_rows(rows)[len(DAT_HEAD) + 2 :])
    with pytest.raises(NotARecording, match="--sensor-size"):
        import_events(path)
    assert_same(import_events(path, ReadingChoices((640, 480))), rows)
    with pytest.raises(NotARecording, match="30 x 30 px"):
        import_events(path, ReadingChoices((30, 30)))


def test_a_dat_file_of_edges_and_one_of_an_unknown_version_are_named(tmp_path):
    path = tmp_path / "a.dat"
    path.write_bytes(dat_head(2, kind=0x0E) + bytes(16))
    with pytest.raises(NotARecording, match="holds trigger edges only"):
        import_events(path)
    path.write_bytes(dat_head(7) + bytes(16))
    with pytest.raises(NotARecording, match="has version 7"):
        import_events(path)


@pytest.mark.parametrize(
    "data",
    [
        evt2_words(0x8000_0001, 0x1000_0000 | 2047 << 11),
        DAT_HEAD,
        DAT_HEAD + bytes([0x0C, 255]) + bytes(16),
        DAT_HEAD + bytes([0x0C, 8]) + b"\xff" * 8,
    ],
    ids=["evt2 outside", "dat without events", "dat of a wrong size", "dat outside"],
)
def test_a_malformed_file_is_refused_with_its_name_and_a_remedy(tmp_path, data):
    path = tmp_path / "bad.raw"
    path.write_bytes(data)
    with pytest.raises(RecordingFileError) as caught:
        import_events(path)
    assert str(path) in str(caught.value)
    assert caught.value.remedy


def test_dat_times_go_on_where_their_counter_turns_over(tmp_path):
    rows = some_events(4)
    rows["t"] = [0xFFFF_FFF0, 0xFFFF_FFFF, 0x1_0000_0001, 0x1_0000_0002]
    path = tmp_path / "a.dat"
    path.write_bytes(dat_rows(rows))
    assert_same(import_events(path), rows)


def test_memory_is_bounded_whatever_the_size(tmp_path):
    path = tmp_path / "a.dat"
    path.write_bytes(dat_rows(some_events(3_000_000, step_us=1)))
    tracemalloc.start()
    with open_events(path) as source:
        count = sum(len(events.t) for events, _ in source.pieces())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count == 3_000_000
    assert peak < 40e6
