"""What a journal states, checked against itself and the files: begin, end, clock, hashes, wire log.

An attacker who holds the bench's key can write the whole chain again. These checks then still find what he did not
write consistently; `bench.again.run` compares the journal with what the recordings give.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.base.bounded_json import parse_json
from bench.base.errors import RunFolderError
from bench.evidence.findings import Findings
from bench.record.events import Event
from bench.record.history import History
from bench.record.journal import CAPTURES, CLOCK_JUMP_S, CLOCK_JUMPED, Capture
from bench.record.journal_line import Entry
from bench.record.recovery import EXPORTS
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
from bench.record.stored_run import StoredRun

_WRITTEN = {RESULTS: "results", REPORT: "report", "views.h5": "views"}
"""Files that the report step writes, besides the exports, each with the kind of its faults."""
_CLOCK_SLACK_S = 0.05  # A line's two clocks are read one after the other; a busy computer comes between


def check_journal(folder: Path, manifest: Mapping[str, str], findings: Findings) -> Mapping[str, Capture]:
    """Check a run's journal, and the files of the folder and of the seal's list against it."""
    path = folder / JOURNAL
    if path.is_symlink() or not path.is_file():
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
    _documents(manifest, history, findings)
    _recordings(manifest, captures, entries, findings)
    _written(folder, manifest, entries, findings)
    return captures


def _begin_and_end(entries: Sequence[Entry], history: History, findings: Findings) -> None:
    if not entries or entries[0].event != Event.RUN_STARTED:
        findings.fault("journal", f"{JOURNAL}:1", "the first line does not begin a run (run_started)")
    again = [entry for entry in entries[1:] if entry.event == Event.RUN_STARTED]
    if again:
        findings.fault(
            "journal", f"{JOURNAL}:{again[0].seq + 1}", "a second line begins the run (run_started)"
        )
    if not entries or entries[-1].event != Event.RUN_ENDED:
        findings.fault(
            "journal",
            JOURNAL,
            "its last line does not end the run (run_ended); a bench seals ended runs only",
        )
    elif history.ended != "finished":
        findings.fault(
            "journal", JOURNAL, f"the run {history.ended or 'did not end'}; a bench seals finished runs only"
        )


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
            continue
        bound_s = CLOCK_JUMP_S + _CLOCK_SLACK_S
        other_process = entry.event == Event.RUN_RESUMED  # its monotonic clock may begin anew
        if passed_s < -bound_s if other_process else back or abs(jumped_s) > bound_s:
            what = "its time does not follow from the line before, and no line states that the clock jumped"
            findings.fault("journal", f"{JOURNAL}:{entry.seq + 1}", what)
            return


def _moment(entry: Entry) -> datetime:
    return datetime.fromisoformat(entry.utc)


def _documents(manifest: Mapping[str, str], history: History, findings: Findings) -> None:
    """Compare sequence, station, passport and plan with the hashes in the journal's first line."""
    stated = history.started.get("sha256")
    if not isinstance(stated, dict):
        findings.fault("journal", f"{JOURNAL}:1", "it does not state the hashes of the run's documents")
        return
    for name in (SEQUENCE_COPY, STATION_COPY):
        if name not in stated:
            findings.fault("journal", f"{JOURNAL}:1", f"it does not state the hash of {name}")
    other = "this is not the file that the run began with (hash in the journal's first line)"
    for name, is_missing in _differing(manifest, stated):
        what = "the run began with this file; it is missing" if is_missing else other
        findings.fault("plan", name, what)
    without = {
        PASSPORT_COPY: "without a passport (the journal's first line names none)",
        CHECKED_COPY: "without it (the journal's first line does not name it)",
    }
    for name, what in without.items():
        if name in manifest and name not in stated:
            findings.fault("plan", name, f"the run began {what}")
    if PLAN not in manifest:
        findings.fault("plan", PLAN, "the file is missing")


