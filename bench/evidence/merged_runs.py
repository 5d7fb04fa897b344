"""The runs of several ledgers and folders as one list. What is missing, double or changed is named.

A run is recognised by the hash of its line in the ledger, so its folder may be a copy. Writes the index alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from bench.base.errors import BenchError, JournalBroken, UsageError
from bench.evidence.ledger_check import is_sealed_by, other_seal, own_public_keys
from bench.evidence.public_half import KEY_FILE, read_public
from bench.record.journal_line import Entry
from bench.record.ledger import LEDGER, Ledger
from bench.record.ledger_marks import LedgerRun, runs_of
from bench.record.run_facts import IN_LEDGER, NO_LEDGER, NOT_IN_LEDGER, IndexedRun, RunPlace
from bench.record.run_folder import JOURNAL, MANIFEST, RESULTS
from bench.record.run_index import RunIndex
from bench.record.storage import sha256_of

_SHORT = 12
"""Characters of a hash that name a ledger: 48 bit, in which no two ledgers agree by chance."""


@dataclass(frozen=True)
class LedgerSource:
    """The ledger of one bench."""

    folder: Path
    bench: str  # Name of the bench: the name in its key; the name of the folder if it has no key
    entries: Sequence[Entry] = ()  # Every line of the ledger; empty if it is damaged or missing
    runs: Sequence[LedgerRun] = ()
    public_keys: frozenset[bytes] = frozenset()
    faults: Sequence[str] = ()
    notes: Sequence[str] = ()

    @property
    def identity(self) -> str:
        """Begin of the hash of its first line; empty without a line."""
        return self.entries[0].hash[:_SHORT] if self.entries else ""


@dataclass(frozen=True)
class EnteredRun:
    """A run in a ledger, and the ledger."""

    run: LedgerRun
    bench: str
    ledger: str


@dataclass
class MergedLedgers:
    """Several ledgers as one."""

    sources: Sequence[LedgerSource]
    entered: dict[str, EnteredRun] = field(default_factory=dict)  # Each run once, by the hash of its line
    faults: list[str] = field(default_factory=list)  # As in `LedgerSource`, of all ledgers and between them
    notes: list[str] = field(default_factory=list)  # The same


def read_source(ledger: Ledger, *, required: bool = True) -> LedgerSource:
    """Read the ledger of one bench, and compare it with the places that know of it."""
    bench = _bench_name(ledger.home)
    if required and not ledger.path.is_file():
        raise UsageError(
            "There is no ledger in this folder.",
            where=str(ledger.home),
            remedy=f"Name the configuration folder of a bench, or a copy of it: it contains {LEDGER}.",
        )
    broken, explained = ledger.breaks()
    try:
        entries = ledger.entries()
        runs = runs_of(entries)
    except (JournalBroken, LookupError, TypeError):
        entries, runs = [], []  # `broken` says it
    named = f"Ledger of {bench} ({ledger.path})"
    return LedgerSource(
        ledger.home,
        bench,
        entries,
        runs,
        frozenset(own_public_keys(ledger.home)),
        [f"{named}: {fault}" for fault in broken],
        [f"{named}: {note}" for note in (*explained, *ledger.warnings)],
    )


def _bench_name(home: Path) -> str:
    with suppress(BenchError):
        return read_public((home / KEY_FILE).with_suffix(".pub"))[1]
    return home.resolve().name


def merge_ledgers(sources: Iterable[LedgerSource]) -> MergedLedgers:
    """Merge ledgers. A run that several of them enter with the same line is one run."""
    kept: dict[Path, LedgerSource] = {}
    notes: list[str] = []
    for source in sources:
        folder = source.folder.resolve()
        if folder in kept:
            notes.append(f"The ledger in {source.folder} was named twice; it counts once.")
        kept.setdefault(folder, source)
    merged = MergedLedgers(list(kept.values()), notes=notes)
    for source in merged.sources:
        merged.faults += source.faults
        merged.notes += source.notes
        for run in source.runs:
            merged.entered.setdefault(run.head, EnteredRun(run, source.bench, source.identity))
    return merged


@dataclass
class MergedRuns:
    """All runs, each once."""

    runs: list[IndexedRun] = field(default_factory=list)  # Oldest first
    places: dict[str, RunPlace] = field(default_factory=dict)
    # Sentences: folders that are missing, changed, cannot be read, or contradict a ledger.
    faults: list[str] = field(default_factory=list)
    # Sentences: copies that were left out, and runs of ledgers that were not given.
    notes: list[str] = field(default_factory=list)


def merge_runs(
    index: RunIndex, ledgers: MergedLedgers, folders: Sequence[Path], *, only_folders: bool = False
) -> MergedRuns:
    """Find runs of ledgers and folders, whose places go first; ``only_folders`` leaves out those in ledgers alone."""
    merged = MergedRuns(faults=list(ledgers.faults), notes=list(ledgers.notes))
    stated = [] if only_folders else [Path(ledger_run.run.folder) for ledger_run in ledgers.entered.values()]
    present = [path for path in stated if (path / JOURNAL).is_file()]
    runs, unreadable = index.runs([*folders, *present])
    merged.faults += unreadable
    by_head: dict[str, list[IndexedRun]] = {}
    for run in runs:
        by_head.setdefault(run.ledger_head or run.folder, []).append(run)
    for head, same in by_head.items():
        entered = ledgers.entered.get(head)
        kept = _one_of(merged, same, entered)
        merged.runs.append(kept)
        merged.places[kept.folder] = _place(kept, entered)
        if entered is not None:
            named = f"run {entered.run.number} of {entered.bench}"
            merged.faults += [f"{named}: {what}" for what in other_seal(Path(kept.folder), entered.run)]
    if not only_folders:
        unread = {str(path.resolve()) for path in [*folders, *present]} - {run.folder for run in runs}
        _name_missing(merged, ledgers.entered, by_head, runs, unread)
    _strangers(merged, ledgers.sources)
    merged.runs.sort(key=lambda run: (run.begun_utc, run.folder))
    for run, details in index.details(merged.runs):
        if details["results_fault"]:
            merged.faults.append(f"{run.folder}: {details['results_fault']}")
    return merged


def _place(run: IndexedRun, entered: EnteredRun | None) -> RunPlace:
    if entered is not None:
        return RunPlace(entered.bench, entered.ledger, IN_LEDGER)
    return RunPlace(state=NO_LEDGER if run.ledger_head is None else NOT_IN_LEDGER)


def _one_of(merged: MergedRuns, same: Sequence[IndexedRun], entered: EnteredRun | None) -> IndexedRun:
    """Choose among folders of the same run: the one with the ledger's seal, then the one at the ledger's path."""
    if len(same) == 1:
        return same[0]
    stated = entered.run if entered is not None else None
    kept = min(
        same,
        key=lambda run: (
            stated is None or _hash_of(Path(run.folder) / MANIFEST) != stated.seal,
            stated is None or run.folder != stated.folder,
            run.folder,
        ),
    )
    for other in same:
        if other is kept:
            continue
        what = f"{other.folder} is the same run as {kept.folder}"
        differing = [
            name
            for name in (JOURNAL, RESULTS, MANIFEST)
            if _hash_of(Path(other.folder) / name) != _hash_of(Path(kept.folder) / name)
        ]
        if differing:
            merged.faults.append(
                f"{what}, but it has another {' and '.join(differing)}. Only {kept.folder} is listed."
            )
        else:
            merged.notes.append(f"{what}: journal, results and seal are equal. It counts once.")
    return kept


def _hash_of(path: Path) -> str | None:
    """Return the hash of a file; None if it cannot be read."""
    try:
        return sha256_of(path) if path.is_file() else None
    except (BenchError, OSError):
        return None


def _name_missing(
    merged: MergedRuns,
    entered: Mapping[str, EnteredRun],
    by_head: Mapping[str, Sequence[IndexedRun]],
    runs: Sequence[IndexedRun],
    unread: set[str],
) -> None:
    """Name the runs of the ledgers that no folder holds."""
    at_path = {run.folder: run for run in runs}
    for head, ledger_run in entered.items():
        resolved = str(Path(ledger_run.run.folder).resolve())
        if head in by_head or resolved in unread:  # a folder that cannot be read is named already
            continue
        named = f"run {ledger_run.run.number} of {ledger_run.bench} ({ledger_run.run.run_id}, {ledger_run.run.how})"
        other = at_path.get(resolved)
        if other is None:
            merged.faults.append(f"{named}: its folder {ledger_run.run.folder} is missing")
        elif other.id == ledger_run.run.run_id:
            merged.notes.append(f"{named} was resumed with another ledger, as number {other.ledger_number}.")
        else:
            merged.faults.append(
                f"{named}: its folder {ledger_run.run.folder} now holds another run (number {other.ledger_number})"
            )


def _strangers(merged: MergedRuns, sources: Sequence[LedgerSource]) -> None:
    """Name the runs whose ledger line is in no given ledger: those of a given bench are faults, others notes."""
    unknown = [run for run in merged.runs if merged.places[run.folder].state == NOT_IN_LEDGER]
    numbers = {(source.identity, run.number): run for source in sources for run in source.runs}
    foreign, lost = [], []
    for run in unknown:
        own = next((s for s in sources if is_sealed_by(Path(run.folder), s.public_keys)), None)
        if own is None:
            foreign.append(run)
            continue
        holder = numbers.get((own.identity, run.ledger_number or 0))
        other = f" There, number {run.ledger_number} is {holder.folder}." if holder else ""
        lost.append(
            f"{own.bench} has sealed {run.folder} as run {run.ledger_number}, but its ledger does not contain it:"
            f" lines were removed or replaced.{other}"
        )
    merged.faults += lost
    if foreign and sources:
        named = ", ".join(run.folder for run in foreign[:3]) + (", ..." if len(foreign) > 3 else "")
        what = "1 run names" if len(foreign) == 1 else f"{len(foreign)} runs name"
        merged.notes.append(f"{what} a ledger that was not given: {named}. Name it with --ledger.")
