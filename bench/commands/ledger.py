"""The command `ledger`: check the ledger of this bench, and explain a break of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from bench.base.encoding import counted
from bench.base.errors import BenchError, UsageError
from bench.commands.options import OPERATOR, command, status_text
from bench.commands.output import JSON, print_findings, show
from bench.evidence.authorisations import lost_authorisations
from bench.evidence.ledger_check import sealed_strangers
from bench.record.ledger import Ledger, bench_ledger
from bench.record.ledger_marks import EXPLAIN, runs_of

_LONGEST_REASON = 2000  # A page; more belongs into a file


@command(
    "starbench ledger",
    "starbench ledger --explain 'The disk was restored from the copy of Monday.'",
    status=status_text("0 no fault, 1 a fault{invalid}{ctrl_c}"),
)
@click.option(
    "--explain",
    metavar="TEXT",
    help="State what happened to the ledger, or to a run that is missing, so that this is explained. The reason is"
    " added; nothing is rewritten.",
)
@OPERATOR
@JSON
def ledger(explain: str | None, by: str | None) -> int:
    """Compare the ledger of this bench with its own mark and with the sealed runs of this bench."""
    if explain is None:
        return _check()
    person = " ".join((by or "").split())[:200] or None
    return _explain_breaks(_one_line(explain), person)


def _one_line(reason: str) -> str:
    """Return a reason as one line. Raises UsageError if it is too short or too long."""
    text = " ".join(reason.split())
    if not 3 <= len(text) <= _LONGEST_REASON:
        raise UsageError(
            f"--explain has {len(text)} characters.",
            remedy=f"State in one or two sentences what happened, in 3 to {_LONGEST_REASON} characters.",
        )
    return text


def ledger_findings(ledger: Ledger) -> tuple[list[str], list[str]]:
    """Return unexplained breaks of the ledger, with what to do, and explained ones."""
    faults, explained = ledger.breaks(sealed_strangers(ledger.home, Path()))
    if faults:
        faults[-1] += f" {EXPLAIN}"
    return faults, [*map(str, explained)]


def _check() -> int:
    """Print the state of the ledger and every fault of it; return 1 if there is a fault."""
    bench_own = bench_ledger()
    faults, notes = ledger_findings(bench_own)
    facts: dict[str, Any] = {"schema": "starbench/ledger/1", "file": str(bench_own.path)}
    try:
        entries = bench_own.entries()
        runs = runs_of(entries)
        head = entries[-1].hash if entries else None
        facts |= {"lines": len(entries), "runs": len(runs), "head": head}
        faults += [
            *bench_own.faults_and_remedies(),
            *lost_authorisations(bench_own.home),
        ]
        notes += [
            f"{entry.data['what']}. Reason, stated by {entry.data['by']}: {entry.data['reason']}"
            for entry in bench_own.explained_runs()
        ]
    except BenchError:  # it is among the faults
        facts |= {"lines": None, "runs": None, "head": None}
    show({**facts, "faults": faults, "notes": notes}, _check_lines(facts, notes))
    return print_findings(faults)


def _check_lines(facts: Mapping[str, Any], notes: Sequence[str]) -> Iterator[str]:
    if facts["head"]:
        lines, runs = counted(facts["lines"], "line"), counted(facts["runs"], "run")
        yield from (f"{facts['file']}: {lines}, {runs}", f"head {facts['head']}")
    elif facts["lines"] == 0:
        yield f"{facts['file']}: there is no ledger."
    for note in notes:
        yield f"Note: {note}"


def _explain_breaks(reason: str, by: str | None) -> int:
    """State the reason of every break of the ledger that has none. Raises UsageError if there is none."""
    from bench.run.control import operator_at_terminal

    bench_own, person = bench_ledger(), by or operator_at_terminal()
    breaks = bench_own.explain(reason, person, strangers=sealed_strangers(bench_own.home, Path()))
    show(
        {"schema": "starbench/ledger-explained/1", "by": person, "reason": reason, "breaks": breaks},
        [*map(str, breaks), f"Entered in the ledger as {person}: {reason}"],
    )
    return 0