def _differing(manifest: Mapping[str, str], stated: Mapping[str, Any]) -> Iterator[tuple[str, bool]]:
    """Yield the files that have another hash than is stated, or none, and whether they are missing."""
    for name, sha256 in stated.items():
        if manifest.get(name) != sha256:
            yield str(name), name not in manifest


def _recordings(
    manifest: Mapping[str, str], captures: Mapping[str, Capture], entries: Sequence[Entry], findings: Findings
) -> None:
    """Compare the recordings in the folder with those that the journal names."""
    gone = {
        str(name)
        for entry in entries
        if entry.event == Event.RECOVERED
        for name in (*entry.data.get("missing", ()), *entry.data.get("changed", ()))
    }
    named = {name: capture.sha256 for name, capture in captures.items()}
    for name, is_missing in _differing(manifest, named):
        if not is_missing:
            findings.fault("recording", name, "the journal names this recording with another hash")
        elif name not in gone:
            findings.fault("recording", name, "the journal names this recording; it is missing")
    for name in manifest:
        if name.startswith(f"{CAPTURES}/") and name not in captures:
            findings.fault("recording", name, "the journal does not name this recording")


def _written(folder: Path, manifest: Mapping[str, str], entries: Sequence[Entry], findings: Findings) -> None:
    """Compare results, report, views, exports and wire log with the journal's line that they were written."""
    written = [name for name in manifest if name in _WRITTEN or name.startswith(f"{EXPORTS}/")]
    if not _reported(entries):
        for name in written:
            findings.fault("results", name, "the journal has no report step that wrote this file")
        return
    for name in _WRITTEN:
        if name not in manifest:
            findings.fault("results", name, "the journal's report step wrote this file; it is missing")
    line = next((entry for entry in reversed(entries) if entry.event == Event.WRITTEN), None)
    if line is None:
        what = "it does not hold the hashes of results, report, views and exports"
        findings.fault("journal", JOURNAL, f"{what}, though this version of the program writes them")
        return
    files = line.data.get("files")
    where = f"{JOURNAL}:{line.seq + 1}"
    if not isinstance(files, dict):
        findings.fault("journal", where, "it does not state the files that were written")
        return
    for name, is_missing in _differing(manifest, files):
        what = "is missing" if is_missing else "is another file than the one that was written"
        findings.fault(_WRITTEN.get(name, "exports"), name, f"by the journal, it {what}")
    for name in written:
        if name not in files:
            what = "the journal does not name it among the files that were written"
            findings.fault(_WRITTEN.get(name, "exports"), name, what)
    _wire(folder, line.data.get("wire"), where, findings)


def _reported(entries: Sequence[Entry]) -> bool:
    """Return whether the report step has ended without an error."""
    return any(
        entry.event == Event.LEFT_OFF and entry.data.get("state") == "reporting" and "error" not in entry.data
        for entry in entries
    )


def _wire(folder: Path, stated: Any, where: str, findings: Findings) -> None:
    """Check that no wire log was changed after the results were written. It may only have grown."""
    if not isinstance(stated, dict):
        findings.fault("journal", where, "it does not state the wire log")
        return
    for name, stated_log in stated.items():
        try:
            size, sha256 = int(stated_log["size"]), str(stated_log["sha256"])
        except (KeyError, TypeError, ValueError):
            findings.fault("journal", where, "it does not state the wire log")
            return
        stem, _, number = str(name).partition(".jsonl")
        rotated = (
            f"{stem}.jsonl.{int(number.lstrip('.') or 0) + 1}"
            if number.lstrip(".").isdigit() or not number
            else name
        )
        if sha256 not in {_hash_of_begin(folder / one_name, size) for one_name in (name, rotated)}:
            findings.fault(
                "wire",
                str(name),
                "it does not begin with the bytes that it had when the results were written",
            )


def _hash_of_begin(path: Path, size: int) -> str:
    """Return the SHA-256 of the first bytes of a file; empty if it is shorter or missing."""
    if not path.is_file() or path.stat().st_size < size:
        return ""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        left = size
        while left and (block := file.read(min(left, 1 << 20))):
            digest.update(block)
            left -= len(block)
    return digest.hexdigest()
