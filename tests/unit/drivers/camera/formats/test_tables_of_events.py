"""Tables of events in files of NumPy, Parquet and text: with named columns, and text of t, x, y and p."""

import numpy as np
import pytest
from imported import import_events
from made_event_files import drawn_rows

from drivers.camera.event_arrays import ReadingChoices
from drivers.camera.file_kinds import FORMS_OF_EVENTS
from drivers.camera.formats import table_files
from drivers.camera.formats.event_conversion import convert
from drivers.camera.formats.event_files import open_events
from drivers.errors import NotARecording, RecordingFileError

N = 3000
WIDTH, HEIGHT = 640, 480
SIZED = ReadingChoices((WIDTH, HEIGHT))
ROWS = drawn_rows(11, N, (WIDTH, HEIGHT), from_us=700, span_us=40_000)


def assert_same(imported):
    assert all(np.array_equal(getattr(imported.events, name), ROWS[name]) for name in "txyp")
    assert (imported.width, imported.height) == (WIDTH, HEIGHT)


def named_table(*names):
    """One array whose columns have these names, in the order t, x, y, p."""
    table = np.zeros(N, list(zip(names, ("<i8", "<i2", "<i2", "?"), strict=True)))
    for name, own in zip(names, "txyp", strict=True):
        table[name] = ROWS[own]
    return table


def plain_table(order, unit=1.0, off=0):
    columns = {**ROWS, "t": ROWS["t"] * unit, "p": np.where(ROWS["p"], 1, off)}
    return np.stack([columns[name] for name in order], axis=1)


@pytest.mark.parametrize("table", [named_table(*"txyp"), named_table("timestamp", "x", "y", "polarity")])
@pytest.mark.parametrize("ending", ["npy", "npz"])
def test_one_array_holds_the_events(tmp_path, table, ending):
    """As tonic and expelliarmus have them."""
    path = tmp_path / f"a.{ending}"
    if ending == "npy":
        np.save(path, table)
    else:
        np.savez(path, events=table, K=np.eye(3))
    assert_same(import_events(path, SIZED))


def test_columns_of_an_archive_may_have_long_names_and_times_in_seconds(tmp_path):
    np.savez(tmp_path / "a.npz", timestamp=ROWS["t"], x=ROWS["x"], y=ROWS["y"], polarity=ROWS["p"])  # BS-ERGB
    assert_same(import_events(tmp_path / "a.npz", SIZED))
    floats = {name: values.astype("f8") for name, values in ROWS.items()}
    np.savez(tmp_path / "b.npz", **{**floats, "t": floats["t"] * 1e-6})
    assert_same(import_events(tmp_path / "b.npz", SIZED))


def test_one_of_several_arrays_is_chosen(tmp_path):
    np.savez(tmp_path / "a.npz", left=named_table(*"txyp"), right=named_table(*"txyp")[:5])
    with pytest.raises(NotARecording, match=r"2 streams .*left, right"):
        import_events(tmp_path / "a.npz", SIZED)
    assert_same(import_events(tmp_path / "a.npz", ReadingChoices((WIDTH, HEIGHT), "left")))


def test_an_array_of_other_things_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((4, 7)))
    with pytest.raises(NotARecording, match="array of 4 x 7"):
        import_events(tmp_path / "a.npy", SIZED)


# ------------------------------------------------------------ text


def text(path, head, order, separator, unit=1):
    kinds = {"t": "{:.6f}" if unit != 1 else "{:.0f}"}
    table = plain_table(order, unit)
    lines = [
        separator.join(kinds.get(name, "{:.0f}").format(of) for name, of in zip(order, row, strict=True))
        for row in table
    ]
    path.write_text(head + "\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("head", "order", "separator", "unit"),
    [
        ("", "txyp", " ", 1e-6),  # Event Camera Dataset
        ("# timestamp x y polarity\n", "txyp", " ", 1e-6),  # evlib
        ("timestamp,x,y,polarity\n", "txyp", ",", 1),  # DV
        (f"%geometry:{WIDTH},{HEIGHT}\n", "xypt", ",", 1),  # Metavision
        (f"%geometry:{WIDTH},{HEIGHT}\nx,y,polarity,timestamp_us\n", "xypt", ",", 1),
        ("x,y,polarity,timestamp_us\n", "xypt", ",", 1),
        ("p\tt\tx\ty\n", "ptxy", "\t", 1),
        ("# recorded in the dark\n\n#\nt x y p\n\n", "txyp", " ", 1),
        ("y,x,polarity,timestamp [\u00b5s]\n", "yxpt", ",", 1),
    ],
)
def test_a_line_holds_an_event(tmp_path, head, order, separator, unit):
    assert_same(import_events(text(tmp_path / "a.txt", head, order, separator, unit), SIZED))


