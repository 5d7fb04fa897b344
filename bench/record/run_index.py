"""An index of the runs of a bench, made from their journals, to list, filter and compare them.

One SQLite file beside the signing key, made anew when its schema (``user_version``) has changed or it is damaged; a row
when journal, results.json or the folder have changed.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError, JournalBroken, RunFolderError, StorageError
from bench.record.coverage import Estimate
from bench.record.folder_lock import is_locked
from bench.record.ledger_marks import KnownRun
from bench.record.run_facts import (
    IndexedRun,
    JournalDetails,
    RunDetails,
    journal_details,
    run_facts,
    with_results,
)
from bench.record.run_folder import JOURNAL, RESULTS, is_sealed
from bench.record.storage import make_folder, storage_errors
from bench.record.stored_run import StoredRun

INDEX = "runs.sqlite3"
QUEUE_COPY = "queue.yaml"
"""A file that the folder of a batch has and a run folder has not."""
VERSION = 16  # One more whenever tables or facts change
COMMIT_EVERY = 100
"""Rows between two commits, so that another process that starts a run does not wait for a long list."""
_ASKED_AT_ONCE = 500
"""Folders in one question to the index: any SQLite takes 999 values."""
_SCHEMA = f"""
CREATE TABLE runs (folder TEXT PRIMARY KEY, stamp TEXT, id TEXT, ledger_number INTEGER, ledger_head TEXT, found TEXT)
    WITHOUT ROWID;
CREATE TABLE details (folder TEXT PRIMARY KEY, journal TEXT, whole TEXT) WITHOUT ROWID;
CREATE TABLE states (folder TEXT PRIMARY KEY, stamp TEXT, state TEXT) WITHOUT ROWID;
PRAGMA user_version = {VERSION};
"""
"""``found`` holds `run_facts` as JSON, ``journal`` the `journal_details`, and ``whole``
these with the results, once somebody has asked for them; ``stamp`` tells which files they were read from. States have a
stamp of their own."""
_ENCODER = json.JSONEncoder(separators=(",", ":"))


# Paths as text: a list has ten thousand of them, and the methods of ``Path`` take several times as long.
_exists, _stat = os.path.exists, os.stat


def is_batch(folder: Path) -> bool:
    """Return whether a folder is a batch's: it holds a queue and a journal."""
    return (folder / QUEUE_COPY).is_file() and (folder / JOURNAL).is_file()


def require_batch(folder: Path) -> None:
    """Refuse a folder that is not a batch's."""
    if not is_batch(folder):
        raise RunFolderError(
            "There is no batch in this folder.",
            where=str(folder),
            remedy="Give the --output folder of `starbench batch`.",
        )


def run_folders(root: Path) -> list[Path]:
    """Find the run folders in a folder, sorted: itself, its subfolders, and theirs; a batch's is not one."""
    if not root.is_dir():
        raise StorageError(
            "There is no such folder.", where=str(root), remedy="Name a folder that contains runs."
        )
    with storage_errors(root):
        os.scandir(root).close()  # "no runs" is said only of a folder that was read
        folders = sorted(_with_journal(str(root), levels=2))
    return [Path(folder) for folder in folders]


def _with_journal(folder: str, levels: int) -> Iterator[str]:
    """Yield a folder if it is a run's, else the run folders some levels below it; what cannot be entered has none."""
    if _exists(f"{folder}/{JOURNAL}") and not _exists(f"{folder}/{QUEUE_COPY}"):
        yield folder
    elif levels:
        with suppress(PermissionError), os.scandir(folder) as inside:
            for entry in inside:
                if entry.is_dir():
                    yield from _with_journal(entry.path, levels - 1)


