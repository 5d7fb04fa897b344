"""Event files that point to other files, state more than they hold, or stand for gigabytes: refused, never followed."""

import os
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from imported import import_events

from drivers.camera.formats.event_conversion import write_raw
from drivers.camera.formats.event_files import open_events
from drivers.camera.formats.hdf5_reading import MOST_CHUNK_BYTES
from drivers.camera.raw_check import require_whole
from drivers.errors import NotARecording, RecordingCorrupt, RecordingFileError

N = 3000
COLUMNS = {"t": "i8", "x": "u2", "y": "u2", "p": "u1"}


def plain(path, *, events=True):
    """A plain HDF5 file of N events; returns the open file."""
    file = h5py.File(path, "w")
    file.attrs.update(width=1280, height=720)
    file.create_group("header").attrs["serial_number"] = "7"
    for name, kind in COLUMNS.items() if events else ():
        file.create_dataset(f"events/{name}", data=np.arange(N).astype(kind) % 2)
    for name in ("t", "value", "id"):
        file.create_dataset(f"triggers/{name}", data=np.zeros(1, int))
    return file


@pytest.fixture
def victim(tmp_path):
    """Another file, whose numbers nobody has asked for."""
    plain(tmp_path / "secret.h5").close()
    np.full(N, 7, "i8").tofile(tmp_path / "secret.bin")
    return tmp_path


def external_link(file):
    file["events/t"] = h5py.ExternalLink("secret.h5", "/events/t")


def external_group(file):
    del file["events"]
    file["events"] = h5py.ExternalLink("secret.h5", "/events")


def soft_link(file):
    file["elsewhere"] = h5py.ExternalLink("secret.h5", "/events/t")
    file["events/t"] = h5py.SoftLink("/elsewhere")


def external_storage(file):
    where = os.fsencode(Path(file.filename).parent / "secret.bin")
    file.create_dataset("events/t", (N,), "i8", external=[(where, 0, 8 * N)])


def virtual(file):
    layout = h5py.VirtualLayout((N,), "i8")
    layout[:] = h5py.VirtualSource("secret.h5", "events/t", (N,))
    file.create_virtual_dataset("events/t", layout)


def text(file):
    file.create_dataset("events/t", data=[b"a"] * N)


def missing_chunks(file):
    file.create_dataset("events/t", (N,), "i8", chunks=(100,))


def never_written(file):
    file.create_dataset("events/t", (N,), "i8")


def two_dimensions(file):
    file.create_dataset("events/t", data=np.zeros((N, 2), int))


