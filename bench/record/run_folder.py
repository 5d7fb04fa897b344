"""The folder of one run: its lock, and how its files get their names.

A file gets its name when it is complete and synced; the journal names it after that. One process at a time works in the
folder; a sealed one is never opened for writing again.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Container
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Self

from bench.base.encoding import size_text
from bench.base.errors import RunFolderError, StorageError, UsageError
from bench.base.pasteable import pasteable
from bench.record.folder_lock import lock_folder
from bench.record.journal import CAPTURES, Capture
from bench.record.storage import (
    SEAL,
    is_temporary,
    make_folder,
    move_into_place,
    read_bounded,
    sha256_of,
    storage_errors,
    write_atomic,
)
from drivers.durable import sync_folder

JOURNAL = "journal.jsonl"
SEQUENCE_COPY = "sequence.yaml"
STATION_COPY = "station.yaml"
"""Byte-exact copies of the files that the run was started with."""
PASSPORT_COPY = "passport.json"
"""Byte-exact copy of the passport of the collimator that the run uses; runs without a passport have none."""
CHECKED_COPY = "checked-calibration"
"""Byte-exact copy of the calibration that a step ``check`` of the run checks; other runs have none."""
PLAN = "plan.json"
RESULTS = "results.json"
SOURCES = "sources.json"
"""In the folder of a recalculation: what it was calculated from."""
CERTIFICATE = "certificate.json"
"""In the folder of a certificate: all that it states. Its other files follow from this one and from the results."""
REPORT = "report.html"
PAGE_SIGNATURE = f"{REPORT}.sig"
"""Signature of the page of a run that failed or was aborted."""
QUARANTINE = "quarantine"
MANIFEST = "SHA256SUMS"
SIGNATURE = SEAL
_RESERVE = ".reserve"
RESERVE_BYTES = 256 * 1024  # The journal's last lines and the list of files of a full disk
PART = ".part"
"""Ending of a file that is not complete yet."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_DEVICE_NAMES = {"con", "prn", "aux", "nul"} | {f"{d}{n}" for d in ("com", "lpt") for n in range(1, 10)}


def is_sealed(path: Path) -> bool:
    """Return whether a run folder has a signature, which is not verified."""
    return (path / SIGNATURE).exists()


