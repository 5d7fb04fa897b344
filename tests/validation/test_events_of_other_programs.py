"""Events that other programs write are read as they were given, and those programs read what `convert` writes."""

import numpy as np
import pytest
from imported import import_events
from made_event_files import drawn_rows

from drivers.camera.event_arrays import ReadingChoices
from drivers.camera.formats.event_conversion import convert

N = 5000
SIZE = (1280, 720)
ROWS = drawn_rows(8, N, SIZE, from_us=1000, span_us=500_000)


def assert_same(columns, *, begins_at_0=False):
    t = np.asarray(columns[0]).astype(np.int64)
    assert np.array_equal(t + (ROWS["t"][0] if begins_at_0 else 0), ROWS["t"])
    for name, column in zip("xyp", columns[1:], strict=True):
        assert np.array_equal(np.asarray(column).astype(np.int64), ROWS[name]), name


def table(kinds):
    rows = np.zeros(N, kinds)
    for name in rows.dtype.names:
        rows[name] = ROWS["p" if name == "on" else name]
    return rows


@pytest.fixture
def converted(tmp_path):
    """Write the events by `convert`, as a file of another ending."""
    np.savez(tmp_path / "source.npz", **ROWS, size=np.array(SIZE))

    def write(ending, kind):
        convert(tmp_path / "source.npz", tmp_path / f"made.{ending}", kind)
        return tmp_path / f"made.{ending}"

    return write


def read(path):
    return import_events(path, ReadingChoices(SIZE)).events


def test_faery_reads_and_writes_the_same_events(tmp_path, converted):
    faery = pytest.importorskip("faery", reason="faery is not installed")
    rows = faery.events_stream_from_file(converted("raw", "raw")).to_array()
    assert_same([rows["t"], rows["x"], rows["y"], rows["on"]])
    stream = faery.events_stream_from_array(table(faery.EVENTS_DTYPE), SIZE)
    for name, begins_at_0 in (("a.aedat4", False), ("a.raw", True)):
        stream.to_file(tmp_path / name)
        assert_same(read(tmp_path / name), begins_at_0=begins_at_0)


def test_expelliarmus_writes_the_same_events(tmp_path):
    expelliarmus = pytest.importorskip("expelliarmus", reason="expelliarmus is not installed")
    rows = table([("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("p", "u1")])
    for encoding, ending in (("dat", "dat"), ("evt2", "raw")):
        path = tmp_path / f"{encoding}.{ending}"
        expelliarmus.Wizard(encoding=encoding).save(str(path), rows)
        assert_same(read(path))


def test_evlib_reads_and_writes_the_same_events(tmp_path, converted):
    evlib = pytest.importorskip("evlib", reason="evlib is not installed")
    for ending, kind in (("raw", "raw"), ("h5", "hdf5")):
        frame = evlib.load_events(str(converted(ending, kind))).collect()
        t = frame["t"].dt.total_microseconds().to_numpy()
        assert_same([t, frame["x"].to_numpy(), frame["y"].to_numpy(), frame["polarity"].to_numpy() > 0])
    columns = [ROWS["x"], ROWS["y"], ROWS["t"] * 1e-6, ROWS["p"]]
    for save, name in ((evlib.save_events_to_hdf5, "a.h5"), (evlib.save_events_to_text, "a.txt")):
        save(*columns, str(tmp_path / name))
        assert_same(read(tmp_path / name))


def test_polars_reads_the_same_events(converted):
    polars = pytest.importorskip("polars", reason="polars is not installed")
    frame = polars.read_parquet(converted("parquet", "parquet"))
    assert_same([frame[name].to_numpy() for name in "txyp"])


def test_tonic_writes_the_same_events(tmp_path):
    tonic = pytest.importorskip("tonic", reason="tonic is not installed")
    np.save(tmp_path / "a.npy", tonic.io.make_structured_array(*(ROWS[name] for name in "xytp")))
    assert_same(read(tmp_path / "a.npy"))
