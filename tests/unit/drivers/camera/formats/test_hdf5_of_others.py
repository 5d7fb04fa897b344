"""Events in HDF5 files of other programs: columns t, x, y and p, and Metavision without its table of edges."""

import zipfile

import h5py
import numpy as np
import pytest
from imported import import_events
from made_event_files import drawn_rows

from drivers.camera.event_arrays import ReadingChoices
from drivers.camera.file_kinds import FORMS_OF_EVENTS
from drivers.errors import CameraSoftwareMissing, NotARecording

N = 1200
SIZE = (346, 260)
SIZED = ReadingChoices(SIZE)
YEAR_2020_US = 1_600_000_000_000_000
ROWS = drawn_rows(5, N, SIZE, from_us=500, span_us=49_200)


def columns(group, names="txyp", kinds=("u4", "u2", "u2", "u1"), **stored):
    for name, own, kind in zip(names, "txyp", kinds, strict=True):
        group.create_dataset(name, data=ROWS[own].astype(kind), **stored)


def assert_same(imported, origin_us=0):
    assert np.array_equal(imported.events.t + origin_us, ROWS["t"])
    assert all(np.array_equal(getattr(imported.events, name), ROWS[name]) for name in "xyp")


def assert_since(imported, begin_us):
    assert_same(imported, int(imported.header["time_origin_us"]) - begin_us)


@pytest.fixture
def written(tmp_path):
    """Write a file and read it again."""

    def write(fill, choices=SIZED):
        with h5py.File(tmp_path / "events.h5", "w") as file:
            fill(file)
        return import_events(tmp_path / "events.h5", choices)

    return write


def dsec(file, **stored):
    columns(file.create_group("events"), chunks=(100,), **stored)
    file["ms_to_idx"], file["t_offset"] = np.arange(3), np.int64(YEAR_2020_US)


@pytest.mark.parametrize("offset", [YEAR_2020_US, np.float64(YEAR_2020_US), np.array([YEAR_2020_US])])
@pytest.mark.parametrize("where", ["", "events"])
@pytest.mark.parametrize("as_attribute", [True, False])
def test_an_offset_of_times_is_added(written, offset, where, as_attribute):
    def fill(file):
        columns(file.create_group("events"), chunks=(100,))
        group = file[f"/{where}"]
        (group.attrs if as_attribute else group)["t_offset"] = offset

    imported = written(fill)
    assert_since(imported, YEAR_2020_US)
    assert (imported.width, imported.height) == SIZE
    assert imported.header["date"] == "2020-09-13 12:26:40"


def test_a_small_offset_of_times_is_added_to_the_edges_too(written):
    def fill(file):
        columns(file.create_group("events"))
        file["t_offset"] = 7000
        for name, value in (("t", 41), ("value", 1), ("id", 0)):
            file[f"triggers/{name}"] = np.array([value])

    imported = written(fill)
    assert_same(imported, -7000)
    assert imported.triggers.t.tolist() == [7041]


@pytest.mark.parametrize(
    ("times", "offsets"),
    [
        ({"t": ROWS["t"]}, {"t_offset": 5, "events/t_offset": 5}),
        ({"t": ROWS["t"]}, {"t_offset": np.array([1, 2])}),
        ({"t": ROWS["t"]}, {"t_offset": 0.5}),
        ({"t": ROWS["t"] * 1e-6}, {"t_offset": 5}),
        ({"t_ns": ROWS["t"]}, {"t_offset": 5}),
    ],
)
def test_an_offset_that_cannot_be_added_is_refused(written, times, offsets):
    def fill(file):
        columns(file.create_group("events"))
        del file["events/t"]
        file["events"].update(times)
        file.update(offsets)

    with pytest.raises(NotARecording, match=r"t_offset|whole number"):
        written(fill)


@pytest.mark.parametrize("filter_of_plugin", ["Blosc", "Blosc2", "Zstd", "LZ4", "Bitshuffle"])
def test_every_filter_of_the_plugin_is_read(written, filter_of_plugin):
    plugin = pytest.importorskip("hdf5plugin")
    assert_since(written(lambda file: dsec(file, **getattr(plugin, filter_of_plugin)())), YEAR_2020_US)


