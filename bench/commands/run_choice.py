"""Which runs `starbench runs` is about, and how faults of ledgers and folders are printed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from bench.commands.output import wants_json

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


def print_findings(notes: Sequence[str], faults: Sequence[str]) -> None:
    """Print notes and faults to the standard error stream; of very many, the first ones and their number."""
    if wants_json():
        return
    for word, sentences in (("Note", notes), ("FAULT", faults)):
        for sentence in sentences[:_MOST_SHOWN]:
            click.echo(f"{word}: {sentence}", err=True)
        if len(sentences) > _MOST_SHOWN:
            click.echo(f"{word}: and {len(sentences) - _MOST_SHOWN} more; --json lists all.", err=True)
