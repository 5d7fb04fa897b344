"""The command `ledger`: check the ledger of this bench, explain a break of it, leave a second place out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from bench.base.encoding import counted
from bench.base.errors import BenchError, UsageError
from bench.commands.options import OPERATOR, command, status_text
from bench.commands.output import JSON, print_findings, show
from bench.evidence.authorisations import entered_authorisations, lost_authorisations
from bench.evidence.ledger_check import sealed_strangers
from bench.record.ledger import Ledger, bench_ledger
from bench.record.ledger_marks import EXPLAIN, Break, OwnMark, ask_anchor, read_own_mark, runs_of

_LONGEST_REASON = 2000  # A page; more belongs into a file


@command(
    "starbench ledger",
    "starbench ledger --explain 'The disk was restored from the copy of Monday.'",
    "starbench ledger --forget /mnt/office/bench2.heads --reason 'The office has a new server.'",
    status=status_text("0 no fault, 1 a fault{invalid}{ctrl_c}"),
)
@click.option(
    "--explain",
    metavar="TEXT",
    help="State what happened to the ledger, or to a run that is missing, so that this is explained. The reason is"
    " added; nothing is rewritten.",
)
@click.option(
    "--forget",
    metavar="PLACE",
    help="Stop writing the ledger to this second place, such as a share that was taken away.",
)
@click.option("--reason", metavar="TEXT", help="With --forget: why the place is not used any more.")
@OPERATOR
@JSON
def ledger(explain: str | None, forget: str | None, reason: str | None, by: str | None) -> int:
    """Compare the ledger of this bench with its second places and with the sealed runs of this bench."""
    if explain is not None and forget is not None:
        raise UsageError("Give one of --explain and --forget.", remedy="Call the command once for each.")
    if forget is not None and reason is None:
        raise click.UsageError("Missing option '--reason', which --forget needs.")
    person = " ".join((by or "").split())[:200] or None
    if explain is not None:
        return _explain_breaks(_one_line(explain, "--explain"), person)
    if forget is not None:
        return _forget_place(forget, _one_line(reason or "", "--reason"), person)
    return _check()


def _one_line(reason: str, option: str) -> str:
    """Return a reason as one line. Raises UsageError if it is too short or too long."""
    text = " ".join(reason.split())
    if not 3 <= len(text) <= _LONGEST_REASON:
        raise UsageError(
            f"{option} has {len(text)} characters.",
            remedy=f"State in one or two sentences what happened, in 3 to {_LONGEST_REASON} characters.",
        )
    return text


def ledger_findings(ledger: Ledger) -> tuple[list[str], list[str]]:
    """Return unexplained breaks of the ledger, with what to do; explained ones, and places not asked."""
    faults, explained = ledger.breaks(None, sealed_strangers(ledger.home, Path()))
    if faults:
        faults[-1] += f" {EXPLAIN}"
    return faults, [*map(_explained_text, explained), *ledger.warnings]


def _explained_text(explained: Break) -> str:
    """Return an explained break as text."""
    return f"{explained} Reason, stated by {explained.by}: {explained.reason}"


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
            *lost_authorisations(entered_authorisations(bench_own)),
        ]
        notes += [
            f"{entry.data['what']}. Reason, stated by {entry.data['by']}: {entry.data['reason']}"
            for entry in bench_own.explained_runs()
        ]
    except BenchError:  # it is among the faults
        facts |= {"lines": None, "runs": None, "head": None}
    facts |= {"second_places": _second_places(bench_own)}
    show({**facts, "faults": faults, "notes": notes}, _check_lines(facts, notes))
    return print_findings(faults)


def _check_lines(facts: Mapping[str, Any], notes: Sequence[str]) -> Iterator[str]:
    if facts["head"]:
        lines, runs = counted(facts["lines"], "line"), counted(facts["runs"], "run")
        yield f"{facts['file']}: {lines}, {runs}\nhead {facts['head']}"
    elif facts["lines"] == 0:
        yield f"{facts['file']}: there is no ledger."
    for place in facts["second_places"]:
        newest = place["newest"]
        state = f"up to line {newest['lines']}" if newest else place["trouble"] or "no marks"
        yield f"second place {place['place']}: {state}"
    for note in notes:
        yield f"Note: {note}"


def _second_places(ledger: Ledger) -> list[dict[str, Any]]:
    try:
        own = read_own_mark(ledger.home)
    except BenchError:  # it is among the faults
        own = None
    places = []
    for place in own.anchors if isinstance(own, OwnMark) else ():
        witness = ask_anchor(Path(place), was_there=True)
        newest = witness.marks[-1].to_dict() if witness.marks else None
        places.append({"place": place, "newest": newest, "trouble": witness.trouble})
    return places


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


def _forget_place(place: str, reason: str, by: str | None) -> int:
    """Stop writing the ledger to a second place. Raises UsageError if it is no second place of the ledger."""
    from bench.run.control import operator_at_terminal

    person = by or operator_at_terminal()
    bench_ledger().forget_place(place, reason=reason, by=person)
    show(
        {"schema": "starbench/ledger-place-forgotten/1", "place": place, "by": person, "reason": reason},
        f"The ledger is no longer written to {place}; the reason is in the ledger.",
    )
    return 0
