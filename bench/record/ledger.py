"""The laboratory's ledger: every run that was started on this bench, and how it ended. No run can be left out unseen.

One file for all runs, ``ledger.jsonl`` beside the signing key, chained and synced like a journal. A run is entered
before it does anything, and again whenever it ends. `bench.record.ledger_marks` keeps the newest head elsewhere, so
that lines removed from the end are noticed. Certificates take their numbers from it, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from bench.base.clock import BenchClock
from bench.base.errors import BenchError, EvidenceError, JournalBroken, UsageError
from bench.base.home import home_folder
from bench.record.events import LedgerPlace
from bench.record.folder_lock import locked_folder
from bench.record.journal import Journal, read_journal
from bench.record.journal_line import Entry
from bench.record.ledger_marks import (
    BREAK_EXPLAINED,
    EXPLAIN,
    LEDGER_BROKEN,
    RUN_BEGUN,
    RUN_ENDED,
    Break,
    LedgerMark,
    LedgerRun,
    RunFault,
    Strangers,
    breaks_of,
    find_breaks,
    highest_counts,
    highest_run,
    no_strangers,
    read_own_mark,
    runs_of,
    write_own_mark,
)
from bench.record.run_folder import MANIFEST, is_sealed
from bench.record.run_verdict import RunVerdict
from bench.record.storage import make_folder, sha256_of, storage_errors
from drivers.durable import sync_folder

LEDGER = "ledger.jsonl"
RUN_EXPLAINED = "run_explained"
"""A person states why the folder of a sealed run is missing, or was changed."""
_SAY_WHAT = "state what became of it: `starbench ledger --explain TEXT`."


@dataclass(frozen=True)
class _Read:
    """The lines of one state of the file, and the runs that they enter."""

    state: tuple[int, ...]
    entries: list[Entry]

    @cached_property
    def runs(self) -> list[LedgerRun]:
        """See `runs_of`."""
        return runs_of(self.entries)


class Ledger:
    """The ledger of a bench. Every method asks the file anew, because other processes write to it too.

    ``warnings`` tell what of its own mark could not be written by the last call; nothing was stopped by it.
    """

    def __init__(self, home: Path, clock: BenchClock) -> None:
        self.home = home
        self.path = home / LEDGER
        self.warnings: list[str] = []
        self._clock = clock
        self._kept = _Read((), [])

    def entries(self) -> list[Entry]:
        """Read and verify every line, first to last, once for each state of the file; empty while there is none."""
        return list(self._read().entries)

    def _read(self) -> _Read:
        if not self.path.exists():
            return _Read((), [])
        with storage_errors(self.path):
            status = self.path.stat()
        state = (status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
        if self._kept.state != state:
            self._kept = _Read(state, read_journal(self.path)[0])
        return self._kept

    def append(self, event: str, **facts: Any) -> Entry:
        """Enter one line of any event in the past tense; use ``locked`` where it depends on the lines before."""
        with self.locked() as journal:
            return journal.append(event, **facts)

    @contextmanager
    def locked(self) -> Iterator[Journal]:
        """Lock the ledger against other processes, verify it, and open it for writing; a break raises `EvidenceError`.

        A number that follows from the lines before is so given once. The lock waits: keep the block short.
        """
        self.warnings = []
        with self._held():
            refuse(find_breaks(self.entries(), self._own_mark()).what, self.path)
            with self._opened() as journal:
                yield journal

    # ------------------------------------------------------------ lock and marks

    @contextmanager
    def _held(self) -> Iterator[None]:
        """Lock the ledger against other processes."""
        make_folder(self.home)
        with locked_folder(self.home):
            yield

    @contextmanager
    def _opened(self) -> Iterator[Journal]:
        """Open the ledger for writing; the bench's own mark follows each new head."""
        opener = Journal.open if self.path.exists() else Journal.create
        with opener(self.path, self._clock) as journal:
            before = journal.head
            try:
                yield journal
            finally:
                if journal.head != before:
                    self._write_own_mark(journal.entries)

    def _own_mark(self) -> LedgerMark | str | None:
        """Return the bench's own mark, or why its content is none. A disk that fails is no break: `StorageError`."""
        try:
            return read_own_mark(self.home)
        except EvidenceError as error:
            return str(error)

    def _write_own_mark(self, entries: Sequence[Entry]) -> None:
        """Write the bench's own mark; what fails becomes a warning."""
        counts = dict(sorted(highest_counts(entries).items()))
        mark = LedgerMark(len(entries), highest_run(entries), entries[-1].hash, entries[-1].utc, counts)
        try:
            write_own_mark(self.home, mark)
        except BenchError as error:
            self.warnings.append(f"The bench's own mark of the ledger cannot be written: {error}")

    # ------------------------------------------------------------ runs

    def begin(
        self,
        *,
        run_id: str,
        folder: Path,
        camera: str,
        simulated: bool,
        strict: bool = False,
        strangers: Strangers = no_strangers,
    ) -> LedgerPlace:
        """Enter a run before it does anything. A break of the ledger is recorded first; it does not stop the run.

        With ``strict``, a break that nobody explained raises `EvidenceError`. ``strangers`` finds sealed runs of this
        bench that are not in the ledger.
        """
        with self._mended(strangers, strict=strict) as journal:
            entries = journal.entries
            faults = [f"{gap} {EXPLAIN}" for gap in breaks_of(entries) if gap.reason is None]
            number = 1 + highest_run(entries)
            facts = {"run": run_id, "folder": str(folder), "camera": camera, "simulated": simulated}
            journal.append(RUN_BEGUN, number=number, **facts)
            of_camera: dict[str, int] = {}
            for run in runs_of(journal.entries):
                if run.camera == camera and run.simulated == simulated:
                    of_camera[run.how] = of_camera.get(run.how, 0) + 1
            place: LedgerPlace = {"number": number, "head": journal.head, "of_camera": of_camera}
            if faults:
                place["faults"] = faults
        return place

    def end(self, number: int, *, how: str, folder: Path, verdict: RunVerdict | None = None) -> None:
        """Enter how a run ended (again after a resume): ``finished``, ``aborted``, ``failed``; its seal and verdict."""
        with storage_errors(folder):
            seal = sha256_of(folder / MANIFEST) if is_sealed(folder) else None
        with self._mended() as journal:
            begun = any(e.event == RUN_BEGUN and e.data["number"] == number for e in journal.entries)
            lost = {} if begun else {"lost": True}
            judged = {} if verdict is None else {"verdict": verdict._asdict()}
            journal.append(RUN_ENDED, number=number, how=how, seal=seal, folder=str(folder), **judged, **lost)

    def refuse_break(self, strangers: Strangers = no_strangers) -> None:
        """Refuse a ledger with a break that nobody has explained. A run checks this before it makes its folder."""
        faults, _ = self.breaks(strangers)
        refuse(faults, self.path)

    def entered(self, place: Mapping[str, Any]) -> LedgerRun | None:
        """Return the run that was entered in this ledger by the line with this hash; None also if it is damaged."""
        with suppress(JournalBroken):
            return next((run for run in self.runs() if run.head == place.get("head")), None)
        return None

    def runs(self) -> list[LedgerRun]:
        """List all runs in the order of their numbers; empty while there is no ledger."""
        return list(self._read().runs)

    def faults(self) -> list[RunFault]:
        """Check that the folder of every sealed run still exists and still has its seal; explained faults count not."""
        known = {(entry.data.get("run"), entry.data.get("fault")) for entry in self.explained_runs()}
        return [fault for fault in self._run_faults() if fault.key not in known]

    def faults_and_remedies(self) -> list[str]:
        """Return `faults`, each with what to do."""
        return [f"{fault}. Copy it back, or {_SAY_WHAT}" for fault in self.faults()]

    def explained_runs(self) -> list[Entry]:
        """Return the lines in which a person stated why a run is missing or changed; ``what`` is the fault in words."""
        return [entry for entry in self.entries() if entry.event == RUN_EXPLAINED]

    def _run_faults(self) -> list[RunFault]:
        faults = []
        for run in self.runs():
            if run.seal is None:
                continue
            manifest = Path(f"{run.folder}/{MANIFEST}")
            with storage_errors(manifest):
                if not manifest.is_file():
                    faults.append(RunFault(run, "missing"))
                elif sha256_of(manifest) != run.seal:
                    faults.append(RunFault(run, "changed"))
        return faults

    # ------------------------------------------------------------ breaks

    def breaks(self, strangers: Strangers = no_strangers) -> tuple[list[str], list[Break]]:
        """Return a sentence for each break that nobody explained, by all places that know of the ledger."""
        entries, _, recorded, damage = self.read()
        if damage:
            return [f"The ledger is damaged: {damage}"], []
        findings = find_breaks(entries, self._own_mark(), strangers)
        unexplained = [str(gap) for gap in recorded if gap.reason is None]
        return [*unexplained, *findings.what], [gap for gap in recorded if gap.reason is not None]

    def read(self) -> tuple[list[Entry], list[LedgerRun], list[Break], str]:
        """Return the lines, the runs and the recorded breaks; or nothing, and how the file is damaged."""
        try:
            kept = self._read()
            return list(kept.entries), list(kept.runs), breaks_of(kept.entries), ""
        except (JournalBroken, LookupError, TypeError) as error:
            return [], [], [], str(error) or type(error).__name__

    def explain(self, reason: str, by: str, *, strangers: Strangers = no_strangers) -> list[str]:
        """Record every break that is not recorded yet, and state the reason of every one without a reason, if any.

        A sealed run whose folder is missing or was changed is explained, too.
        """
        with self._mended(strangers) as journal:
            open_breaks = [gap for gap in breaks_of(journal.entries) if gap.reason is None]
            for open_break in open_breaks:
                journal.append(BREAK_EXPLAINED, line=open_break.line, reason=reason, by=by)
        runs = self.faults()
        for fault in runs:
            head, kind = fault.key
            self.append(RUN_EXPLAINED, run=head, fault=kind, what=str(fault), reason=reason, by=by)
        if not open_breaks and not runs:
            raise UsageError("The ledger has no break to explain.", where=str(self.path))
        return [*map(str, open_breaks), *map(str, runs)]

    @contextmanager
    def _mended(self, strangers: Strangers = no_strangers, *, strict: bool = False) -> Iterator[Journal]:
        """Lock and open the ledger, and record a break as its next line. A damaged file is kept under another name."""
        with self._held():
            entries, _, recorded, damage = self.read()
            findings = find_breaks(entries, self._own_mark(), strangers)
            self.warnings = []
            what = [f"The ledger was damaged: {damage}"] if damage else findings.what
            if strict:
                refuse([*what, *(str(gap) for gap in recorded if gap.reason is None)], self.path)
            kept = self._set_aside() if damage else None
            with self._opened() as journal:
                if what:
                    journal.append(
                        LEDGER_BROKEN, what=what, known=findings.known, kept=kept, reason=None, by=None
                    )
                yield journal

    def _set_aside(self) -> str:
        """Rename a damaged ledger; return its new name and its hash."""
        now = self._clock.utc_now()
        kept = self.path.with_name(f"ledger-broken-{now:%Y%m%dT%H%M%S%f}Z.jsonl")
        with storage_errors(self.path):
            self.path.rename(kept)
            sync_folder(self.home)
            return f"{kept.name} sha256 {sha256_of(kept)}"


def refuse(faults: Sequence[str], path: Path) -> None:
    """Refuse a ledger with faults, which are sentences."""
    if faults:
        raise EvidenceError(f"The ledger is broken: {' '.join(faults)}", where=str(path), remedy=EXPLAIN)


def bench_ledger() -> Ledger:
    """Return the ledger of this bench, for reading; its file may not exist."""
    return Ledger(home_folder(), BenchClock())
