"""The run folder: one holder, whole files only, and order after a crash."""

import os
import pwd
import re
import shutil
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

import pytest
from refusals import denied, full
from running import python

from bench.base.clock import VirtualClock
from bench.base.errors import RunFolderError, StorageError, UsageError
from bench.record import run_folder as run_folder_module
from bench.record.journal import CAPTURE_STORED, Journal, capture_name, stored_captures
from bench.record.recovery import recover
from bench.record.run_folder import RunFolder
from bench.record.storage import HASH_CHUNK_BYTES, write_atomic

HOLD = "import sys; from pathlib import Path; from bench.record.run_folder import RunFolder; RunFolder.open(Path(sys.argv[1]))"


def begin_journal(folder):
    return Journal.create(folder.journal_path, VirtualClock(datetime(2026, 1, 1, tzinfo=UTC)))


def record(folder, pose, attempt, data):
    folder.part_path(capture_name(pose, attempt)).write_bytes(data)
    return folder.commit(capture_name(pose, attempt))


@pytest.fixture
def run(tmp_path):
    with RunFolder.create(tmp_path / "runs" / "one") as folder:
        yield folder


@pytest.fixture
def journal(run):
    with begin_journal(run) as journal:
        yield journal


def visible(path):
    return sorted(
        str(p.relative_to(path)) for p in path.rglob("*") if p.is_file() and not p.name.startswith(".")
    )


# ------------------------------------------------------------------ making and holding


def test_a_folder_that_holds_something_is_refused_left_alone_and_not_left_locked(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match=r"contains notes.txt.*--output"):
        RunFolder.create(tmp_path)
    assert visible(tmp_path) == ["notes.txt"]
    assert not (tmp_path / "captures").exists()
    (tmp_path / "notes.txt").unlink()
    RunFolder.create(tmp_path).close()


def test_too_little_space_is_told_before_anything_starts(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(run_folder_module, "RESERVE_BYTES", 10**15)
        with pytest.raises(StorageError, match="Make room"):
            RunFolder.create(tmp_path / "run")
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: SimpleNamespace(free=5_000_000))
    with pytest.raises(StorageError, match=r"80 MB, .* 5 MB"):
        RunFolder.create(tmp_path / "run", bytes_needed=80_000_000)
    with pytest.raises(StorageError, match=r"9\.0 GB .*min_free_gb"):
        RunFolder.create(tmp_path / "run", bytes_needed=1_000_000, bytes_kept_free=9_000_000_000)


def test_a_second_process_is_refused_and_the_first_one_s_end_frees_the_folder(run, journal):
    refused = python("-c", HOLD, run.path, status=1)
    assert "Another process" in refused.stderr
    if Path("/proc/locks").exists():  # who holds it: process, user, since when, and the folder
        user = pwd.getpwuid(os.getuid()).pw_name
        assert f"process {os.getpid()} of {user}, since 20" in refused.stderr
        assert f"UTC, in {run.path}" in refused.stderr
    run.close()
    python("-c", HOLD, run.path)


@pytest.mark.parametrize(
    ("what", "says"),
    [("absent", "no such run folder"), ("no journal", "not a run folder"), ("sealed", "finished and sealed")],
)
def test_what_cannot_be_gone_on_with_is_refused(tmp_path, what, says):
    path = tmp_path / "run"
    if what != "absent":
        with RunFolder.create(path) as folder:
            if what == "sealed":
                begin_journal(folder).close()
                folder.write_atomic("SHA256SUMS.sig", b"signature")
    with pytest.raises(RunFolderError, match=says):
        RunFolder.open(path)


@pytest.mark.parametrize("sealed", [False, True])
def test_a_new_run_in_the_folder_of_another_offers_resume_only_if_that_can_work(tmp_path, sealed):
    path = tmp_path / "cam 7"
    with RunFolder.create(path) as folder:
        with begin_journal(folder) as journal:
            journal.append(CAPTURE_STORED, capture="captures/x.raw")
        if sealed:
            folder.write_atomic("SHA256SUMS.sig", b"signature")
    with pytest.raises(UsageError, match="not empty") as refused:
        RunFolder.create(path)
    assert (f"starbench resume '{path}'" in refused.value.remedy) == (not sealed)


# ------------------------------------------------------------------ whole files


@pytest.mark.parametrize("written_as", ["my.yaml", ".out.tmp/my.yaml"])
def test_a_file_that_may_not_be_written_is_named_by_its_own_name(tmp_path, monkeypatch, written_as):
    monkeypatch.setattr(os, "open", denied)
    known = tmp_path / written_as.replace(".out.tmp", "out")
    with pytest.raises(StorageError, match=re.escape(f"{known}: No permission")):
        write_atomic(tmp_path / written_as, b"")


@pytest.mark.parametrize("call", ["write", "fsync"])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(run, monkeypatch, call):
    run.write_atomic("results.json", b"old")

    monkeypatch.setattr(os, call, full)
    with pytest.raises(StorageError, match=r"results.json: .*full"):
        run.write_atomic("results.json", b"new")
    monkeypatch.undo()
    assert (run.path / "results.json").read_bytes() == b"old"
    assert not list(run.path.rglob("*.tmp"))


BAD_NAMES = [
    "", ".", "..", "../x", "/etc/x", "a/../b", "a//b", "a/", ".hidden", "a b", "a\\b", "a\n", "x..y", "nul",
    "COM1.txt", "a/con", "ä", "a:b", "a" * 65, "-rf",
]  # fmt: skip


