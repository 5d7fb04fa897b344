"""Whatever call to the system a run dies in, or is refused: what was acknowledged is there, and the run goes on.

A small run is repeated; each time the next of its calls (open, write, sync, rename, make, remove) is the one that
kills the process, or fails. Death is an exception that nothing of ours catches.
"""

import errno
import os
from contextlib import suppress
from pathlib import Path

import pytest
from journals import CLOCK
from unchecked_seal import seal_unchecked

from bench.base.errors import StorageError
from bench.evidence.verify import verify_folder
from bench.record.journal import CAPTURE_STORED, Journal, capture_name, read_journal, stored_captures
from bench.record.recovery import recover
from bench.record.run_folder import RunFolder

POSES = 3


@pytest.fixture(autouse=True)
def _no_real_syncs(monkeypatch):
    """A process that dies takes no written page with it: syncs are counted here, and cost nothing."""
    monkeypatch.setattr(os, "fsync", lambda _descriptor: None)


class Died(BaseException):
    """The process is gone."""


class Fault:
    """Lets so many calls pass and spoils the next; counts them all."""

    def __init__(self, monkeypatch, passing, spoil):
        self.calls, self.passing, self.spoil, self.log = 0, passing, spoil, []
        for owner, name in (
            (os, "open"),
            (os, "write"),
            (os, "fsync"),
            (os, "ftruncate"),
            (os, "truncate"),
            (Path, "rename"),
            (Path, "replace"),
            (Path, "unlink"),
            (Path, "mkdir"),
            (Path, "chmod"),
        ):
            self._wrap(monkeypatch, owner, name, getattr(owner, name))

    def _wrap(self, monkeypatch, owner, name, real):
        def call(*args, **kwargs):
            self.calls += 1
            self.log.append(name)
            if self.calls == self.passing + 1:
                return self.spoil(name, real, args, kwargs)
            return real(*args, **kwargs)

        monkeypatch.setattr(owner, name, call)


def die_before(_name, _real, _args, _kwargs):
    raise Died


def die_after(name, real, args, kwargs):
    if name == "write":  # half of it reached the disk
        real(args[0], bytes(args[1])[: len(args[1]) // 2])
    else:
        with suppress(FileNotFoundError):
            real(*args, **kwargs)
    raise Died


def refuse(number):
    def spoil(name, _real, args, _kwargs):
        raise OSError(
            number, os.strerror(number), str(args[0]) if name not in {"write", "fsync", "ftruncate"} else None
        )

    return spoil


def recording(pose):
    return f"recording of pose {pose}".encode() * 20


def run_once(path, acknowledged, key=None):
    """Do what is not yet done of a run of some poses; what is acknowledged is noted as soon as it is."""
    exists = (path / "journal.jsonl").exists()
    with RunFolder.open(path) if exists else RunFolder.create(path) as folder:
        opened = Journal.open if exists else Journal.create
        with opened(folder.journal_path, CLOCK) as journal:
            if exists:
                recover(folder, journal)
            done = {e.data["pose"] for e in journal.entries if e.event == CAPTURE_STORED}
            for pose in range(1, POSES + 1):
                if pose not in done:
                    folder.part_path(capture_name(pose, 1)).write_bytes(recording(pose))
                    capture = folder.commit(capture_name(pose, 1))
                    journal.append(CAPTURE_STORED, pose=pose, **capture.as_data())
                    acknowledged[pose] = capture
            folder.write_atomic("exports/opencv.yaml", b"fx: 1\n" * 100)
            journal.append("finished")
        if key is not None:
            folder.release_reserve()
            seal_unchecked(path, key)


def see_that_nothing_acknowledged_is_lost(path, acknowledged):
    entries, _ = read_journal(path / "journal.jsonl") if (path / "journal.jsonl").exists() else ([], b"")
    stored = stored_captures(entries)
    for pose, capture in acknowledged.items():
        assert stored[capture.name] == capture
        assert (path / capture.name).read_bytes() == recording(pose)


def see_that_it_is_whole(path):
    """Finished, each pose once, nothing half-written under a final name."""
    entries, torn = read_journal(path / "journal.jsonl")
    assert torn == b""
    assert [e.data["pose"] for e in entries if e.event == CAPTURE_STORED] == list(range(1, POSES + 1))
    assert entries[-1].event == "finished"
    captures = sorted(p.name for p in (path / "captures").iterdir())
    assert captures == [f"pose-{pose:03d}-attempt-1.raw" for pose in range(1, POSES + 1)]
    for pose, name in enumerate(captures, 1):
        assert (path / "captures" / name).read_bytes() == recording(pose)
    assert (path / "exports" / "opencv.yaml").read_bytes() == b"fx: 1\n" * 100
    assert not list(path.rglob("*.tmp"))


def seal_faults(path, signers):
    """Faults of the seal and of the listed files; the journal here is no run's, so its content is not judged."""
    of_content = {"journal", "plan", "results"}
    return [fault for fault in verify_folder(path, signers).faults if fault.kind not in of_content]


def calls_of_a_whole_run(tmp_path, monkeypatch, key):
    with monkeypatch.context() as patch:
        fault = Fault(patch, 10**9, die_before)
        run_once(tmp_path / "undisturbed", {}, key)
    return fault.log


def see_that_it_goes_on(path, acknowledged, key, signers):
    see_that_nothing_acknowledged_is_lost(path, acknowledged)
    if not (path / "SHA256SUMS.sig").exists():
        run_once(path, acknowledged, key)
    see_that_it_is_whole(path)
    assert seal_faults(path, signers) == []


@pytest.mark.parametrize(
    ("spoil", "error"),
    [
        (die_before, Died),
        (die_after, Died),
        (refuse(errno.ENOSPC), StorageError),
        (refuse(errno.EACCES), StorageError),
    ],
    ids=["killed before", "killed after", "disk full", "no permission"],
)
def test_a_run_whose_call_kills_or_fails_can_be_resumed(tmp_path, monkeypatch, key, signers, spoil, error):
    log = calls_of_a_whole_run(tmp_path, monkeypatch, key)
    assert {"open", "write", "fsync", "rename", "mkdir", "unlink", "chmod"} <= set(log)
    for passing in range(len(log)):
        path, acknowledged = tmp_path / f"run{passing}", {}
        with monkeypatch.context() as patch:
            Fault(patch, passing, spoil)
            with pytest.raises(error) as caught:
                run_once(path, acknowledged, key)
        if error is StorageError:
            assert caught.value.where.startswith(str(tmp_path)), log[passing]
            assert caught.value.remedy
        see_that_it_goes_on(path, acknowledged, key, signers)
