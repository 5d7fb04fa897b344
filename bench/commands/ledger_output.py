"""Output of the commands about the ledger: text for people, JSON for programs (`bench.commands.ledger_commands`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from bench.base.clock import BenchClock
from bench.base.errors import BenchError
from bench.base.home import home_folder
from bench.commands.output import print_json
from bench.evidence.ledger_authorisation import known_authorisations, lost_authorisations
from bench.evidence.ledger_check import sealed_strangers
from bench.records.ledger import Ledger
from bench.records.ledger_breaks import EXPLAIN, Break
from bench.records.ledger_marks import OwnMark, ask_anchor, read_own_mark
from bench.records.ledger_runs import runs_of
from bench.run.control import operator_at_terminal
from bench.terminal.wording import counted


def bench_ledger() -> Ledger:
    """Return the ledger of this bench.

    Returns: The ledger; its file may not exist.
    """
    clock = BenchClock()
    return Ledger(home_folder(), utc_now=clock.utc_now, monotonic=clock.monotonic)


def ledger_findings(ledger: Ledger) -> tuple[list[str], list[str]]:
    """Compare the ledger with all places that know of it.

    Returns: Breaks that nobody has explained; the last one says what to do.
    Returns: Explained breaks, and places that could not be asked.
    """
    faults, explained = ledger.breaks(None, sealed_strangers(ledger.home))
    if faults:
        faults[-1] += f" {EXPLAIN}"
    return faults, [*map(explained_text, explained), *ledger.warnings]


def explained_text(one: Break) -> str:
    """Return an explained break as text."""
    return f"{one} Reason, stated by {one.by}: {one.reason}"


def show_check(*, as_json: bool) -> int:
    """Print the state of the ledger and every fault of it.

    as_json: Whether to print JSON.
    Returns: Exit status: 1 if there is a fault, else 0.
    """
    ledger = bench_ledger()
    faults, notes = ledger_findings(ledger)
    facts: dict[str, Any] = {"schema": "starbench/ledger/1", "file": str(ledger.path)}
    try:
        entries = ledger.entries()
        runs = runs_of(entries)
        head = entries[-1].hash if entries else None
        facts |= {"lines": len(entries), "runs": len(runs), "head": head}
        faults += [*ledger.faults(), *lost_authorisations(known_authorisations(ledger.home))]
    except BenchError:  # it is among the faults
        facts |= {"lines": None, "runs": None, "head": None}
    places = _second_places(ledger)
    if as_json:
        print_json({**facts, "second_places": places, "faults": faults, "notes": notes})
        return 1 if faults else 0
    if facts["head"]:
        lines, runs_text = counted(facts["lines"], "line"), counted(facts["runs"], "run")
        click.echo(f"{ledger.path}: {lines}, {runs_text}\nhead {facts['head']}")
    elif facts["lines"] == 0:
        click.echo(f"{ledger.path}: no ledger yet.")
    for place in places:
        newest = place["newest"]
        state = f"up to line {newest['lines']}" if newest else place["trouble"] or "no marks"
        click.echo(f"second place {place['place']}: {state}")
    for note in notes:
        click.echo(f"Note: {note}")
    for fault in faults:
        click.echo(f"FAULT: {fault}", err=True)
    return 1 if faults else 0


def _second_places(ledger: Ledger) -> list[dict[str, Any]]:
    try:
        own = read_own_mark(ledger.home)
    except BenchError:  # it is among the faults
        own = None
    found = []
    for place in own.anchors if isinstance(own, OwnMark) else ():
        witness = ask_anchor(Path(place), was_there=True)
        newest = witness.marks[-1].to_dict() if witness.marks else None
        found.append({"place": place, "newest": newest, "trouble": witness.trouble})
    return found


def explain_breaks(reason: str, *, by: str | None, as_json: bool) -> int:
    """State the reason of every break of the ledger that has none.

    by: Name of the person; user@host where None.
    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    Raises UsageError: When there is nothing to explain.
    """
    ledger, person = bench_ledger(), by or operator_at_terminal()
    found = ledger.explain(reason, person, strangers=sealed_strangers(ledger.home))
    if as_json:
        print_json(
            {"schema": "starbench/ledger-explained/1", "by": person, "reason": reason, "breaks": found}
        )
        return 0
    for one in found:
        click.echo(one)
    click.echo(f"Entered in the ledger as {person}: {reason}")
    return 0


def forget_place(place: str, reason: str, *, by: str | None) -> int:
    """Write the ledger to a second place no longer.

    by: Name of the person; user@host where None.
    Returns: Exit status, 0.
    Raises UsageError: When it is no second place of the ledger.
    """
    bench_ledger().forget_place(place, reason=reason, by=by or operator_at_terminal())
    click.echo(f"The ledger is no longer written to {place}; the reason is in the ledger.")
    return 0
