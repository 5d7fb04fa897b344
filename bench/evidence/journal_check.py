"""What a journal states, checked against itself and the files: begin, end, clock, hashes.

An attacker who holds the bench's key can write the whole chain again. These checks then still find what he did not
write consistently; `bench.again.run` compares the journal with what the recordings give.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from bench.base.bounded_json import parse_json
from bench.base.errors import RunFolderError
from bench.evidence.findings import Findings
from bench.record.events import Event
from bench.record.history import History
from bench.record.journal import CAPTURES, CLOCK_JUMP_S, CLOCK_JUMPED, Capture
from bench.record.journal_line import Entry
from bench.record.recovery import EXPORTS, VIEWS
from bench.record.run_folder import (
    CHECKED_COPY,
    JOURNAL,
    PASSPORT_COPY,
    PLAN,
    REPORT,
    RESULTS,
    SEQUENCE_COPY,
    STATION_COPY,
)
from bench.record.storage import is_plain_file
from bench.record.stored_run import StoredRun

_BEGUN_WITH = (SEQUENCE_COPY, STATION_COPY, PLAN)
_WRITTEN = (RESULTS, REPORT, VIEWS)
"""Files that the report step writes, besides the exports."""
_KINDS = {
    **dict.fromkeys((*_BEGUN_WITH, PASSPORT_COPY, CHECKED_COPY), "plan"),
    CAPTURES: "recording",
    RESULTS: "results",
    REPORT: "report",
    VIEWS: "views",
    EXPORTS: "exports",
}
"""Kind of the faults of each file, or of the files in a folder, that the journal must name."""
_CLOCK_SLACK_S = 0.05  # A line's two clocks are read one after the other; a busy computer comes between


def check_journal(folder: Path, manifest: Mapping[str, str], findings: Findings) -> Mapping[str, Capture]:
    """Check a run's journal, and the files of the folder and of the seal's list against it."""
    path = folder / JOURNAL
    if not is_plain_file(path):
        findings.fault("journal", JOURNAL, "the file is missing")
        return {}
    try:
        run = StoredRun(folder)
        entries, torn, captures, history = run.entries, run.torn, run.captures, run.history
    except RunFolderError as error:
        findings.fault("journal", error.where.removeprefix(f"{folder}/") or JOURNAL, error.what)
        return {}
    if torn:
        findings.fault("journal", JOURNAL, "its last line is incomplete")
        return captures
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        if json.dumps(parse_json(line), separators=(",", ":")).encode() != line:
            findings.fault(
                "journal", f"{JOURNAL}:{number}", "its JSON is not written as the program writes it"
            )
            return captures
    _begin_and_end(entries, history, findings)
    _clock(entries, findings)
    _files(manifest, captures, entries, history, findings)
    return captures


def _begin_and_end(entries: Sequence[Entry], history: History, findings: Findings) -> None:
    fault = partial(findings.fault, "journal")
    if not entries or entries[0].event != Event.RUN_STARTED:
        fault(f"{JOURNAL}:1", "the first line does not begin a run (run_started)")
    again = [entry for entry in entries[1:] if entry.event == Event.RUN_STARTED]
    if again:
        fault(f"{JOURNAL}:{again[0].seq + 1}", "a second line begins the run (run_started)")
    if not entries or entries[-1].event != Event.RUN_ENDED:
        fault(JOURNAL, "its last line does not end the run (run_ended); a bench seals ended runs only")
    elif history.ended != "finished":
        fault(JOURNAL, f"the run {history.ended or 'did not end'}; a bench seals finished runs only")


def _clock(entries: Sequence[Entry], findings: Findings) -> None:
    """Compare both clocks from line to line; the journal has a line for each jump of the system's clock."""
    for last, entry in itertools.pairwise(entries):
        try:
            passed_s = (_moment(entry) - _moment(last)).total_seconds()
            jumped_s = passed_s - (entry.mono_s - last.mono_s)
            back = entry.mono_s < last.mono_s
        except (TypeError, ValueError):
            findings.fault("journal", f"{JOURNAL}:{entry.seq + 1}", "its time cannot be read")
            return
        if entry.event == CLOCK_JUMPED:
            what = f"the computer's clock jumped by {entry.data.get('jump_s')!a:.9} s during the run"
            findings.remarks.append(
                f"{JOURNAL}:{entry.seq + 1}: {what}; the times before and after do not agree"
            )
            continue
        bound_s = CLOCK_JUMP_S + _CLOCK_SLACK_S
        other_process = entry.event == Event.RUN_RESUMED  # its monotonic clock may begin anew
        if passed_s < -bound_s if other_process else back or abs(jumped_s) > bound_s:
            what = "its time does not follow from the line before, and no line states that the clock jumped"
            findings.fault("journal", f"{JOURNAL}:{entry.seq + 1}", what)
            return


def _moment(entry: Entry) -> datetime:
    return datetime.fromisoformat(entry.utc)


def _files(
    manifest: Mapping[str, str],
    captures: Mapping[str, Capture],
    entries: Sequence[Entry],
    history: History,
    findings: Findings,
) -> None:
    """Compare the files of the seal's list with those that the journal names, each with its hash."""
    stated = {name: capture.sha256 for name, capture in captures.items()}
    written: Mapping[str, Any] = next(
        (entry.data for entry in reversed(entries) if entry.event == Event.WRITTEN), {}
    )
    for hashes in (history.started.get("sha256"), written.get("files")):
        stated |= hashes if isinstance(hashes, dict) else {}
    gone = {
        str(name)
        for entry in entries
        if entry.event == Event.RECOVERED
        for name in (*entry.data.get("missing", ()), *entry.data.get("changed", ()))
    }
    for name, sha256 in stated.items():
        if name in manifest and manifest[name] != sha256:
            findings.fault(_kind_of(name), name, "the journal names this file with another hash")
        elif name not in manifest and name not in gone:
            findings.fault(_kind_of(name), name, "the journal names this file; it is missing")
    for name in manifest:
        if _kind_of(name) and name not in stated:
            findings.fault(_kind_of(name), name, "the journal does not name this file")
    for name in (*_BEGUN_WITH, *(_WRITTEN if _reported(entries) else ())):
        if name not in stated:
            findings.fault("journal", JOURNAL, f"it does not state the hash of {name}")


def _kind_of(name: str) -> str:
    """Return the kind of the faults of a file that the journal must name; empty for another file."""
    return _KINDS.get(name) or _KINDS.get(name.partition("/")[0], "")


def _reported(entries: Sequence[Entry]) -> bool:
    """Return whether the report step has ended without an error."""
    return any(
        entry.event == Event.LEFT_OFF and entry.data.get("state") == "reporting" and "error" not in entry.data
        for entry in entries
    )
