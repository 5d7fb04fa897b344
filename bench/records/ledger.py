"""The laboratory's ledger: every run that was begun on this bench and how it ended, so that none is left out unseen.

One file for all runs, ``ledger.jsonl`` beside the signing key, in the journal's form: chained, synced line by line.
A run is entered before it does anything and again whenever it ends; a run that nobody ended stays open, and shows.
Reports name the ledger's head and the count of runs of their camera, so that a line cut off the end is missed too.
Knows folders of runs by name only.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.base.errors import JournalBroken
from bench.records.events import LedgerPlace
from bench.records.journal import Journal, read_journal
from bench.records.journal_entry import Entry
from bench.records.run_folder import MANIFEST, is_sealed
from bench.records.storage import make_folder, open_to_lock, sha256_of, storage_errors
from drivers import file_lock

LEDGER = "ledger.jsonl"
BEGUN = "run_begun"
ENDED = "run_ended"
OPEN = "open"
"""How a run stands that has not ended: under way, killed, or cut off."""


@dataclass(frozen=True)
class LedgerRun:
    """One run as the ledger knows it.

    Attributes
    ----------
    number
        Its number in the ledger, from 1.
    run_id, folder
        Its name, and where it was written.
    camera
        Serial number of the camera.
    simulated
        Whether any device was simulated.
    begun_utc
        When it was begun.
    how
        How it stands: ``finished``, ``aborted``, ``failed`` or ``open``.
    seal
        SHA-256 of its list of files; None when it was not sealed.
    """

    number: int
    run_id: str
    folder: str
    camera: str
    simulated: bool
    begun_utc: str
    how: str = OPEN
    seal: str | None = None


class Ledger:
    """The ledger of a bench; every method reads it anew, for other processes write it too.

    Parameters
    ----------
    home
        The configuration folder, as ``home_folder`` gives it.
    utc_now, monotonic
        As for a journal.
    """

    def __init__(
        self, home: Path, *, utc_now: Callable[[], datetime], monotonic: Callable[[], float]
    ) -> None:
        self.path = home / LEDGER
        self._clocks: dict[str, Any] = {"utc_now": utc_now, "monotonic": monotonic}

    def begin(self, *, run_id: str, folder: Path, camera: str, simulated: bool) -> LedgerPlace:
        """Enter a run before it does anything.

        Returns
        -------
        dict
            ``number`` of the run in the ledger, ``head`` of the ledger with it, and of the runs of this camera begun
            so far, this one included, how many there are by how they stand: ``of_camera``. For the run's own journal
            and its report.

        Raises
        ------
        JournalBroken
            When the ledger does not hold.
        StorageError
            When it cannot be written.
        """
        with self._held() as journal:
            number = 1 + sum(entry.event == BEGUN for entry in journal.entries)
            journal.append(
                BEGUN, number=number, run=run_id, folder=str(folder), camera=camera, simulated=simulated
            )
            of_camera: dict[str, int] = {}
            for run in _runs(journal.entries):
                if run.camera == camera and run.simulated == simulated:
                    of_camera[run.how] = of_camera.get(run.how, 0) + 1
            return {"number": number, "head": journal.head, "of_camera": of_camera}

    def end(self, number: int, *, how: str, folder: Path) -> None:
        """Enter how a run ended; once more when it was resumed and ended again.

        Parameters
        ----------
        number
            As ``begin`` gave it.
        how
            ``finished``, ``aborted`` or ``failed``.
        folder
            Its folder; when that is sealed the seal is entered.

        Raises
        ------
        JournalBroken, StorageError
            As ``begin``.
        """
        with storage_errors(folder):
            seal = sha256_of(folder / MANIFEST) if is_sealed(folder) else None
        with self._held() as journal:
            journal.append(ENDED, number=number, how=how, seal=seal)

    def contains(self, place: Mapping[str, Any]) -> bool:
        """Whether a run stands in this ledger where ``begin`` put it; another bench's may have its number and name.

        Raises JournalBroken, StorageError.
        """
        if not self.path.exists():
            return False
        return any(e.event == BEGUN and e.hash == place.get("head") for e in read_journal(self.path)[0])

    def runs(self) -> list[LedgerRun]:
        """List all runs, first to last; none when there is no ledger yet.

        Raises
        ------
        JournalBroken
            When the ledger does not hold.
        StorageError
            When it cannot be read.
        """
        if not self.path.exists():
            return []
        return _runs(read_journal(self.path)[0])

    def faults(self) -> list[str]:
        """Say of which sealed runs the folder is gone, or is not what was sealed."""
        found = []
        for run in self.runs():
            manifest = Path(run.folder) / MANIFEST
            if run.seal is None:
                continue
            with storage_errors(manifest):
                if not manifest.is_file():
                    found.append(f"run {run.number} ({run.run_id}): its folder is gone from {run.folder}")
                elif sha256_of(manifest) != run.seal:
                    found.append(f"run {run.number} ({run.run_id}): {manifest} is not what was sealed")
        return found

    @contextmanager
    def _held(self) -> Iterator[Journal]:
        """Hold the ledger against other processes, and open it for a line."""
        make_folder(self.path.parent)
        with storage_errors(self.path):
            lock = open_to_lock(self.path.parent)
        try:
            file_lock.lock(lock, wait=True)
            opened = Journal.open if self.path.exists() else Journal.create
            with opened(self.path, **self._clocks) as journal:
                yield journal
        finally:
            os.close(lock)


def _runs(entries: Iterable[Entry]) -> list[LedgerRun]:
    runs: list[LedgerRun] = []
    for entry in entries:
        data = entry.data
        try:
            if entry.event == BEGUN:
                names = (data["run"], data["folder"], data["camera"], data["simulated"])
                runs.append(LedgerRun(len(runs) + 1, *names, begun_utc=entry.utc))
            elif entry.event == ENDED:
                at = _position(runs, data["number"])
                runs[at] = replace(runs[at], how=data["how"], seal=data["seal"])
        except (LookupError, TypeError) as error:
            raise JournalBroken(
                f"Line {entry.seq + 1} of the ledger is not an entry of a run.",
                remedy="Another program wrote it; move the ledger away to begin a new one.",
            ) from error
    return runs


def _position(runs: Sequence[LedgerRun], number: int) -> int:
    if not 1 <= number <= len(runs):
        raise LookupError(number)
    return number - 1
