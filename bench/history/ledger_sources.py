"""The ledgers of several benches, read and compared with each other. No ledger is changed.

A ledger lies in the configuration folder of its bench, or in a copy of this folder. `bench.history.merged_runs` looks
for the folders of the runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
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

    Returns: All runs, and every contradiction between two ledgers.
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
    for one, other in combinations(merged.sources, 2):
        _compare(merged, one, other)
    entered: dict[str, EnteredRun] = {}
    for source in merged.sources:
        for run in source.runs:
            entered.setdefault(run.head, EnteredRun(run, source.bench, source.identity))
    merged.entered = entered
    return merged


def _compare(merged: MergedLedgers, one: LedgerSource, other: LedgerSource) -> None:
    """Compare two ledgers: a copy is a note, a fork or a ledger begun again is a fault."""
    if not one.entries or not other.entries:
        return
    if one.entries[0].hash == other.entries[0].hash:
        shorter, longer = sorted((one, other), key=lambda source: len(source.entries))
        alike = _common_lines(shorter.entries, longer.entries)
        if alike == len(shorter.entries):
            merged.notes.append(
                f"The ledger in {shorter.folder} is a copy of the one in {longer.folder}, with {alike} of"
                f" {len(longer.entries)} lines. Each run counts once."
            )
            return
        merged.faults.append(
            f"The ledgers in {one.folder} and {other.folder} agree in their first {alike} lines and then differ:"
            f" one of them was copied or set back, and both went on. {_doubled(one, other)}"
        )
    elif one.public_keys & other.public_keys:
        merged.faults.append(
            f"The ledgers in {one.folder} and {other.folder} belong to the same key ({one.bench}), but they begin"
            f" differently: one of them was deleted and begun again. {_doubled(one, other)}"
        )


def _common_lines(shorter: Sequence[Entry], longer: Sequence[Entry]) -> int:
    pairs = enumerate(zip(shorter, longer, strict=False))
    return next((place for place, (a, b) in pairs if a.hash != b.hash), len(shorter))


def _doubled(one: LedgerSource, other: LedgerSource) -> str:
    """Name the numbers that two ledgers give to different runs."""
    there = {run.number: run for run in other.runs}
    pairs = [(run, there[run.number]) for run in one.runs if run.number in there]
    twice = [(a, b) for a, b in pairs if a.head != b.head]
    if not twice:
        return "No number was given twice."
    shown = "; ".join(f"{a.number}: {a.folder} and {b.folder}" for a, b in twice[:3])
    more = f"; and {len(twice) - 3} more" if len(twice) > 3 else ""
    return f"The same number was given to two runs: {shown}{more}. Both are listed."
