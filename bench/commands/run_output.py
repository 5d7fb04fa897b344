"""Output of the commands about runs: text for people, JSON for programs (`bench.commands.run_commands`)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click
from pydantic import ValidationError

from bench.base.clock import BenchClock
from bench.base.errors import JournalBroken, UsageError
from bench.base.home import home_folder
from bench.commands.ledger_output import bench_ledger, ledger_findings
from bench.commands.output import print_json
from bench.commands.run_choice import RunChoice, find_runs, print_findings
from bench.evidence.ledger_authorisation import known_authorisations, lost_authorisations
from bench.evidence.shown_state import home_trust, shown_state
from bench.records.ledger import Ledger
from bench.records.run_folder import JOURNAL
from bench.records.run_index import IndexedRun, RunIndex, run_folders
from bench.report.text import with_uncertainty
from bench.results.agreement import Agreement, compare_runs
from bench.terminal.wording import counted


def show_intentions(lines: Sequence[str], *, as_json: bool) -> int:
    """Print what resuming a run would do.

    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    """
    if as_json:
        print_json({"schema": "starbench/intentions/1", "intentions": list(lines)})
    else:
        click.echo("\n".join(lines))
    return 0


def send_command(folder: Path, word: str, *, by: str | None, as_json: bool, **fields: Any) -> int:
    """Send a command to a run and print the answer.

    by: Name of the operator; user@host where None.
    as_json: Whether to print JSON.
    fields: Other fields of `bench.run.control.Command`.
    Returns: Exit status: 0 accepted, 1 refused.
    Raises UsageError: If the operator's name is not valid.
    """
    from bench.run.control import Command, command_text, operator_at_terminal, send

    try:
        command = Command.model_validate({"word": word, "by": by or operator_at_terminal(), **fields})
    except ValidationError as error:
        raise UsageError(
            f"--operator: {error.errors()[0]['msg']}.",
            remedy="Give a name of one line and at most 200 characters.",
        ) from error
    answer = send(folder, command)
    if as_json:
        print_json({"schema": "starbench/answer/1", **answer})
    else:
        click.echo(command_text(answer), err=not answer["taken"])
    return 0 if answer["taken"] else 1


# ---------------------------------------------------------------- all runs


def show_runs(choice: RunChoice, *, compare: bool, as_json: bool) -> int:
    """Print a list of runs, or compare their parameters.

    compare: Whether to compare the parameters.
    as_json: Whether to print JSON.
    Returns: Exit status: 1 if the ledgers and the folders do not agree, else 0.
    Raises UsageError: If a ledger is missing, or the runs cannot be compared.
    """
    if choice.ledgers:
        merged = find_runs(choice)
        found, faults, notes = merged.runs, merged.faults, merged.notes
    else:
        index, ledger = RunIndex(home_folder()), bench_ledger()
        folder = choice.folder
        folders, missing = (run_folders(folder), []) if folder else _ledger_folders(ledger, index)
        found, faults = index.runs(folders, **choice.filters)
        broken, notes = ledger_findings(ledger)
        faults += [*missing, *broken, *lost_authorisations(known_authorisations(ledger.home))]
    solved = [run for run in found if run.parameters]
    compared = compare_runs(solved) if compare else None
    if as_json:
        states = _states(found)
        rows = [{**run.to_dict(), "state": states[run.folder]} for run in found]
        facts: dict[str, Any] = {"schema": "starbench/runs/1", "runs": rows}
        if compared is not None:
            facts |= {"compared": [a.to_dict() for a in compared], "of": [run.folder for run in solved]}
        print_json({**facts, "faults": faults, **({"notes": notes} if notes else {})})
        return 1 if faults else 0
    click.echo(_agreement_text(solved, compared) if compared is not None else _runs_text(found))
    print_findings(notes, faults)
    return 1 if faults else 0


def _ledger_folders(ledger: Ledger, index: RunIndex) -> tuple[list[Path], list[str]]:
    """Return the folders of all runs in the ledger that still exist, and a fault for each of the others.

    If the ledger is damaged, the folders come from the index; the damage is among the breaks of the ledger.
    """
    try:
        entries = ledger.runs()
    except JournalBroken:
        known = [Path(run.folder) for run in index.entered()]
        return [folder for folder in known if (folder / JOURNAL).is_file()], []
    present = [Path(run.folder) for run in entries if (Path(run.folder) / JOURNAL).is_file()]
    missing = [
        f"run {run.number} ({run.run_id}, {run.how}): its folder {run.folder} is missing"
        for run in entries
        if run.seal is None and not (Path(run.folder) / JOURNAL).is_file()
    ]
    return present, [*ledger.faults(), *missing]


def _runs_text(runs: Sequence[IndexedRun]) -> str:
    if not runs:
        return "No runs."
    states = _states(runs)
    lines = [f"{'begun (UTC)':<17} {'camera':<10} {'how':<9} {'poses':>5}  {'rms px':>7}  run"]
    for run in runs:
        rms = "" if run.rms_px is None else f"{run.rms_px:.4f}"
        marks = "  REHEARSAL" if run.rehearsal else "  SIMULATED" if run.simulated else ""
        marks += f"  {states[run.folder]}"
        marks += f"  {counted(run.deviations, 'deviation')}" if run.deviations else ""
        begun = run.begun_utc[:16].replace("T", " ")
        lines.append(
            f"{begun:<17} {run.camera:<10} {run.how:<9} {run.accepted:>5}  {rms:>7}  {run.folder}{marks}"
        )
    return "\n".join(lines)


def _states(runs: Sequence[IndexedRun]) -> dict[str, str]:
    """Return DRAFT, SEALED or AUTHORISED by folder, from the signatures beside each run."""
    trust, now = home_trust(home_folder()), datetime.now(UTC)
    return {run.folder: str(shown_state(Path(run.folder), trust, now).state) for run in runs}


def _signed(number: float) -> str:
    """Write a number with its sign and two decimals; zero has no sign."""
    text = f"{number:+.2f}"
    return "0.00" if float(text) == 0 else text


def _agreement_text(runs: Sequence[IndexedRun], compared: Sequence[Agreement]) -> str:
    head = f"{len(runs)} runs of camera {runs[0].camera}, {runs[0].model} model."
    head += " ± is the expanded uncertainty U (about 95 %): k = 2 for a mean, the k of its report for a run."
    lines = [head]
    for parameter in compared:
        mean, expanded = with_uncertainty(parameter.mean, 2.0 * parameter.sigma)
        lines.append(f"{parameter.name}: mean {mean} ± {expanded}, Birge ratio {parameter.birge:.2f}")
        for run, deviation in zip(runs, parameter.deviations, strict=True):
            found, sigma = run.parameters[parameter.name]
            value, own = with_uncertainty(found, run.k * sigma)
            begun = run.begun_utc[:16].replace("T", " ")
            lines.append(
                f"  {begun}  {value:>12} ± {own:<8} (k = {run.k:.2f})  {_signed(deviation):>6} sigma  {run.id}"
            )
    return "\n".join(lines)


def show_messages(*, send_now: bool, as_json: bool) -> int:
    """Print the messages of this bench, after trying to send the waiting ones if asked to.

    send_now: Whether to try to send waiting messages now.
    as_json: Whether to print JSON.
    Returns: Exit status: 1 if messages are still waiting after ``send_now``, else 0.
    """
    from bench.messaging.messages import send
    from bench.messaging.outbox import Outbox

    outbox = Outbox(home_folder())
    waiting = outbox.deliver(send, BenchClock().utc_now(), all_waiting=True) if send_now else 0
    found = outbox.deliveries()
    if as_json:
        print_json({"schema": "starbench/messages/1", "messages": [asdict(delivery) for delivery in found]})
        return 1 if waiting else 0
    for delivery in found:
        marks = f", {delivery.tries} tries" if delivery.tries > 1 else ""
        marks += ", perhaps sent twice" if delivery.perhaps_twice else ""
        marks += f"; {delivery.last_error}" if delivery.last_error else ""
        kind = next(iter(json.loads(delivery.channel)))
        written, subject = delivery.message.utc[:16].replace("T", " "), delivery.message.subject
        click.echo(f"{written}  {kind:<7} {delivery.state:<7}  {subject}{marks}")
    if not found:
        click.echo("No messages.")
    return 1 if waiting else 0
