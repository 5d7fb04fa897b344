"""New RAW files: never over another one, whole and readable however the writing ends."""

import errno
import os
from pathlib import Path

import pytest

from drivers.camera.raw_writer import RawWriter, check_new, check_space, sync_file
from drivers.errors import RecordingFailed


def test_an_existing_file_is_left_as_it_is(tmp_path):
    (tmp_path / "a.raw").write_bytes(b"precious")
    with pytest.raises(RecordingFailed, match="never overwritten"):
        RawWriter(tmp_path / "a.raw", b"head")
    assert (tmp_path / "a.raw").read_bytes() == b"precious"


def test_an_error_inside_leaves_what_was_written_and_is_passed_on(tmp_path):
    file = RawWriter(tmp_path / "a.raw", b"head")
    file.write(b"12")
    with pytest.raises(KeyboardInterrupt), file:
        raise KeyboardInterrupt
    assert (tmp_path / "a.raw").read_bytes() == b"head12"


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (errno.ENOSPC, r"disk is full.*recorded before is kept.*Free space"),
        (errno.EDQUOT, "quota is used up"),
        (errno.EACCES, "no write permission"),
        (errno.EROFS, "read-only"),
        (errno.ENOTDIR, "no folder"),
        (errno.EIO, "cannot be written"),
    ],
)
def test_each_refusal_of_the_disk_has_its_words(tmp_path, monkeypatch, code, message):
    def refuse(*_):
        raise OSError(code, os.strerror(code))

    file = RawWriter(tmp_path / "a.raw", b"head")
    with file:
        monkeypatch.setattr(os, "write", refuse)
        with pytest.raises(RecordingFailed, match=message):
            file.write(b"12")
        monkeypatch.undo()


def test_a_disk_that_takes_little_at_a_time_gets_all_of_it(tmp_path, monkeypatch):
    real_write = os.write
    monkeypatch.setattr(os, "write", lambda handle, data: real_write(handle, bytes(data[:3])))
    with RawWriter(tmp_path / "a.raw", b"head") as file:
        file.write(b"1234567")
    assert (tmp_path / "a.raw").read_bytes() == b"head1234567"


@pytest.fixture
def unsynced(tmp_path, monkeypatch):
    """A file whose syncs fail."""

    def refuse(_):
        raise OSError(errno.EIO, "Input/output error")

    file = RawWriter(tmp_path / "a.raw", b"head")
    monkeypatch.setattr(os, "fsync", refuse)
    return file


def test_a_sync_that_fails_fails_the_recording(unsynced):
    with pytest.raises(RecordingFailed, match="cannot be written"), unsynced:
        unsynced.write(b"12")


def test_a_first_error_is_not_hidden_by_a_failing_sync(unsynced):
    with pytest.raises(KeyboardInterrupt), unsynced:
        raise KeyboardInterrupt


def test_places_that_cannot_be_written_are_told_before(tmp_path, monkeypatch):
    check_new(tmp_path / "a.raw")
    with pytest.raises(RecordingFailed, match="no such folder"):
        check_new(tmp_path / "none" / "a.raw")
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(RecordingFailed, match="no write permission"):
        check_new(tmp_path / "a.raw")


def test_a_disk_that_is_nearly_full_is_told_before_recording(tmp_path, monkeypatch):
    check_space(tmp_path / "a.raw")
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 1000})())
    with pytest.raises(RecordingFailed, match="disk is full"):
        check_space(tmp_path / "a.raw")


def test_a_folder_that_may_not_even_be_looked_into_is_told(tmp_path, monkeypatch):
    def refuse(path, *_arguments, **_how):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "exists", refuse)
    with pytest.raises(RecordingFailed, match="no write permission"):
        check_new(tmp_path / "a.raw")
    with pytest.raises(RecordingFailed, match="no write permission"):
        sync_file(tmp_path / "a.raw")
