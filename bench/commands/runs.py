"""The command `runs`: the list of runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from bench.base.clock import BenchClock
from bench.base.encoding import counted
from bench.base.errors import JournalBroken
from bench.base.home import home_folder
from bench.commands.ledger import ledger_findings
from bench.commands.options import RunChoice, command, run_options, status_text
from bench.commands.output import JSON, print_findings, show
from bench.commands.workers import CountLine
from bench.evidence.authorisations import lost_authorisations
from bench.evidence.findings import State
from bench.evidence.listed_states import listed_states
from bench.evidence.merged_runs import LedgerSource, MergedRuns, merge_ledgers, merge_runs, read_source
from bench.record.ledger import Ledger, bench_ledger
from bench.record.run_facts import IndexedRun
from bench.record.run_folder import JOURNAL
from bench.record.run_index import RunIndex, run_folders
from bench.wording.causes import listed_verdict


@command(
    "starbench runs --serial 00051234 --since 2026-03-01",
    "starbench runs runs/night --how failed",
    status=status_text(
        "0 runs shown, 1 a run is missing or was changed, or the ledger is broken{invalid}{ctrl_c}"
    ),
)
@run_options
@click.option(
    "--how",
    type=click.Choice(["finished", "aborted", "failed", "running", "cut off"]),
    help="Only runs with this outcome or status.",
)
@JSON
def runs(**given: Any) -> int:
    """List the runs in FOLDER; without FOLDER, all runs in the ledger of this bench.

    The command names runs that occur twice, are missing or were changed. A seal that held is verified again when its
    files change; verify checks all files.
    """
    choice = RunChoice.of(given)
    if choice.ledgers:
        merged = find_runs(choice)
        listed, faults, notes = merged.runs, merged.faults, merged.notes
    else:
        listed, faults, notes = _runs_of_bench(choice)
    findings = {"faults": faults, **({"notes": notes} if notes else {})}
    show(lambda: {**_runs_dict(listed), **findings}, _runs_lines(listed))
    return print_findings(faults, notes)


def find_runs(choice: RunChoice) -> MergedRuns:
    """Find runs by ledgers and folders, and name what does not agree."""
    home, clock = home_folder(), BenchClock()

    def source(folder: Path, *, required: bool) -> LedgerSource:
        ledger = Ledger(folder, clock)
        return read_source(ledger, required=required)

    named = [source(folder, required=True) for folder in choice.ledgers]
    ledgers = merge_ledgers(named or [source(home, required=False)])
    folders = run_folders(choice.folder) if choice.folder else []
    index = RunIndex(home)
    merged = merge_runs(index, ledgers, folders, only_folders=bool(choice.folder and not choice.ledgers))
    if any(value is not None for value in choice.filters.values()):
        merged.runs, _ = index.runs([Path(run.folder) for run in merged.runs], **choice.filters)
    return merged


def _runs_of_bench(choice: RunChoice) -> tuple[list[IndexedRun], list[str], list[str]]:
    """Return the runs of this bench, faults, and notes."""
    index, ledger = RunIndex(home_folder()), bench_ledger()
    folders, missing = (run_folders(choice.folder), []) if choice.folder else _ledger_folders(ledger, index)
    line = CountLine(len(folders), "runs read")
    listed, faults = index.runs(folders, **choice.filters, progress=line.count)
    line.clear()
    broken, notes = ledger_findings(ledger)
    return (
        listed,
        [*faults, *missing, *broken, *lost_authorisations(ledger.home)],
        notes,
    )


def _ledger_folders(ledger: Ledger, index: RunIndex) -> tuple[list[Path], list[str]]:
    """Return the ledger's existing run folders, a fault for the others; the index's if the ledger is damaged."""
    try:
        entries = ledger.runs()
    except JournalBroken:
        known = [Path(run.folder) for run in index.entered()]
        return [folder for folder in known if (folder / JOURNAL).is_file()], []
    there = [Path(f"{run.folder}/{JOURNAL}").is_file() for run in entries]
    present = [Path(run.folder) for run, is_there in zip(entries, there, strict=True) if is_there]
    missing = [
        f"run {run.number} ({run.run_id}, {run.how}): its folder {run.folder} is missing"
        for run, is_there in zip(entries, there, strict=True)
        if run.seal is None and not is_there
    ]
    return present, [*ledger.faults_and_remedies(), *missing]


def _runs_dict(runs: Sequence[IndexedRun]) -> dict[str, Any]:
    states = _states(runs)
    rows = [{**run.to_dict(), "state": states[run.folder]} for run in runs]
    return {"schema": "starbench/runs/1", "runs": rows}


def _runs_lines(runs: Sequence[IndexedRun]) -> Iterator[str]:
    if not runs:
        yield "No runs."
        return
    states = _states(runs)
    yield f"{'begun (UTC)':<17} {'camera':<10} {'how':<9} {'poses':>5}  {'rms px':>7}  run"
    for run in runs:
        rms = "" if run.rms_px is None else f"{run.rms_px:.4f}"
        marks = "  REHEARSAL" if run.rehearsal else "  SIMULATED" if run.simulated else ""
        marks += f"  {states[run.folder]}"
        marks += f"  {counted(run.deviations, 'deviation')}" if run.deviations else ""
        begun = run.begun_utc[:16].replace("T", " ")
        yield f"{begun:<17} {run.camera:<10} {run.how:<9} {run.accepted:>5}  {rms:>7}  {run.folder}{marks}"
        if run.verdict and run.verdict["kind"] != "pass":
            yield f"  {listed_verdict(run.verdict, run.causes)}"


def _states(runs: Sequence[IndexedRun]) -> dict[str, State]:
    """Return DRAFT, SEALED or AUTHORISED by folder, from the signatures beside each run."""
    sealed = [run.folder for run in runs if run.sealed]
    line = CountLine(len(sealed), "seals verified")
    states = listed_states(sealed, home_folder(), datetime.now(UTC), line.count)
    line.clear()
    return {run.folder: states.get(run.folder, State.DRAFT) for run in runs}
