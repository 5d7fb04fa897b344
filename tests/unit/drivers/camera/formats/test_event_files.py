"""Events in files for analysis: out of a RAW file and back, the same events each time."""

from importlib.metadata import EntryPoint

import h5py
import numpy as np
import pytest
from imported import import_events

from drivers.camera.formats import event_files
from drivers.camera.formats.event_conversion import convert
from drivers.camera.formats.event_exports import CHUNK_EVENTS
from drivers.camera.formats.hdf5_events import CD_TYPE
from drivers.camera.raw_file import RawFile
from drivers.errors import NotARecording, RecordingCorrupt, RecordingFileError

HEADER = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% serial_number 00051234\n% plugin_name x\n% end\n"
START_US = 5_000_000


def words(n, *, step_us=7):
    """So many events in rows of ten, two trigger edges a hundred rows."""
    rng = np.random.default_rng(3)
    stream = [0x8000 | START_US >> 12, 0x6000 | START_US & 0xFFF]
    for k in range(0, n, 10):
        t = START_US + k // 10 * step_us
        stream += [0x8000 | t >> 12 & 0xFFF, 0x6000 | t & 0xFFF, int(rng.integers(720))]
        stream += [0x2000 | rng.integers(2) << 11 | x for x in rng.integers(0, 1280, min(10, n - k)).tolist()]
        if k // 10 % 50 == 0:
            stream.append(0xA000 | k // 500 % 2)
    return stream


@pytest.fixture
def recording(tmp_path):
    """A recording of two and a half chunks."""
    return make(tmp_path, words(CHUNK_EVENTS * 5 // 2))


def make(tmp_path, of):
    path = tmp_path / "pose.raw"
    path.write_bytes(HEADER + np.array(of, "<u2").tobytes())
    return RawFile.open(path)


EXPORTS = [("metavision", "h5"), ("hdf5", "h5"), ("numpy", "npz")]


@pytest.mark.parametrize(("export", "suffix"), EXPORTS)
@pytest.mark.parametrize("n", [0, 1, CHUNK_EVENTS, CHUNK_EVENTS + 1, CHUNK_EVENTS * 5 // 2])
def test_what_is_exported_comes_back_the_same(tmp_path, export, suffix, n):
    recording, path = make(tmp_path, words(n)), tmp_path / f"pose.{suffix}"
    exported = convert(recording.path, path, export)
    imported = import_events(path)
    events, triggers = recording.read()
    for ours, theirs in zip((*events, *triggers), (*imported.events, *imported.triggers), strict=True):
        assert ours.dtype == theirs.dtype
        assert np.array_equal(ours, theirs)
    assert (imported.width, imported.height) == (1280, 720)
    assert (exported.events, exported.triggers, exported.moved_events) == (len(events.t), len(triggers.t), 0)


def test_a_metavision_file_is_laid_out_as_its_reader_expects(recording, tmp_path):
    path = tmp_path / "pose.h5"
    convert(recording.path, path, "metavision")
    with h5py.File(path) as file:
        assert file["CD/events"].dtype == CD_TYPE
        assert file["CD/events"].chunks == (CHUNK_EVENTS,)
        assert file["CD/events"].id.get_create_plist().get_filter(0)[0] == 36559
        assert file["EXT_TRIGGER/events"].dtype.itemsize == 24
        assert dict(file.attrs) == {
            "version": "1.0",
            "geometry": "1280x720",
            "format": "EVT3;height=720;width=1280",
            "serial_number": "00051234",
        }
        kind = h5py.h5a.open(file.id, b"version").get_type()
        assert kind.is_variable_str()
        assert kind.get_cset() == h5py.h5t.CSET_ASCII


def test_the_index_leads_to_the_events_of_a_time(recording, tmp_path):
    path = tmp_path / "pose.h5"
    convert(recording.path, path, "metavision")
    t = recording.read()[0].t
    with h5py.File(path) as file:
        index = file["CD/indexes"][:]
        offset = int(file["CD/indexes"].attrs["offset"])
    assert offset == -t[0]
    assert tuple(index[0]) == (0, -1)
    assert len(index) == (t[-1] - t[0]) // 2000 + 2
    for k, (event, since) in enumerate(index[1:]):
        assert since == t[event] + offset
        assert event == 0 or t[event - 1] + offset < since // 2000 * 2000
        assert 2000 * k <= since < 2000 * (k + 1)


def test_times_that_step_back_are_moved_and_counted_in_metavision_files_only(tmp_path):
    recording = make(tmp_path, [0x8001, 0x6014, 0x0005, 0x2001, 0x6010, 0x2002, 0x6020, 0x2003])
    assert convert(recording.path, tmp_path / "a.h5", "metavision").moved_events == 1
    convert(recording.path, tmp_path / "b.h5", "hdf5")
    assert import_events(tmp_path / "a.h5").events.t.tolist() == [4116, 4116, 4128]
    assert import_events(tmp_path / "b.h5").events.t.tolist() == [4116, 4112, 4128]


def test_a_damaged_chunk_is_told_with_its_place(recording, tmp_path):
    path = tmp_path / "a.h5"
    convert(recording.path, path, "metavision")
    with h5py.File(path) as file:
        place = file["CD/events"].id.get_chunk_info(1).byte_offset
    data = bytearray(path.read_bytes())
    data[place : place + 4] = bytes(4)
    path.write_bytes(data)
    with pytest.raises(RecordingCorrupt, match="cannot be decompressed") as caught:
        import_events(path)
    assert caught.value.offset == place


def damage(path, change):
    with h5py.File(path, "a") as file:
        change(file)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda file: file.__delitem__("CD/events"), "CD/events is missing"),
        (lambda file: [file.attrs.pop(key) for key in ("geometry", "format")], "state the sensor's size"),
        (lambda file: file.attrs.__setitem__("geometry", "wide"), "invalid size of the sensor"),
        (lambda file: file.attrs.__setitem__("geometry", "100x100"), "format states 1280 x 720, geometry"),
        (lambda file: file["CD/events"].resize((10**6,)), "are missing|instead of 16384"),
    ],
)
def test_a_metavision_file_that_lacks_a_part_is_told(recording, tmp_path, change, message):
    convert(recording.path, tmp_path / "a.h5", "metavision")
    damage(tmp_path / "a.h5", change)
    with pytest.raises((NotARecording, RecordingCorrupt), match=message):
        import_events(tmp_path / "a.h5")


def test_numpy_files_that_lack_a_part_are_told(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, t=np.zeros(3, int))
    with pytest.raises(NotARecording, match="x is missing"):
        import_events(path)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(NotARecording):
        import_events(path)


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89HDF\r\n\x1a\n"])
def test_a_file_that_holds_no_events_is_refused_by_name(tmp_path, content):
    (tmp_path / "a.h5").write_bytes(content)
    with pytest.raises(RecordingFileError, match=r"a\.h5"):
        import_events(tmp_path / "a.h5")


def test_a_group_where_the_events_belong_is_told(tmp_path):
    path = tmp_path / "a.hdf5"
    with h5py.File(path, "w") as file:
        file.create_group("CD/events")
        file.create_dataset("EXT_TRIGGER/events", data=np.zeros(0, [("p", "i2"), ("t", "i8"), ("id", "i2")]))
        file.attrs["geometry"] = "1280x720"
    with pytest.raises(NotARecording, match="is a group"):
        import_events(path)


@pytest.fixture
def broken_reader(monkeypatch):
    """A package of somebody declares a reader, and cannot be imported."""
    entry = EntryPoint("theirs", "no_such_package:READER", event_files.GROUP)
    monkeypatch.setattr(event_files, "entry_points", lambda **_: [entry])
    event_files.brought_formats.cache_clear()
    yield
    event_files.brought_formats.cache_clear()


@pytest.mark.usefixtures("broken_reader")
def test_a_reader_that_cannot_be_used_stops_no_file_of_another_form(tmp_path):
    recording = make(tmp_path, words(100))
    convert(recording.path, tmp_path / "out.npz", "numpy")
    with event_files.open_events(tmp_path / "out.npz") as source:
        assert sum(len(events.t) for events, *_ in source.pieces()) == 100


@pytest.mark.usefixtures("broken_reader")
def test_a_reader_that_cannot_be_used_is_named_for_a_file_that_nothing_else_knows(tmp_path):
    path = tmp_path / "theirs.bin"
    path.write_bytes(bytes(range(1, 200)))
    with pytest.raises(NotARecording, match=r"theirs.*no_such_package"), event_files.open_events(path):
        pytest.fail("it was opened")