@pytest.mark.parametrize("times", [("t", "timestamp"), ("time_secs", "time_nsecs")])
def test_two_columns_of_times_are_named_and_none_is_taken(tmp_path, times):
    names = ",".join((*times, "x", "y", "p"))
    lines = [f"{t // 1000},{t},{x},{y},{p}" for t, x, y, p in zip(*ROWS.values(), strict=True)]
    (tmp_path / "a.csv").write_text("\n".join([names, *lines]))
    with pytest.raises(NotARecording, match=f"{times[0]} and {times[1]}") as refused:
        import_events(tmp_path / "a.csv", SIZED)
    assert "another name" in refused.value.remedy


def test_blank_lines_behind_the_events_are_none(tmp_path, monkeypatch):
    """Events in pieces of a third of the file, so that the blank lines stand alone at the end."""
    monkeypatch.setattr(table_files, "PIECE_EVENTS", N // 3)
    path = text(tmp_path / "a.txt", "", "txyp", " ")
    path.write_text(path.read_text() + "\n\n")
    pieces = [events for events, _ in table_files.from_text(path, SIZED).pieces()]
    assert [len(events.t) for events in pieces] == [N // 3] * 3


def test_text_of_pandas_has_an_index_and_words_for_polarities(tmp_path):
    rows = zip(*(ROWS[name] for name in "txyp"), strict=True)
    lines = [f"{k},{t},{x},{y},{bool(p)}" for k, (t, x, y, p) in enumerate(rows)]
    (tmp_path / "a.csv").write_text("\n".join([",t,x,y,p", *lines]))
    assert_same(import_events(tmp_path / "a.csv", SIZED))


@pytest.mark.parametrize(
    "text_of_others",
    [
        "Notes of the day\n\nNothing was recorded.\n",
        "v,u,p,t\n5,6,1,1000\n",
        "row,col,polarity,event_time\n6,5,1,1000\n",
        f"{WIDTH} {HEIGHT}\n1000 5 6 1\n",
        f"t,x@{WIDTH},y@{HEIGHT},on\n1000,5,6,1\n",
    ],
)
def test_text_of_other_layouts_is_refused_with_the_forms_that_are_read(tmp_path, text_of_others):
    (tmp_path / "a.csv").write_text(text_of_others)
    with pytest.raises(NotARecording) as caught:
        import_events(tmp_path / "a.csv", SIZED)
    assert caught.value.remedy == FORMS_OF_EVENTS


@pytest.mark.parametrize(
    ("head", "line"),
    [
        ("t,x,y,p\n", "1,1000,5,60,1"),  # R's `write.table` has no name for its numbers of rows
        ("t;x;y;p\n", "0,5;1;2;1"),
        ("t,x,y,p\n", "0,5,1,2,1"),
        ("t x y p\n", "0,5 1 2 1"),
        ("", "0,5;1;2;1"),
        ("", "0,5\t1\t2\t1"),
    ],
)
def test_a_line_that_is_no_event_is_quoted(tmp_path, head, line):
    (tmp_path / "a.csv").write_text(f"{head}{line}\n")
    with pytest.raises(NotARecording, match=f"Line {1 + bool(head)} ") as caught:
        import_events(tmp_path / "a.csv", SIZED)
    assert repr(line) in caught.value.what
    assert "decimal point" in caught.value.remedy


@pytest.mark.parametrize("order", ["xytp", "xypt", "ptxy"])
@pytest.mark.parametrize("unit", [1, 1e-6])
def test_text_without_names_in_another_order_is_refused_with_the_one_that_was_read(tmp_path, order, unit):
    with pytest.raises(RecordingFileError) as caught:
        import_events(text(tmp_path / "a.txt", "", order, " ", unit), SIZED)
    assert "t, x, y, p" in caught.value.remedy.removeprefix(FORMS_OF_EVENTS)


def test_text_without_a_size_or_with_a_torn_line_is_refused(tmp_path):
    path = text(tmp_path / "a.txt", "", "txyp", " ")
    with pytest.raises(NotARecording, match="--sensor-size"):
        import_events(path)
    path.write_text(path.read_text() + "45000 3\n45001 2 3 1\n")
    with pytest.raises(NotARecording, match=f"Line {N + 1} .*'45000 3'"):
        import_events(path, SIZED)


def test_the_last_line_of_text_that_was_cut_off_is_left_out_and_told(tmp_path):
    path = text(tmp_path / "a.txt", "", "txyp", " ")
    path.write_text(path.read_text() + "45000 3")
    assert_same(import_events(path, SIZED))
    with open_events(path, SIZED) as opened:
        assert opened.truncated
    path.write_text(path.read_text().replace("45000 3", "# the end"))
    with open_events(path, SIZED) as opened:
        assert not opened.truncated


@pytest.mark.parametrize(
    "head",
    ["# timestamp [us] x y polarity", "# rows of t x y p", "t x y p ", "% t x y p", "# note\n" * 5000],
)
def test_a_comment_above_the_events_names_no_column_beyond_the_last(tmp_path, head):
    assert_same(import_events(text(tmp_path / "a.txt", f"{head}\n", "txyp", " "), SIZED))


def test_delimiters_behind_the_last_column_are_none(tmp_path):
    path = text(tmp_path / "a.csv", "", "txyp", ",")
    path.write_text(path.read_text().replace("\n", ",\n"))
    assert_same(import_events(path, SIZED))


@pytest.mark.parametrize(
    ("head", "row", "time_us"),
    [
        ("t_ms,y,x,p,label", "{},582,137,0,", 1000),
        ("timestamp_ns;y;x;p;cluster", "{}000000;582;137;0;", 1),
        ("t_ms,y,x,p,a,b", "{},582,137,0", 1000),
        ("t_ms,y,x,p\n# recorded in the dark", "{},582,137,0", 1000),
    ],
)
def test_names_of_all_columns_are_used_although_a_row_has_fewer_cells(tmp_path, head, row, time_us):
    (tmp_path / "a.csv").write_text("\n".join([head, *(row.format(1000 + k) for k in range(9))]))
    events = import_events(tmp_path / "a.csv", ReadingChoices((1280, 720))).events
    per_us = 1000 if "_ns" in head else time_us
    assert (events.t[1] - events.t[0], events.x[0], events.y[0]) == (per_us, 137, 582)


@pytest.mark.parametrize("labels", [("car", "", "7"), ("car", "dog", ""), ("", "car", "dog")])
def test_a_label_of_text_takes_no_event_away(tmp_path, labels):
    rows = [f"{1000 + k},582,137,0,{label}" for k, label in enumerate(labels)]
    (tmp_path / "a.csv").write_text("\n".join(["t_ms,y,x,p,label", *rows]) + "\n")
    events = import_events(tmp_path / "a.csv", ReadingChoices((1280, 720))).events
    assert (len(events.t), set(events.x), set(events.y)) == (3, {137}, {582})


# ------------------------------------------------------------ Parquet


def test_what_is_written_as_parquet_is_read_again_with_its_edges(tmp_path):
    pytest.importorskip("pyarrow")
    edges = {"t": np.array([800, 900]), "value": np.array([1, 0]), "id": np.array([0, 0])}
    own = {f"trigger_{name}": values for name, values in edges.items()}
    np.savez(tmp_path / "a.npz", **ROWS, **own, size=np.array([WIDTH, HEIGHT]))
    convert(tmp_path / "a.npz", tmp_path / "a.parquet", "parquet")
    imported = import_events(tmp_path / "a.parquet")
    assert_same(imported)
    assert imported.triggers.t.tolist() == [800, 900]


def test_parquet_without_polarities_is_refused(tmp_path):
    pa, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    parquet.write_table(pa.table({name: ROWS[name] for name in "txy"}), tmp_path / "a.parquet")
    with pytest.raises(NotARecording, match="no column p"):
        import_events(tmp_path / "a.parquet", SIZED)
    (tmp_path / "b.parquet").write_bytes((tmp_path / "a.parquet").read_bytes()[:500])
    with pytest.raises(NotARecording, match="damaged"):
        import_events(tmp_path / "b.parquet", SIZED)
