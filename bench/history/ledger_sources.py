"""The ledgers of several benches as one. No ledger is changed.

A ledger lies in the configuration folder of its bench, or in a copy of this folder. `bench.history.merged_runs` looks
for the folders of the runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bench.base.errors import JournalBroken, UsageError
from bench.evidence.keys import KEY_FILE
from bench.evidence.ledger_check import own_public_keys
from bench.records.journal_entry import Entry
from bench.records.ledger import Ledger
from bench.records.ledger_file import LEDGER
from bench.records.ledger_runs import LedgerRun, runs_of

_SHORT = 12
"""Characters of a hash that name a ledger."""


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
    """A run as a ledger enters it, with the ledger."""

    run: LedgerRun
    bench: str
    ledger: str


@dataclass
class MergedLedgers:
    """Several ledgers as one."""

    sources: Sequence[LedgerSource]
    entered: Mapping[str, EnteredRun]  # Each run once, by the hash of its line
    # faults, notes: As in `LedgerSource`, of all ledgers and of what they say about each other.
    faults: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def read_source(ledger: Ledger, *, required: bool = True) -> LedgerSource:
    """Read the ledger of one bench, and compare it with the places that know of it.

    required: Whether a missing ledger is an error.
    Raises UsageError: When there is no ledger, and it is required.
    Raises StorageError: When it cannot be read.
    """
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
        [f"{named}: {note}" for note in [*(_explained(str(b), b.by, b.reason) for b in explained), *ledger.warnings]],
    )  # fmt: skip


def _explained(what: str, by: str | None, reason: str | None) -> str:
    return f"{what} Reason, stated by {by}: {reason}"


def _bench_name(home: Path) -> str:
    try:
        words = (home / KEY_FILE).with_suffix(".pub").read_text(encoding="utf-8").split()
    except (OSError, UnicodeDecodeError):
        words = []
    return words[2] if len(words) > 2 else home.resolve().name


def merge_ledgers(sources: Iterable[LedgerSource]) -> MergedLedgers:
    """Merge ledgers. A run that several of them enter with the same line is one run.

    Returns: All runs.
    """
    kept: dict[Path, LedgerSource] = {}
    notes: list[str] = []
    for source in sources:
        folder = source.folder.resolve()
        if folder in kept:
            notes.append(f"The ledger in {source.folder} was named twice; it counts once.")
        kept.setdefault(folder, source)
    merged = MergedLedgers(list(kept.values()), {}, [], notes)
    for one in merged.sources:
        merged.faults += one.faults
        merged.notes += one.notes
    entered: dict[str, EnteredRun] = {}
    for source in merged.sources:
        for run in source.runs:
            entered.setdefault(run.head, EnteredRun(run, source.bench, source.identity))
    merged.entered = entered
    return merged