class RunIndex:
    """The index. Every method opens the file anew, because other processes use it too."""

    def __init__(self, home: Path) -> None:
        self.path = home / INDEX

    def runs(
        self,
        folders: Iterable[Path],
        *,
        camera: str | None = None,
        since: datetime | None = None,
        until: datetime | None = None,
        sequence: str | None = None,
        how: str | None = None,
        progress: Callable[[int], object] = lambda _more: None,
    ) -> tuple[list[IndexedRun], list[str]]:
        """List runs, oldest first, and a sentence for each folder that cannot be read; None stands for any.

        A run began at or after ``since`` and before ``until``; ``sequence`` is a part of the name. ``progress`` is told
        how many more runs are listed, again and again.
        """
        indexed, faults = [], []
        wanted = list(dict.fromkeys(map(os.path.realpath, folders)))
        with self._open() as index:
            kept = {row[0]: row[1:] for row in _rows(index, "runs", wanted)}
            for place, folder in enumerate(wanted):
                try:
                    indexed.append(_run(index, folder, kept.get(folder)))
                except BenchError as error:
                    faults.append(str(error))
                if place % COMMIT_EVERY == 0:
                    index.commit()
                    progress(COMMIT_EVERY)
        chosen = [
            run
            for run in indexed
            if camera in {None, run.camera}
            and _is_between(run.begun_utc, since, until)
            and (sequence is None or sequence.casefold() in run.sequence.casefold())
            and how in {None, run.how}
        ]
        return sorted(chosen, key=lambda run: (run.begun_utc, run.folder)), faults

    def details(self, runs: Iterable[IndexedRun]) -> Iterator[tuple[IndexedRun, RunDetails]]:
        """Yield runs that ``runs`` has listed, in the same order, with their details."""
        with self._open() as index:
            for run in runs:
                folder = Path(run.folder)
                row = index.execute(
                    "SELECT journal, whole FROM details WHERE folder = ?", (run.folder,)
                ).fetchone()
                if row and row[1]:
                    yield run, json.loads(row[1])
                    continue
                # Without a row, the index was deleted since.
                whole = with_results(json.loads(row[0]) if row else _read(folder)[1], folder)
                index.execute("UPDATE details SET whole = ? WHERE folder = ?", (_packed(whole), run.folder))
                yield run, whole

    def states(self, folders: Iterable[str]) -> dict[str, tuple[str, str]]:
        """Return the stamp and the state that `keep_states` kept of folders, where it did."""
        with self._open() as index:
            return {folder: (stamp, state) for folder, stamp, state in _rows(index, "states", folders)}

    def keep_states(self, states: Mapping[str, tuple[str, str]]) -> None:
        """Keep the states of folders as evidence, each with a stamp of what it follows from."""
        with self._open() as index:
            rows = ((folder, *kept) for folder, kept in states.items())
            index.executemany("INSERT OR REPLACE INTO states VALUES (?, ?, ?)", rows)

    def entered(self) -> list[KnownRun]:
        """List the runs of the index that name their line in a ledger. No run folder is read."""
        if not self.path.exists():
            return []
        with self._open() as index:
            rows = index.execute(
                "SELECT folder, id, ledger_number, ledger_head FROM runs"
                " WHERE ledger_number IS NOT NULL AND ledger_head IS NOT NULL ORDER BY folder"
            )
            return [KnownRun(*row) for row in rows]

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        make_folder(self.path.parent)
        try:
            with closing(self._connected()) as index, index:
                yield index
        except sqlite3.Error as error:
            remedy = "Change mode or owner of its folder, so that it can be made."
            if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
                remedy = "Make room on its disk."
            elif self.path.exists():
                remedy = "Delete it. Starbench makes it again from the journals."
            raise StorageError(
                f"The index of runs cannot be used: {error}.",
                where=str(self.path),
                remedy=remedy,
            ) from error

    def _connected(self) -> sqlite3.Connection:
        try:
            return _connect(self.path)
        except sqlite3.OperationalError:  # locked, or the disk is full: the file may be valid
            raise
        except sqlite3.DatabaseError:  # the file is damaged: the index is made anew
            for name in (INDEX, f"{INDEX}-wal", f"{INDEX}-shm"):
                with storage_errors(self.path):
                    (self.path.parent / name).unlink(missing_ok=True)
            return _connect(self.path)