def test_a_filter_that_is_not_installed_is_named_with_the_package(tmp_path, monkeypatch):
    plugin = pytest.importorskip("hdf5plugin")
    with h5py.File(tmp_path / "events.h5", "w") as file:
        dsec(file, **plugin.Blosc())
    (tmp_path / "hdf5plugin.py").write_text("raise ImportError('no such package')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(CameraSoftwareMissing, match=r"filter 32001 .*starbench\[formats\]"):
        import_events(tmp_path / "events.h5", SIZED)


def test_chunks_that_were_never_written_are_not_read_as_zeros(written):
    def fill(file):
        columns(file.create_group("events"))
        del file["events/t"]
        file.create_dataset("events/t", (N,), "i8", chunks=(100,), compression="lzf")
        file["events/t"][:200] = ROWS["t"][:200]

    with pytest.raises(NotARecording, match="2 of the 12 chunks"):
        written(fill)


def two_cameras(file):
    for side in ("left", "right"):
        columns(file.create_group(f"prophesee/{side}"), kinds=("i8", "u2", "u2", "i1"))
    file["prophesee/right/x"][:] = 0
    file["ovc/imu/t"] = file["ovc/imu/x"] = file["ovc/imu/y"] = np.zeros(3)


def test_several_cameras_are_listed_with_the_way_to_choose(written):
    with pytest.raises(NotARecording, match=r"prophesee/left, prophesee/right.*--stream"):
        written(two_cameras)
    with pytest.raises(NotARecording, match="no stream 'middle'"):
        written(two_cameras, ReadingChoices(stream="middle"))


@pytest.mark.parametrize("shape", [(N, 1), (1, N)])
@pytest.mark.parametrize("chunks", [None, True])
def test_the_columns_of_matlab_have_two_sides(written, shape, chunks):
    """MATLAB, h5create and save -v7.3: a vector has two dimensions."""

    def fill(file):
        for name, values in ROWS.items():
            file.create_dataset(f"events/{name}", data=values.reshape(shape), chunks=chunks)

    assert_same(written(fill))


@pytest.mark.parametrize("names", [("ts", "xs", "ys", "ps"), ("timestamps", "x", "y", "polarities")])
@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_floating_times_are_in_seconds_if_they_have_fractions(written, names, unit):
    def fill(file):
        columns(file.create_group("events"), names, ("f8", "i2", "i2", "?"))
        file[f"events/{names[0]}"][:] = unit * ROWS["t"]

    assert_same(written(fill))


def test_columns_of_undistorted_events_are_refused(written):
    def fill(file):
        columns(file.create_group("events"), kinds=("i8", "f4", "f4", "u1"))
        file["events/x"][3] = 7.5

    with pytest.raises(NotARecording, match="no whole numbers"):
        written(fill)


def metavision(file):
    table = np.zeros(N, [("x", "u2"), ("y", "u2"), ("p", "i2"), ("t", "i8")])
    for name in "xypt":
        table[name] = ROWS[name]
    file["CD/events"] = table


@pytest.mark.parametrize("has_group", [True, False])
def test_metavision_without_edges_and_without_a_size_is_read(written, has_group):
    def fill(file):
        metavision(file)
        if has_group:
            file["EXT_TRIGGER/indexes"] = np.zeros(2)

    imported = written(fill)
    assert_same(imported)
    assert len(imported.triggers.t) == 0


def size_in_a_header(file):
    metavision(file)
    file.attrs["format"] = "EVT3;height=260;width=346"


def size_of_our_own(file):
    columns(file.create_group("events"))
    file.attrs.update(width=SIZE[0], height=SIZE[1])


def size_beside_the_columns(file):
    columns(file.create_group("events"))
    file["events"].attrs.update(width=SIZE[0], height=SIZE[1])


@pytest.mark.parametrize("fill", [size_in_a_header, size_of_our_own, size_beside_the_columns])
def test_a_size_that_the_file_states_is_that_of_the_sensor(written, fill):
    imported = written(fill, ReadingChoices())
    assert_same(imported)
    assert (imported.width, imported.height) == SIZE
    with pytest.raises(NotARecording, match="contradict each other"):
        written(fill, ReadingChoices((1280, 720)))


@pytest.mark.parametrize("shape", [(N, 4), (4, N), (2, 3)])
def test_arrays_without_names_are_refused_with_the_forms_that_are_read(written, shape):
    with pytest.raises(NotARecording, match="holds left/events") as caught:
        written(lambda file: file.create_dataset("left/events", data=np.zeros(shape)))
    assert caught.value.remedy == FORMS_OF_EVENTS


def test_a_zip_archive_of_other_things_is_told_as_what_it_is(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("events.raw", b"% evt 3.0")
    with pytest.raises(NotARecording, match="zip archive without"):
        import_events(tmp_path / "a.npz")
