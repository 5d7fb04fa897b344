"""The folder of one run: who may write in it, how files get their names, and what a crash left behind.

It is the record and the bundle in one. Captures and other files get their names only when they are whole
and synced (``write_atomic``, ``commit``), and are told to the journal after that: a name in the journal is
a file on the disk. One process at a time holds the folder: the lock is the kernel's, on the folder itself,
so that a dead process leaves none behind. A sealed folder is never opened for writing again.
"""

from __future__ import annotations

import os
import re
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Self

from bench.base.errors import RunFolderError, StorageError
from bench.records.captures import CAPTURES, Capture, capture_name, stored_captures
from bench.records.folder_lock import lock_folder
from bench.records.journal import Journal
from bench.records.storage import (
    is_temporary,
    make_folder,
    move_into_place,
    sha256_of,
    storage_errors,
    sync_folder,
    write_atomic,
)

JOURNAL = "journal.jsonl"
SEQUENCE_COPY = "sequence.yaml"
STATION_COPY = "station.yaml"
"""The files a run was begun with, byte for byte."""
PLAN = "plan.json"
RESULTS = "results.json"
REPORT = "report.html"
QUARANTINE = "quarantine"
MANIFEST = "SHA256SUMS"
SIGNATURE = "SHA256SUMS.sig"
_RESERVE = ".reserve"
_RESERVE_BYTES = 256 * 1024
_PART = ".part"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_DEVICE_NAMES = {"con", "prn", "aux", "nul"} | {f"{d}{n}" for d in ("com", "lpt") for n in range(1, 10)}


@dataclass(frozen=True)
class RecoveryNotes:
    """What a restart found in a run folder.

    Attributes
    ----------
    intact
        Captures the journal tells of that are as they were when stored.
    missing
        Captures the journal tells of that are gone.
    changed
        Captures that differ from what was stored; now in ``quarantine/``.
    interrupted
        Half-written recordings; now in ``quarantine/``.
    unnamed
        Whole recordings the journal does not tell of (the power went between both); in ``quarantine/``.
    """

    intact: tuple[Capture, ...] = ()
    missing: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()
    interrupted: tuple[str, ...] = ()
    unnamed: tuple[str, ...] = ()

    def as_data(self) -> dict[str, Any]:
        """Give the notes as a journal can carry them."""
        return {
            "intact": [capture.name for capture in self.intact],
            "missing": list(self.missing),
            "changed": list(self.changed),
            "interrupted": list(self.interrupted),
            "unnamed": list(self.unnamed),
        }


def is_sealed(path: Path) -> bool:
    """Whether a run folder carries a signature."""
    return (path / SIGNATURE).exists()