def _is_between(begun_utc: str, since: datetime | None, until: datetime | None) -> bool:
    if not begun_utc:  # the run was cut off before its first line
        return since is None and until is None
    begun = datetime.fromisoformat(begun_utc)
    return (since is None or begun >= since) and (until is None or begun < until)


def _connect(path: Path) -> sqlite3.Connection:
    index = sqlite3.connect(path, timeout=10.0)
    try:
        index.execute("PRAGMA journal_mode = WAL")
        # A power cut takes at most rows that were written last, which are made again.
        index.execute("PRAGMA synchronous = NORMAL")
        if index.execute("PRAGMA user_version").fetchone()[0] != VERSION:
            index.executescript(
                f"BEGIN IMMEDIATE; DROP TABLE IF EXISTS runs; DROP TABLE IF EXISTS parameters;"
                f" DROP TABLE IF EXISTS details; DROP TABLE IF EXISTS states; {_SCHEMA} COMMIT;"
            )
    except sqlite3.Error:
        index.close()
        raise
    return index


def _rows(index: sqlite3.Connection, table: str, folders: Iterable[str]) -> Iterator[Sequence[Any]]:
    """Yield the rows of a table that folders have, many with each question."""
    left = iter(folders)
    while some := list(islice(left, _ASKED_AT_ONCE)):
        marks = ",".join("?" * len(some))
        yield from index.execute(f"SELECT * FROM {table} WHERE folder IN ({marks})", some)  # noqa: S608 - our own names


def _run(index: sqlite3.Connection, folder: str, kept: Sequence[Any] | None) -> IndexedRun:
    """Return the row of a run; it is made anew if the journal, the results or the folder have changed."""
    stamp = _stamp(folder)
    if kept is not None and kept[0] == stamp:
        facts = json.loads(kept[-1])
        estimates = {name: Estimate(*numbers) for name, numbers in facts.pop("parameters").items()}
        run = IndexedRun(**facts, parameters=estimates)
        return run if run.how else _as_it_is_now(run)
    run, details = _read(Path(folder))
    run = replace(run, sealed=is_sealed(Path(folder)))
    row = (folder, stamp, run.id, run.ledger_number, run.ledger_head, _packed(vars(run)))
    index.execute("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?, ?, ?)", row)
    index.execute("INSERT OR REPLACE INTO details VALUES (?, ?, NULL)", (folder, _packed(details)))
    return run if run.how else _as_it_is_now(run)


def _stamp(folder: str) -> str:
    """Return what changes when a line, a file or a signature is added to a run, or its results are changed."""
    try:
        journal, itself = _stat(f"{folder}/{JOURNAL}"), _stat(folder)
    except OSError:
        with storage_errors(Path(folder)):
            raise
    try:
        results_ns = _stat(f"{folder}/{RESULTS}").st_mtime_ns
    except OSError:
        results_ns = 0
    return f"{journal.st_size} {journal.st_mtime_ns} {itself.st_mtime_ns} {results_ns}"


def _packed(facts: Mapping[str, object]) -> str:
    return _ENCODER.encode(facts)


def _as_it_is_now(run: IndexedRun) -> IndexedRun:
    """Return a run with what its folder, not its journal, states."""
    folder = Path(run.folder)
    how = run.how or ("running" if is_locked(folder) else "cut off")
    return replace(run, how=how, sealed=is_sealed(folder))


def read_run_and_details(folder: Path) -> tuple[IndexedRun, RunDetails]:
    """Read one run and its details from its folder, without an index."""
    run, details = _read(folder)
    return _as_it_is_now(run), with_results(details, folder)


def _read(folder: Path) -> tuple[IndexedRun, JournalDetails]:
    """Return what the index keeps of a run: its `run_facts`, and what else its journal states."""
    run = StoredRun(folder)
    try:
        facts = run_facts(run.history, folder)
        return facts, journal_details(run.history, run.entries, facts.parameters)
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise JournalBroken(
            f"A line of the journal cannot be read: {error}.",
            where=str(folder / JOURNAL),
            remedy="Another program or version wrote it; this version cannot list the run.",
        ) from error
