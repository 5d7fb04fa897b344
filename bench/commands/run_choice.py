"""Which runs `starbench runs` is about: how they are found, and how faults of ledgers and folders are printed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from bench.base.clock import BenchClock
from bench.base.home import home_folder
from bench.history.ledger_sources import LedgerSource, merge_ledgers, read_source
from bench.history.merged_runs import MergedRuns, merge_runs
from bench.history.seen_ledgers import compare_with_seen
from bench.records.ledger import Ledger
from bench.records.run_index import RunIndex, run_folders

_MOST_SHOWN = 40
"""Most faults that are printed as text."""


@dataclass(frozen=True)
class RunChoice:
    """Which runs a command is about."""

    folder: Path | None  # Folder whose runs to list; all runs of the ledger where None
    # Configuration folders of the benches whose ledgers to merge; this bench's own where empty.
    ledgers: Sequence[Path] = ()
    camera: str | None = None
    # since, until: Only runs that began at or after ``since`` and before ``until``, UTC.
    since: datetime | None = None
    until: datetime | None = None
    sequence: str | None = None  # Text that the name of the sequence must contain
    how: str | None = None

    @property
    def filters(self) -> dict[str, Any]:
        """The filters as `bench.records.run_index.RunIndex.runs` takes them."""
        return {name: getattr(self, name) for name in ("camera", "since", "until", "sequence", "how")}


def find_runs(choice: RunChoice) -> MergedRuns:
    """Find runs by ledgers and folders, and name what does not agree.

    Raises UsageError: When a named folder holds no ledger.
    Raises StorageError: When a file cannot be read.
    """
    home, clock = home_folder(), BenchClock()

    def source(folder: Path, *, required: bool) -> LedgerSource:
        ledger = Ledger(folder, utc_now=clock.utc_now, monotonic=clock.monotonic)
        return read_source(ledger, required=required)

    named = [source(folder, required=True) for folder in choice.ledgers]
    ledgers = merge_ledgers(named or [source(home, required=False)])
    if named:
        faults, notes = compare_with_seen(home, ledgers.sources)
        ledgers.faults += faults
        ledgers.notes += notes
    folders = run_folders(choice.folder) if choice.folder else []
    index = RunIndex(home)
    merged = merge_runs(index, ledgers, folders, only_folders=bool(choice.folder and not choice.ledgers))
    if any(value is not None for value in choice.filters.values()):
        merged.runs, _ = index.runs([Path(run.folder) for run in merged.runs], **choice.filters)
    return merged


def print_findings(notes: Sequence[str], faults: Sequence[str]) -> None:
    """Print notes and faults to the standard error stream; of very many, the first ones and their number."""
    for word, sentences in (("Note", notes), ("FAULT", faults)):
        for sentence in sentences[:_MOST_SHOWN]:
            click.echo(f"{word}: {sentence}", err=True)
        if len(sentences) > _MOST_SHOWN:
            click.echo(f"{word}: and {len(sentences) - _MOST_SHOWN} more; --json lists all.", err=True)
