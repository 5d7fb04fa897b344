"""A disk that fills up in the midst of a run: bounded, told, nothing lost, and the run goes on once there is room."""

import errno
import os
import shutil
import subprocess

import pytest

from bench.base.clock import BenchClock
from bench.base.errors import StorageError
from bench.record.journal import CAPTURE_STORED, Journal, capture_name, read_journal, stored_captures
from bench.record.run_folder import RunFolder


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 4 MB."""
    if os.geteuid() != 0:
        pytest.skip("mounting a small disk needs root")
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", folder]
    mounted = subprocess.run(command, capture_output=True, text=True, check=False)
    if mounted.returncode:
        pytest.skip(f"a small disk cannot be mounted here: {mounted.stderr.strip()}")
    yield folder
    subprocess.run(["umount", folder], check=True)


def record_until_full(folder, journal, first):
    """Record pose after pose; returns the number of the one that did not fit, and why."""
    pose = first
    while True:
        try:
            part = folder.part_path(capture_name(pose, 1))
            part.write_bytes(os.urandom(150_000))
            capture = folder.commit(capture_name(pose, 1))
            journal.append(CAPTURE_STORED, pose=pose, **capture.as_data())
        except (StorageError, OSError) as error:  # a camera's own writing raises OSError
            return pose, error
        pose += 1


def test_a_full_disk_loses_nothing_and_is_told_with_its_place(small_disk, tmp_path):
    (tmp_path / "runs").symlink_to(small_disk)
    path = tmp_path / "runs" / "run"
    with RunFolder.create(path) as folder, Journal.create(folder.journal_path, BenchClock()) as journal:
        failed, error = record_until_full(folder, journal, 1)
        assert failed > 10
        assert isinstance(error, StorageError) or error.errno == errno.ENOSPC
        (path / "filler").write_bytes(b"0" * max(0, shutil.disk_usage(path).free))  # not one byte is left
        with pytest.raises(StorageError, match="disk is full") as refused:
            folder.write_atomic("results.json", b"x" * 5000)
        assert f" {small_disk}," in refused.value.remedy
        folder.release_reserve()
        journal.append("disk_full", pose=failed)
    entries, torn = read_journal(path / "journal.jsonl")
    assert torn == b""
    assert entries[-1].event == "disk_full"
    assert len(stored_captures(entries)) == failed - 1
    assert not list(path.rglob("*.tmp"))