@pytest.mark.parametrize("name", BAD_NAMES)
def test_names_that_lead_elsewhere_are_refused(run, name):
    with pytest.raises(RunFolderError, match="not a valid name"):
        run.write_atomic(name, b"")


def test_a_resumed_run_has_its_reserve_again_unless_the_disk_is_full(run, journal, monkeypatch):
    reserve = run.path / ".reserve"
    assert reserve.stat().st_size > 100_000
    for _ in range(2):
        run.release_reserve()
        assert not reserve.exists()
    run.close()

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(StorageError, match="disk is full"):
            RunFolder.open(run.path)
    with RunFolder.open(run.path):
        assert reserve.stat().st_size > 100_000


# ------------------------------------------------------------------ captures


def test_a_file_its_folder_and_the_names_of_new_folders_are_synced(run, tmp_path, synced):
    run.write_atomic("exports/camera.yaml", b"new")
    assert synced == [run.path, run.path / "exports/.camera.yaml.tmp", run.path / "exports"]
    synced.clear()
    RunFolder.create(tmp_path / "more" / "one").close()
    assert synced[:2] == [tmp_path, tmp_path / "more"]


def test_a_capture_is_synced_before_and_after_it_gets_its_name(run, monkeypatch):
    part = run.part_path(capture_name(1, 1))
    part.write_bytes(b"abc")
    calls = []
    real_fsync, real_rename = os.fsync, type(part).rename

    def fsync(descriptor):
        calls.append(f"sync {Path(f'/proc/self/fd/{descriptor}').readlink().name}")
        real_fsync(descriptor)

    def rename(self, target):
        calls.append("rename")
        return real_rename(self, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(type(part), "rename", rename)
    run.commit(capture_name(1, 1))
    assert calls == ["sync pose-001-attempt-1.raw.part", "rename", "sync captures"]


def test_a_capture_is_never_written_over(run):
    record(run, 1, 1, b"first")
    run.part_path(capture_name(1, 1)).write_bytes(b"second")
    with pytest.raises(RunFolderError, match="never overwritten"):
        run.commit(capture_name(1, 1))
    assert (run.path / capture_name(1, 1)).read_bytes() == b"first"


# ------------------------------------------------------------------ after a crash


def moved_behind_a_link(path):
    path.rename(path.parents[1] / "elsewhere.raw")
    path.symlink_to(path.parents[1] / "elsewhere.raw")


@pytest.mark.parametrize(
    ("named", "harm", "state"),
    [
        (True, Path.exists, "intact"),
        (True, lambda path: path.write_bytes(b"abd"), "changed"),
        (True, lambda path: path.write_bytes(b"abcd"), "changed"),
        (True, lambda path: path.write_bytes(b""), "changed"),
        (True, moved_behind_a_link, "changed"),
        (True, Path.unlink, "missing"),
        (False, Path.exists, "unnamed"),
    ],
)
def test_after_a_crash_only_a_whole_capture_that_the_journal_names_stays(run, journal, named, harm, state):
    capture = record(run, 1, 1, b"abc")
    if named:
        journal.append(CAPTURE_STORED, pose=1, attempt=1, **capture.as_data())
        assert stored_captures(journal.entries) == {capture.name: capture}
    path = run.path / capture.name
    harm(path)
    notes = recover(run, journal)
    assert {name: captures for name, captures in notes.items() if captures} == {state: [capture.name]}
    assert path.exists() is (state == "intact")
    if not named:
        assert (run.path / "quarantine/pose-001-attempt-1.raw.1").read_bytes() == b"abc"
        assert not any(recover(run, journal).values())
        journal.append(CAPTURE_STORED, capture="captures/x.raw")
        with pytest.raises(RunFolderError, match="name, size or hash"):
            recover(run, journal)


def test_what_is_set_aside_twice_is_kept_twice(run, journal):
    for data in (b"one", b"two"):
        record(run, 1, 1, data)
        recover(run, journal)
    kept = sorted(p.read_bytes() for p in (run.path / "quarantine").iterdir())
    assert kept == [b"one", b"two"]


def test_work_is_seen_to_go_on_while_a_long_recording_is_hashed(run):
    pieces = []
    run.part_path(capture_name(1, 1)).write_bytes(bytes(3 * HASH_CHUNK_BYTES + 1))
    run.commit(capture_name(1, 1), goes_on=lambda: pieces.append(1))
    assert len(pieces) == 4


# ---------------------------------------------------------------- a run that ended before its first line


def test_a_folder_that_a_run_left_before_its_first_line_is_used_by_the_same_command(tmp_path):
    with RunFolder.create(tmp_path / "run") as folder:
        folder.write_atomic("sequence.yaml", b"name: one")
        begin_journal(folder).close()
        (folder.path / "plan.json").write_bytes(b"{}")
    documents = ("sequence.yaml", "plan.json")
    with RunFolder.create(tmp_path / "run", documents=documents) as folder:
        assert visible(folder.path) == []
    (tmp_path / "run" / "notes.txt").touch()  # a person's
    with pytest.raises(UsageError, match=r"notes\.txt"):
        RunFolder.create(tmp_path / "run", documents=documents)
    assert (tmp_path / "run" / "notes.txt").exists()
