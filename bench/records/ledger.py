"""The laboratory's ledger: every run that was started on this bench, and how it ended. No run can be left out unseen.

It is one file for all runs, ``ledger.jsonl`` beside the signing key, in the form of a journal: chained, and synced line
by line. A run is entered before it does anything, and again whenever it ends; a run without an end remains open. A
report states the hash of the ledger's last line and the number of runs of its camera, so that lines removed from the
end of the ledger are noticed, too.
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
RUN_BEGUN = "run_begun"
RUN_ENDED = "run_ended"
STILL_OPEN = "open"
"""State of a run without an end: it is running, was killed, or was cut off by a loss of power."""


@dataclass(frozen=True)
class LedgerRun:
    """One run in the ledger.

    Attributes
    ----------
    number
        Number of the run in the ledger, from 1.
    run_id, folder
        Name and folder of the run.
    camera
        Serial number of the camera.
    simulated
        Whether any device was simulated.
    begun_utc
        Time of the start, ISO 8601.
    how
        State of the run: ``finished``, ``aborted``, ``failed`` or ``open``.
    seal
        SHA-256 of its list of files; None when it was not sealed.
    """

    number: int
    run_id: str
    folder: str
    camera: str
    simulated: bool
    begun_utc: str
    how: str = STILL_OPEN
    seal: str | None = None


class Ledger:
    """The ledger of a bench. Every method reads the file anew, because other processes write to it too.

    Parameters
    ----------
    home
        The configuration folder, from `bench.base.home.home_folder`.
    utc_now, monotonic
        As for `bench.records.journal.Journal`.
    """

    def __init__(
        self, home: Path, *, utc_now: Callable[[], datetime], monotonic: Callable[[], float]
    ) -> None:
        self.path = home / LEDGER
        self._clocks: dict[str, Any] = {"utc_now": utc_now, "monotonic": monotonic}

    def begin(self, *, run_id: str, folder: Path, camera: str, simulated: bool) -> LedgerPlace:
        """Enter a run before it does anything.

        Parameters
        ----------
        run_id
            Name of the run.
        folder
            Its folder.
        camera
            Serial number of the camera.
        simulated
            Whether any device is simulated.

        Returns
        -------
        dict
            For the journal and the report of the run: its ``number`` in the ledger; the ``head``, which is the hash of
            the ledger's last line; and ``of_camera``, the number of runs of this camera by state, with this run.

        Raises
        ------
        JournalBroken
            When the ledger is not valid.
        StorageError
            When it cannot be written.
        """
        with self.locked() as journal:
            number = 1 + sum(entry.event == RUN_BEGUN for entry in journal.entries)
            journal.append(
                RUN_BEGUN, number=number, run=run_id, folder=str(folder), camera=camera, simulated=simulated
            )
            of_camera: dict[str, int] = {}
            for run in _runs(journal.entries):
                if run.camera == camera and run.simulated == simulated:
                    of_camera[run.how] = of_camera.get(run.how, 0) + 1
            return {"number": number, "head": journal.head, "of_camera": of_camera}

    def end(self, number: int, *, how: str, folder: Path) -> None:
        """Enter how a run ended; again after it was resumed and has ended again.

        Parameters
        ----------
        number
            Number of the run, from ``begin``.
        how
            ``finished``, ``aborted`` or ``failed``.
        folder
            Its folder; if it is sealed, the hash of the seal is entered.

        Raises
        ------
        JournalBroken, StorageError
            As ``begin``.
        """
        with storage_errors(folder):
            seal = sha256_of(folder / MANIFEST) if is_sealed(folder) else None
        with self.locked() as journal:
            journal.append(RUN_ENDED, number=number, how=how, seal=seal)

    def contains(self, place: Mapping[str, Any]) -> bool:
        """Return whether a run was entered in this ledger. The ledger of another bench may have a run of its number.

        Parameters
        ----------
        place
            What ``begin`` returned for the run.

        Returns
        -------
        bool
            Whether the line with that hash enters a run.

        Raises
        ------
        JournalBroken
            When the ledger is not valid.
        StorageError
            When it cannot be read.
        """
        if not self.path.exists():
            return False
        return any(e.event == RUN_BEGUN and e.hash == place.get("head") for e in read_journal(self.path)[0])

    def runs(self) -> list[LedgerRun]:
        """List all runs in the order of their numbers.

        Returns
        -------
        list of LedgerRun
            Empty while there is no ledger.

        Raises
        ------
        JournalBroken
            When the ledger is not valid.
        StorageError
            When it cannot be read.
        """
        if not self.path.exists():
            return []
        return _runs(read_journal(self.path)[0])

    def faults(self) -> list[str]:
        """Check that the folder of every sealed run still exists and still has its seal.

        Returns
        -------
        list of str
            One sentence for each run whose folder is missing or has another seal.

        Raises
        ------
        JournalBroken
            When the ledger is not valid.
        StorageError
            When the ledger or a seal cannot be read.
        """
        found = []
        for run in self.runs():
            manifest = Path(run.folder) / MANIFEST
            if run.seal is None:
                continue
            with storage_errors(manifest):
                if not manifest.is_file():
                    found.append(f"run {run.number} ({run.run_id}): its folder {run.folder} is missing")
                elif sha256_of(manifest) != run.seal:
                    found.append(f"run {run.number} ({run.run_id}): {manifest} was changed after sealing")
        return found

    def entries(self) -> list[Entry]:
        """Read and verify every line, of any event: runs, certificates and whatever else was entered.

        Returns
        -------
        list of Entry
            First to last; empty while there is no ledger.

        Raises
        ------
        JournalBroken
            When the ledger is not valid.
        StorageError
            When it cannot be read.
        """
        return read_journal(self.path)[0] if self.path.exists() else []

    def append(self, event: str, **facts: Any) -> Entry:
        """Enter one line of any event. Use ``locked`` where the line depends on the lines before.

        Parameters
        ----------
        event
            Name of the event, in the past tense, such as ``certificate_issued``.
        **facts
            Data of the event, as for `bench.records.journal.Journal.append`.

        Returns
        -------
        Entry
            The line; its ``hash`` is the new head.

        Raises
        ------
        JournalBroken, StorageError
            As ``begin``.
        """
        with self.locked() as journal:
            return journal.append(event, **facts)

    @contextmanager
    def locked(self) -> Iterator[Journal]:
        """Lock the ledger against other processes, verify it, and open it for writing.

        In the block, ``journal.entries`` holds every line so far, and ``journal.append(event, **facts)`` enters a line.
        So a number that follows from the lines before is given once only. The lock waits; keep the block short.

        Yields
        ------
        Journal
            The ledger as a journal.

        Raises
        ------
        JournalBroken, StorageError
            As ``begin``.
        """
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
            if entry.event == RUN_BEGUN:
                names = (data["run"], data["folder"], data["camera"], data["simulated"])
                runs.append(LedgerRun(len(runs) + 1, *names, begun_utc=entry.utc))
            elif entry.event == RUN_ENDED:
                at = _position(runs, data["number"])
                runs[at] = replace(runs[at], how=data["how"], seal=data["seal"])
        except (LookupError, TypeError) as error:
            raise JournalBroken(
                f"Line {entry.seq + 1} of the ledger is not a line about a run.",
                remedy="Another program wrote it. Move the ledger away to start a new one.",
            ) from error
    return runs


def _position(runs: Sequence[LedgerRun], number: int) -> int:
    if not 1 <= number <= len(runs):
        raise LookupError(number)
    return number - 1