class RunFolder:
    """A run folder that this process has locked, from ``create`` or ``open`` until ``close``."""

    def __init__(self, path: Path, lock: int) -> None:
        self.path = path
        self._lock = lock

    @classmethod
    def create(
        cls, path: Path, *, bytes_needed: int = 0, bytes_kept_free: int = 0, documents: Container[str] = ()
    ) -> Self:
        """Make a new or empty run folder, with its parents, and lock it; there must be room for both numbers of bytes.

        ``bytes_kept_free`` is what the station wants to stay free afterwards, ``documents`` what it writes first.
        """
        path = path.absolute()
        make_folder(path)
        lock = lock_folder(path)
        try:
            _clear_unbegun(path, documents)
            _refuse_occupied(path)
            _refuse_full(path, bytes_needed + RESERVE_BYTES, bytes_kept_free)
            make_folder(path / CAPTURES)
            _keep_reserve(path)
        except BaseException:
            os.close(lock)
            raise
        return cls(path, lock)

    @classmethod
    def open(cls, path: Path) -> Self:
        """Lock an existing run folder, not sealed and not locked by another process, to continue its run."""
        path = path.absolute()
        require_resumable(path)
        lock = lock_folder(path)
        try:
            if not (path / _RESERVE).exists():  # it was released when the disk was full
                _keep_reserve(path)
        except BaseException:
            os.close(lock)
            raise
        return cls(path, lock)

    @property
    def journal_path(self) -> Path:
        """Path of the journal."""
        return self.path / JOURNAL

    def write_atomic(self, name: str, data: bytes) -> Path:
        """Write and sync a file whole, or leave its old contents; ``name`` is a path within the folder, with ``/``."""
        path = self._place(name)
        make_folder(path.parent)
        write_atomic(path, data)
        return path

    def part_path(self, name: str) -> Path:
        """Return where other code writes a file, to which ``commit`` then gives its name; one left there is removed."""
        part = self._place(name).with_name(PurePosixPath(name).name + PART)
        make_folder(part.parent)
        with storage_errors(part), suppress(FileNotFoundError):
            part.unlink()
        return part

    def commit(self, name: str, goes_on: Callable[[], object] = lambda: None) -> Capture:
        """Sync the file at ``part_path(name)`` and give it its name; after that the journal may name it.

        ``goes_on`` is as for `sha256_of`.
        """
        path = self._place(name)
        part = path.with_name(path.name + PART)
        if path.exists():
            raise RunFolderError(
                "This file exists already; a recording is never overwritten.",
                where=str(path),
                remedy="Record the pose again as a further attempt.",
            )
        with storage_errors(part):
            capture = Capture(name, part.stat().st_size, sha256_of(part, goes_on))
        move_into_place(part, path)
        return capture

    def quarantine_part(self, name: str) -> str | None:
        """Move an incomplete recording to ``quarantine/``: its new path in the run folder; None if there was none."""
        path = self._place(name)
        part = path.with_name(path.name + PART)
        if not part.exists():
            return None
        with storage_errors(part):
            return str(self.quarantine(part).relative_to(self.path))

    def release_reserve(self) -> None:
        """Release the reserved disk space, so that the journal can still state that the disk is full."""
        with storage_errors(self.path), suppress(FileNotFoundError):
            (self.path / _RESERVE).unlink()
            sync_folder(self.path)

    def close(self) -> None:
        """Release the lock."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _place(self, name: str) -> Path:
        parts = name.split("/")
        for part in parts:
            if not _NAME.fullmatch(part) or ".." in part or part.split(".")[0].lower() in _DEVICE_NAMES:
                raise RunFolderError(
                    f"{name!r} is not a valid name of a file in a run folder.",
                    where=str(self.path),
                    remedy="Use letters, digits, dots, dashes and underscores.",
                )
        return self.path.joinpath(*parts)

    def quarantine(self, path: Path) -> Path:
        """Move a file that the journal does not confirm to ``quarantine/``. Nothing there is overwritten."""
        aside = self.path / QUARANTINE
        make_folder(aside)
        number = 1
        while (target := aside / f"{path.name}.{number}").exists():
            number += 1
        path.rename(target)
        sync_folder(aside)
        sync_folder(path.parent)
        return target


def require_run(path: Path) -> None:
    """Refuse a folder in which no run has begun."""
    if not (path / JOURNAL).is_file():
        what = f"This is not a run folder: it has no {JOURNAL}."
        raise RunFolderError(what, where=str(path), remedy="Name the folder that a run was written to.")


def require_resumable(path: Path) -> None:
    """Refuse a folder that is missing, is no run folder, or is sealed: its run cannot be continued."""
    if not path.is_dir():
        raise RunFolderError("There is no such run folder.", where=str(path), remedy="Check the path.")
    require_run(path)
    if is_sealed(path):
        raise RunFolderError(
            "This run is finished and sealed.",
            where=str(path),
            remedy=f"A sealed run is never changed. Start a new run. To check this one: {pasteable('verify', path)}",
        )


def _clear_unbegun(path: Path, documents: Container[str]) -> None:
    """Remove what a run left that ended before the first line of its journal: nothing was recorded yet.

    The reserve, the first file of a run, shows that the folder was empty before, and that documents in it are a run's.
    """
    with storage_errors(path):
        reserve, journal = path / _RESERVE, path / JOURNAL
        if not reserve.is_file() or reserve.stat().st_size != RESERVE_BYTES:
            return
        if (journal.is_file() and b"\n" in read_bounded(journal)) or any((path / CAPTURES).glob("*")):
            return
        for file in [file for file in path.iterdir() if file == journal or file.name in documents]:
            file.unlink()


def _refuse_occupied(path: Path) -> None:
    """Refuse a folder with a file in it, unless an interrupted ``create`` of this folder left that file."""
    files = (p for p in path.rglob("*") if not p.is_dir() and p.name != _RESERVE and not is_temporary(p))
    occupant = next(files, None)
    if occupant is not None:
        begun = (path / JOURNAL).exists() and not is_sealed(path)
        raise UsageError(
            f"The folder is not empty: it contains {occupant.relative_to(path)}.",
            where=str(path),
            remedy="Choose another --output"
            + (f", or continue its run: {pasteable('resume', path)}" if begun else "."),
        )


def _refuse_full(path: Path, bytes_needed: int, bytes_kept_free: int) -> None:
    with storage_errors(path):
        free = shutil.disk_usage(path).free
    if free < bytes_needed + bytes_kept_free:
        needs = size_text(bytes_needed)
        if bytes_kept_free:
            needs += f" and {size_text(bytes_kept_free)} must stay free (disk: min_free_gb of the station)"
        raise StorageError(
            f"The run needs {needs}, but the disk has only {size_text(free)} left.",
            where=str(path),
            remedy="Make room, or choose --output on another disk.",
        )


def _keep_reserve(path: Path) -> None:
    # Random bytes: a file system that compresses, or stores holes, would not reserve space for zeros.
    write_atomic(path / _RESERVE, os.urandom(RESERVE_BYTES))