def huge_chunk(file):
    file.create_dataset("events/t", (N,), "i8", chunks=(MOST_CHUNK_BYTES // 8 + 1,), maxshape=(None,))


def bomb_in_a_chunk(file):
    """HDF5 would decompress all of it, whatever the size of the chunk."""
    column = file.create_dataset("events/t", (N,), "i8", chunks=(N,), compression=9)
    column.id.write_direct_chunk((0,), zlib.compress(bytes(100_000_000), 9))


def longer(file):
    file.create_dataset("events/t", data=np.zeros(N + 1, int))


HOSTILE = {
    external_link: "events/t is a link to another place",
    external_group: "events, a link to another place",
    soft_link: "events/t is a link to another place",
    external_storage: "events/t keeps its data in another file",
    virtual: "events/t keeps its data in another file",
    text: "events/t is an array of",
    missing_chunks: "3000 of the 3000 rows of /events/t are missing",
    never_written: "events/t states 24000 bytes, but they are missing",
    two_dimensions: "events/t is an array of 3000 x 2; a list is needed",
    huge_chunk: "events/t has chunks of",
    bomb_in_a_chunk: "a chunk of 24000 bytes holds more",
    longer: "different lengths",
}


@pytest.mark.parametrize("spoil", HOSTILE, ids=lambda spoil: spoil.__name__)
def test_a_file_is_read_from_its_own_bytes_only(victim, spoil):
    path = victim / "a.h5"
    with plain(path) as file:
        del file["events/t"]
        spoil(file)
    with pytest.raises(RecordingFileError, match=HOSTILE[spoil]):
        import_events(path)


@pytest.mark.parametrize("where", ["CD", "EXT_TRIGGER", "CD/events"])
def test_a_metavision_file_does_not_point_elsewhere_either(victim, where):
    table = np.zeros(N, [("x", "u2"), ("y", "u2"), ("p", "i2"), ("t", "i8")])
    for name in ("secret.h5", "a.hdf5"):
        with h5py.File(victim / name, "w") as file:
            file.attrs["geometry"] = "1280x720"
            file["CD/events"] = table
            file["EXT_TRIGGER/events"] = np.zeros(0, [("p", "i2"), ("t", "i8"), ("id", "i2")])
    assert len(import_events(victim / "a.hdf5").events.t) == N
    with h5py.File(victim / "a.hdf5", "a") as file:
        del file[where]
        file[where] = h5py.ExternalLink("secret.h5", where)
    with pytest.raises(NotARecording, match="link"):
        import_events(victim / "a.hdf5")


def test_three_hundred_million_rows_in_a_small_file_are_refused_before_they_are_read(tmp_path):
    n = 300_000_000
    with plain(tmp_path / "a.h5", events=False) as file:
        for name, kind in COLUMNS.items():
            file.create_dataset(f"events/{name}", (n,), kind, chunks=(1 << 20,), compression=9)
            file[f"events/{name}"].id.write_direct_chunk((0,), zlib.compress(bytes(1 << 20)))
    with pytest.raises(NotARecording, match="2400000000 bytes"):
        import_events(tmp_path / "a.h5")


def test_a_chunk_may_be_stored_without_its_filters(tmp_path):
    values = np.arange(N, dtype="i8") % 2
    with plain(tmp_path / "a.h5") as file:
        del file["events/t"]
        column = file.create_dataset("events/t", (N,), "i8", chunks=(N // 2,), compression=9, shuffle=True)
        column.id.write_direct_chunk((0,), values[: N // 2].tobytes(), filter_mask=3)
        column[N // 2 :] = values[N // 2 :]
    assert np.array_equal(import_events(tmp_path / "a.h5").events.t, values)


def test_check_sums_and_every_order_of_filters_are_read(tmp_path):
    values = np.sort(np.random.default_rng(1).integers(0, 2**36, N))
    with plain(tmp_path / "a.h5") as file:
        del file["events/t"]
        packed = {"compression": 3, "shuffle": True, "fletcher32": True}
        file.create_dataset("events/t", data=values, chunks=(700,), **packed)
    assert np.array_equal(import_events(tmp_path / "a.h5").events.t, values)


def test_too_many_attributes_and_long_ones_are_refused(tmp_path):
    with plain(tmp_path / "a.h5") as file:
        file["header"].attrs["note"] = "x" * 5000
    with pytest.raises(NotARecording, match="attribute 'note'"):
        import_events(tmp_path / "a.h5")


# ---------------------------------------------------------------- NumPy


def npz(path, **other):
    arrays = {name: np.arange(N).astype(kind) % 2 for name, kind in COLUMNS.items()}
    arrays |= {f"trigger_{name}": np.zeros(1, int) for name in ("t", "value", "id")}
    np.savez_compressed(path, **{**arrays, "size": np.array([1280, 720]), **other})
    return path


class Opens:
    """Unpickled, it makes a file: what a reader of pickles would execute."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_a_pickled_object_is_not_loaded(tmp_path):
    path = npz(tmp_path / "a.npz", t=np.array([Opens(tmp_path / "executed")] * N, object))
    with pytest.raises(NotARecording, match=r"t of this \.npz file"):
        import_events(path)
    assert not (tmp_path / "executed").exists()


def test_an_archive_that_stands_for_gigabytes_is_refused(tmp_path):
    big = np.zeros(50_000_000, "u1")
    path = npz(tmp_path / "a.npz", t=big, x=big, y=big, p=big)
    assert path.stat().st_size < 1_000_000
    with pytest.raises(NotARecording, match="compressed"):
        import_events(path)


def test_an_array_that_states_more_than_its_file_holds_is_refused(tmp_path):
    path = npz(tmp_path / "a.npz")
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(tmp_path / "b.npz", "w") as new:
        for name in old.namelist():
            length = b"(9000,)" if name == "t.npy" else b"(3000,)"
            new.writestr(name, old.read(name).replace(b"(3000,)", length))
    with pytest.raises(NotARecording, match="holds no readable events"):
        import_events(tmp_path / "b.npz")


def test_an_archive_of_very_many_other_files_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        for number in range(15_000):
            file.writestr(f"{number:060d}.npy", b"")
    with pytest.raises(NotARecording, match="t is missing"):
        import_events(tmp_path / "a.npz")


# ---------------------------------------------------------------- any file


def test_a_file_with_holes_is_incomplete(tmp_path):
    path = tmp_path / "a.h5"
    plain(path).close()
    require_whole(path)
    with path.open("ab") as file:
        file.truncate(10 << 30)
    with pytest.raises(RecordingCorrupt, match="were never written") as caught:
        import_events(path)
    assert caught.value.offset < 1 << 20


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_a_pipe_and_a_folder_are_no_files(tmp_path, make):
    make(tmp_path / "a.h5")
    with pytest.raises(NotARecording, match="not a file"):
        import_events(tmp_path / "a.h5")


def test_events_are_read_and_written_piece_by_piece(tmp_path, monkeypatch):
    from drivers.camera.formats import hdf5_events

    monkeypatch.setattr(hdf5_events, "PIECE_EVENTS", 700)
    plain(tmp_path / "a.h5").close()
    with open_events(tmp_path / "a.h5") as source:
        assert [len(events.t) for events, _ in source.pieces()] == [700, 700, 700, 700, 200]
        assert source.count == N
        written = write_raw(source, tmp_path / "a.raw", source=tmp_path / "a.h5")
        assert (written.events, written.triggers) == (N, 1)
