"""Checks many sealed folders by many workers: a line for each, and the sum at the end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from bench.cluster.kept_rows import KeptRows
from bench.cluster.verifications import VERIFIED, Check, Checked, check_one
from bench.cluster.work import Finished, Workers, map_work
from bench.commands.evidence_output import NOT_COMPARED
from bench.commands.live_line import CountLine
from bench.commands.many_output import CONTINUES
from bench.commands.output import print_json
from bench.evidence.findings import Findings, Verification
from bench.terminal.encoding import printable
from bench.terminal.signals import reliable_interrupts

ThisBench = Callable[[Path, str], Findings]


def verify_many(
    folders: Sequence[Path],
    check: Check,
    workers: Workers,
    output: Path | None,
    this_bench: ThisBench,
    *,
    as_json: bool,
) -> int:
    """Check folders, and print what was found.

    output: Folder that keeps what was derived again; None to keep nothing.
    this_bench: Checks of a folder, by its path and kind, that only this bench can make.
    as_json: Whether to print JSON.
    Returns: Exit status: 0 no fault, and everything was compared; 1 a fault; 4 no fault, but not everything
      was compared.
    Raises WorkersLost: If nobody is left who could do the work.
    Raises StorageError: If findings cannot be kept.
    """
    chosen = list(dict.fromkeys(folder.absolute() for folder in folders))
    line = CountLine(len(chosen), "folders", quiet=as_json)
    rows: dict[int, dict[str, Any]] = {}
    states: Counter[str] = Counter()
    with reliable_interrupts(), ExitStack() as stack:
        stack.callback(workers.close)
        kept = stack.enter_context(KeptRows(output, VERIFIED)) if output is not None else None
        work = ((folder, check, kept.get(str(folder)) if kept else None) for folder in chosen)
        try:
            for number, end in map_work(check_one, work, workers):
                state, text, rows[number] = _ended(chosen[number], end, kept, this_bench)
                states[state] += 1
                line.clear()
                click.echo(printable(text), err=as_json)
                line.count()
        except BaseException:
            line.clear()
            click.echo(
                f"{line.text()} checked. {CONTINUES if output else 'Nothing is kept: give -o.'}", err=True
            )
            raise
    line.clear()
    if as_json:
        print_json({"folders": [rows[number] for number in sorted(rows)], **states})
    else:
        counted = ", ".join(f"{states[state]} {_WORDS[state]}" for state in _WORDS if states[state])
        click.echo(f"{len(chosen)} folders: {counted}.")
    return 1 if states["failed"] else NOT_COMPARED if states["incomplete"] else 0


_WORDS = {"ok": "verified", "incomplete": "not compared completely", "failed": "NOT VERIFIED"}


def _ended(
    folder: Path, end: Finished, kept: KeptRows | None, this_bench: ThisBench
) -> tuple[str, str, dict[str, Any]]:
    """Return state, line and JSON of a folder."""
    if end.failure is not None:
        why = f"{end.failure.message}{end.defect and chr(10) + end.defect}"
        row = {"folder": str(folder), "ok": False, "complete": False, "failure": end.failure.to_dict()}
        return "failed", f"{folder.name}: NOT VERIFIED. {why}", row
    checked: Checked = end.value
    if kept is not None and checked.key and not checked.before:
        kept.add(str(folder), {"key": checked.key, "derived": checked.derived})
    found = checked.verification
    if found.ok:
        found = _with(found, this_bench(folder, found.kind))
    if not found.ok:
        faults = " ".join(f"{fault}." for fault in found.faults)
        return "failed", f"{folder.name}: NOT VERIFIED. {faults}", found.to_dict()
    camera = f", camera {found.camera_serial}" if found.camera_serial else ""
    simulated = ", SIMULATED devices" if found.simulated else ""
    text = f"{folder.name}: {found.state}, {found.files} files, sealed by {found.signer}{camera}{simulated}."
    if not found.complete:
        return "incomplete", f"{text} NOT COMPARED: {'; '.join(found.not_compared)}.", found.to_dict()
    return "ok", text, found.to_dict()


def _with(found: Verification, more: Findings) -> Verification:
    return replace(
        found,
        faults=(*found.faults, *more.faults),
        not_compared=(*found.not_compared, *more.not_compared),
        remarks=(*found.remarks, *more.remarks),
    )