class RunFolder:
    """A run folder held by this process; made by ``create`` or ``open``, given back by ``close``."""

    def __init__(self, path: Path, lock: int) -> None:
        self.path = path
        self._lock = lock

    @classmethod
    def create(cls, path: Path, *, bytes_needed: int = 0) -> Self:
        """Make a new run folder, its parents included, and hold it.

        Parameters
        ----------
        path
            Must not exist, or hold no file.
        bytes_needed
            Disk space the run is expected to take; refused when there is less.

        Raises
        ------
        RunFolderError
            When it holds something already, or another process holds it.
        StorageError
            No permission, not enough space, or a file in the way.
        """
        path = path.absolute()
        make_folder(path)
        lock = lock_folder(path)
        try:
            _refuse_occupied(path)
            _refuse_full(path, bytes_needed + _RESERVE_BYTES)
            make_folder(path / CAPTURES)
            _keep_reserve(path)
        except BaseException:
            os.close(lock)
            raise
        return cls(path, lock)

    @classmethod
    def open(cls, path: Path) -> Self:
        """Hold an existing run folder, to go on with its run.

        Raises
        ------
        RunFolderError
            When there is none, it is no run, it is sealed, or another process holds it.
        StorageError
            No permission, or no space.
        """
        path = path.absolute()
        require_resumable(path)
        lock = lock_folder(path)
        try:
            if not (path / _RESERVE).exists():  # given back when the disk was full
                _keep_reserve(path)
        except BaseException:
            os.close(lock)
            raise
        return cls(path, lock)

    @property
    def journal_path(self) -> Path:
        """Where the journal lies."""
        return self.path / JOURNAL

    def write_atomic(self, name: str, data: bytes) -> Path:
        """Write a whole file, or leave what was there; synced when this returns.

        Parameters
        ----------
        name
            Path within the folder, with ``/``; folders are made.

        Raises
        ------
        RunFolderError
            When the name is not allowed.
        StorageError
            Disk full, no permission, or any other failure.
        """
        path = self._place(name)
        make_folder(path.parent)
        write_atomic(path, data)
        return path

    def part_path(self, name: str) -> Path:
        """Where somebody else writes a file (a camera, HDF5) that ``commit`` then puts in place.

        What an earlier try left there is removed.
        """
        part = self._place(name).with_name(PurePosixPath(name).name + _PART)
        make_folder(part.parent)
        with storage_errors(part), suppress(FileNotFoundError):
            part.unlink()
        return part

    def commit(self, name: str) -> Capture:
        """Sync the file written at ``part_path(name)``, hash it and give it its name.

        Raises
        ------
        RunFolderError
            When a file of that name stands already: nothing recorded is ever written over.
        StorageError
            When it is not there, or cannot be synced or renamed.
        """
        path = self._place(name)
        part = path.with_name(path.name + _PART)
        if path.exists():
            raise RunFolderError(
                "This file stands already; a recording is never written over.",
                where=str(path),
                remedy="Record the pose again as a further attempt.",
            )
        with storage_errors(part):
            capture = Capture(name, part.stat().st_size, sha256_of(part))
        move_into_place(part, path)
        return capture

    def capture_part_path(self, pose_index: int, attempt: int, ending: str = ".raw") -> Path:
        """Where the camera writes a recording until it is whole. Both numbers from 1."""
        return self.part_path(capture_name(pose_index, attempt, ending))

    def commit_capture(self, pose_index: int, attempt: int, ending: str = ".raw") -> Capture:
        """Give a whole recording its name; then it can be told to the journal. As ``commit``."""
        return self.commit(capture_name(pose_index, attempt, ending))

    def quarantine_part(self, pose_index: int, attempt: int, ending: str = ".raw") -> str | None:
        """Keep what there is of a recording that could not be completed, in ``quarantine/``.

        Returns
        -------
        str or None
            Its name there within the run folder; None when nothing had been written.

        Raises
        ------
        StorageError
            When it cannot be moved.
        """
        path = self._place(capture_name(pose_index, attempt, ending))
        part = path.with_name(path.name + _PART)
        if not part.exists():
            return None
        with storage_errors(part):
            return str(self.quarantine(part).relative_to(self.path))

    def recover(self, journal: Journal) -> RecoveryNotes:
        """Put a folder in order after a crash: what is whole and told stays, all else is set aside.

        Nothing recorded is deleted. Recordings that are half-written, changed, or not told to the journal
        move to ``quarantine/``; temporary files of reports and the like, which can be written again, go.

        Raises
        ------
        StorageError
            When a file cannot be read or moved.
        """
        told = stored_captures(journal.entries)
        found: dict[str, list[str]] = {"intact": [], "changed": [], "interrupted": [], "unnamed": []}
        make_folder(self.path / CAPTURES)
        with storage_errors(self.path):
            for path in [p for p in self.path.rglob("*") if is_temporary(p)]:
                path.unlink()
            for path in sorted((self.path / CAPTURES).iterdir()):
                name = f"{CAPTURES}/{path.name}"
                state = _state_of(path, told.get(name))
                found[state].append(name)
                if state != "intact":
                    self.quarantine(path)
        return RecoveryNotes(
            intact=tuple(told[name] for name in found["intact"]),
            missing=tuple(sorted(set(told) - set(found["intact"]) - set(found["changed"]))),
            changed=tuple(found["changed"]),
            interrupted=tuple(found["interrupted"]),
            unnamed=tuple(found["unnamed"]),
        )

    def release_reserve(self) -> None:
        """Give back the space kept for telling the journal that the disk is full."""
        with storage_errors(self.path), suppress(FileNotFoundError):
            (self.path / _RESERVE).unlink()
            sync_folder(self.path)

    def close(self) -> None:
        """Let another process hold the folder."""
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
                    f"{name!r} is not a name for a file of a run.",
                    where=str(self.path),
                    remedy="Use letters, digits, dots, dashes and underscores.",
                )
        return self.path.joinpath(*parts)

    def quarantine(self, path: Path) -> Path:
        """Move what cannot be vouched for to ``quarantine/``, never over another; return its place. Raises OSError."""
        aside = self.path / QUARANTINE
        make_folder(aside)
        number = 1
        while (target := aside / f"{path.name}.{number}").exists():
            number += 1
        path.rename(target)
        sync_folder(aside)
        sync_folder(path.parent)
        return target


def _state_of(path: Path, capture: Capture | None) -> str:
    """Tell what a crash left of a recording, as a field of RecoveryNotes."""
    if path.name.endswith(_PART):
        return "interrupted"
    if capture is None:
        return "unnamed"
    whole = path.is_file() and not path.is_symlink() and path.stat().st_size == capture.size
    return "intact" if whole and sha256_of(path) == capture.sha256 else "changed"


def require_resumable(path: Path) -> None:
    """Refuse a folder with no run in it that could go on. Raises RunFolderError."""
    if not path.is_dir():
        raise RunFolderError("There is no such run folder.", where=str(path), remedy="Check the path.")
    if not (path / JOURNAL).is_file():
        raise RunFolderError(
            f"This is not a run folder: it has no {JOURNAL}.",
            where=str(path),
            remedy="Name the folder a run was written to.",
        )
    if is_sealed(path):
        raise RunFolderError(
            "This run is finished and sealed.",
            where=str(path),
            remedy="A sealed run is never changed; start a new one, or check it with `starbench verify`.",
        )


def _refuse_occupied(path: Path) -> None:
    """Refuse a folder that holds a file, unless it is one that making this folder left when it was cut short."""
    files = (p for p in path.rglob("*") if not p.is_dir() and p.name != _RESERVE and not is_temporary(p))
    found = next(files, None)
    if found is not None:
        begun = (path / JOURNAL).exists()
        raise RunFolderError(
            f"The folder is not empty: it holds {found.relative_to(path)}.",
            where=str(path),
            remedy="Choose another --output"
            + (", or go on with its run by `starbench resume`." if begun else "."),
        )


def _refuse_full(path: Path, bytes_needed: int) -> None:
    with storage_errors(path):
        free = shutil.disk_usage(path).free
    if free < bytes_needed:
        raise StorageError(
            f"The run needs {bytes_needed / 1e6:.0f} MB and the disk has {free / 1e6:.0f} MB left.",
            where=str(path),
            remedy="Make room, or choose --output on another disk.",
        )


def _keep_reserve(path: Path) -> None:
    # Zeros would do on most file systems, but not on those that compress or leave holes.
    write_atomic(path / _RESERVE, os.urandom(_RESERVE_BYTES))
