"""Makes results again from their sources, and compares the trees: `verify --again` of a sealed folder.

A run: its own writer makes results, views, exports, report and plan again from the recordings; the journal is compared,
too. Recalculated results: they are calibrated again from their sources; where a source has gone, or is another file
now, it says that the numbers were not compared. Nothing is written.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, cast

from bench.base.bounded_json import parse_json
from bench.base.errors import BenchError, RunFolderError, StorageError
from bench.evidence.findings import UNREADABLE, Findings
from bench.measure.measure import Measurement
from bench.measure.verdict import judged
from bench.plan.job import Job
from bench.plan.plan import load_documents, make_plan
from bench.record.events import Event
from bench.record.history import Attempt, History, replay
from bench.record.journal_line import Entry
from bench.record.recovery import WIRE_LOG
from bench.record.results import PreviousData
from bench.record.run_folder import (
    JOURNAL,
    PASSPORT_COPY,
    REPORT,
    RESULTS,
    SEQUENCE_COPY,
    STATION_COPY,
)
from bench.record.storage import read_bounded
from bench.record.stored_run import StoredRun
from bench.solve.causes import kinds_by_earlier_run, kinds_by_run_alone
from bench.solve.compare_numbers import MOST_SHOWN, add_faults, differences, is_excused, tolerance
from bench.solve.compare_trees import (
    MadeAgain,
    compare_instructions,
    compare_plan,
    compare_trees,
)
from bench.solve.measured_again import measure_again
from bench.solve.offline import Reached, nothing_shown
from bench.solve.result import change_since
from bench.solve.results_content import other_engine, other_software, results_content, software
from bench.solve.software import plugins_missing, plugins_of_run, plugins_stated
from bench.solve.solution import main_numbers, solve_run
from bench.stations.devices import simulated_truth
from calib.calibration import Calibration
from calib.errors import CalibrationError
from drivers.errors import DriverError
from sequences.script import RecordStep, SolveStep

_WITH_STAGE = frozenset({"homing", "slewing", "parking"})
"""States in which the program speaks to the stage."""
_SLACK_S = 1e-3
_MOST_LOG_BYTES = 64 << 20
"""Logs are rotated at 8 MB."""


def check_wire_log(folder: Path, entries: Sequence[Entry], job: Job, findings: Findings) -> None:
    """Check that the wire log, about the last 32 MB, holds bytes at each journaled move, and the stage's serials."""
    entries = _logged(entries)
    moves = list(_moves(entries))
    try:
        times, replies, ports = _read_logs(folder)
    except (StorageError, ValueError, LookupError, TypeError) as error:
        findings.fault("wire", WIRE_LOG, f"the wire log cannot be read ({error!r})")
        return
    if moves and not times:
        findings.fault("wire", WIRE_LOG, "it holds no bytes, though the journal tells of moves of the stage")
        return
    for begin_s, end_s, entry in moves:
        if begin_s < times[0]:  # older bytes are not kept
            continue
        at = bisect_left(times, begin_s - _SLACK_S)
        if at == len(times) or times[at] > end_s + _SLACK_S:
            what = f"it holds no bytes of the time in which the journal tells of {entry.data['state']}"
            findings.fault("wire", WIRE_LOG, f"{what} ({JOURNAL}:{entry.seq + 1})")
            return
    station = job.station
    stated = {*station.stage.ports, *station.light.ports}
    if times and not station.needs_simulated_bench and not ports & stated:
        what = f"its ports {sorted(ports)} are not those of the station, {sorted(stated)}"
        findings.fault("wire", WIRE_LOG, what)
    _check_serials(entries, job, replies, findings)


def _logged(entries: Sequence[Entry]) -> list[Entry]:
    """Return the lines of the time in which the wire log was written: in each process until it ended, as journaled."""
    process, processes = 0, []
    ended_s: dict[int, float] = {}
    for entry in entries:
        process += entry.event == Event.RUN_RESUMED
        processes.append(process)
        if entry.event == Event.DEVIATION and "wire_log_ended_s" in entry.data:
            ended_s[process] = float(entry.data["wire_log_ended_s"])
    pairs = zip(entries, processes, strict=True)
    return [entry for entry, process in pairs if entry.mono_s < ended_s.get(process, math.inf)]


def _moves(entries: Sequence[Entry]) -> Iterator[tuple[float, float, Entry]]:
    """Yield begin and end of each move, monotonic time in s, with its line."""
    begun: Entry | None = None
    for entry in entries:
        if entry.event == Event.ENTERING:
            begun = entry if entry.data.get("state") in _WITH_STAGE else None
        elif entry.event == Event.LEFT_OFF and begun is not None:
            if "error" not in entry.data and entry.data.get("state") == begun.data["state"]:
                yield begun.mono_s, entry.mono_s, begun
            begun = None


def _read_logs(folder: Path) -> tuple[list[float], str, set[str]]:
    """Return the sorted times of all bytes, s, all bytes of devices, and the ports. Raises StorageError, ValueError."""
    times: list[float] = []
    replies: list[str] = []
    ports: set[str] = set()
    for path in sorted(folder.glob(f"{WIRE_LOG}*")):
        for line in read_bounded(path, _MOST_LOG_BYTES).splitlines():
            record: dict[str, Any] = parse_json(line.decode("ascii", "replace"))
            times.append(float(record["t"]))
            ports.add(str(record["port"]))
            if record["dir"] == "<":
                replies.append(str(record["bytes"]))
    return sorted(times), "".join(replies), ports


def _check_serials(entries: Sequence[Entry], job: Job, replies: str, findings: Findings) -> None:
    """Compare the serial numbers of stage and light with the replies of devices that speak in text."""
    station = job.station
    in_text = {"stage": station.stage.driver == "zaber_ascii", "light": station.light.driver == "scpi"}
    for entry in entries:
        if entry.event != Event.DEVICES:
            continue
        for part in (part for part, is_text in in_text.items() if is_text):
            identities = entry.data.get(part) or []
            for identity in identities if isinstance(identities, list) else [identities]:
                serial = str(identity.get("serial") or "")
                if serial and serial not in replies:
                    what = (
                        f"no device told the serial number {serial}, which the journal states for the {part}"
                    )
                    findings.fault("wire", WIRE_LOG, f"{what} ({JOURNAL}:{entry.seq + 1})")


@dataclass(frozen=True)
class _Evidence:
    """What a run folder holds, as read for the checks."""

    folder: Path
    entries: Sequence[Entry]
    job: Job
    # History of the run up to the moment when its results were made; of the whole run if it has none.
    history: History
    head: str  # Hash of the journal's line that the report prints; empty if the run has no results

    @property
    def used(self) -> dict[str, Any]:
        """Software of the process that made the results, as the journal states it."""
        begun: dict[str, Any] = {}
        for entry in self.entries:
            if entry.event in {Event.RUN_STARTED, Event.RUN_RESUMED}:
                begun = dict(entry.data.get("software", {}))
            if entry.hash == self.head:
                break
        return begun

    @property
    def solve_step(self) -> SolveStep | None:
        """The solve step whose calibration the results state."""
        done = self.history.done_steps
        return next(
            (s for s in reversed(self.job.steps) if isinstance(s, SolveStep) and s.number in done), None
        )


def check_run_again(folder: Path, progress: Reached = nothing_shown) -> Findings:
    """Make the results of a run again from its recordings, and compare every file with what follows from them.

    ``progress`` is told how many recordings of all have been measured.
    """
    findings = Findings()
    evidence = _read(folder, findings)
    if evidence is None:
        return findings
    started = evidence.history.started
    compare_instructions(folder, started.get("software", {}), findings)
    findings.remarks += [
        f"the {drivers} was driven by a plug-in: {package}"
        for package, drivers in plugins_stated(started).items()
    ]
    _check_first_line(evidence, findings)
    compare_plan(folder, evidence.job.plan.to_dict(), started.get("software", {}), findings)
    _check_steps(evidence, findings)
    check_wire_log(folder, evidence.entries, evidence.job, findings)
    measured = _check_attempts(evidence, findings, progress)
    if not evidence.head:
        findings.remarks.append("this run has no results to calculate again")
        return findings
    if other := other_software(evidence.used):
        findings.remarks.append(f"the results were made with {other}")
    try:
        why = other_engine(StoredRun(folder).results_as_written)
    except RunFolderError as error:
        findings.fault("results", RESULTS, error.what.rstrip("."))
        return findings
    if why:
        findings.could_not_compare(f"{RESULTS}, exports and {REPORT}: {why}", "results", "exports", "report")
    elif (made := _made_again(evidence, measured, findings)) is not None:
        compare_trees(folder, made, findings)
    return findings


def _read(folder: Path, findings: Findings) -> _Evidence | None:
    """Read journal and documents of a run; None if a part cannot be read, which ``findings`` then tells."""
    run = StoredRun(folder)
    entries, whole = run.entries, run.history
    try:
        job = _job(folder, whole)
    except (BenchError, DriverError, CalibrationError, *UNREADABLE) as error:
        used = whole.started.get("software", {})
        if missing := plugins_missing(whole.started):
            findings.could_not_compare(
                f"{RESULTS}, exports and {REPORT}: the station needs {', '.join(missing)}, which this computer does"
                " not have; install it and verify again",
                "results",
                "exports",
                "report",
            )
        elif used.get("program") == software()["program"]:
            findings.fault(
                "plan", STATION_COPY, f"the run cannot be planned again from its documents: {error}"
            )
        else:
            findings.could_not_compare(
                f"{RESULTS}, exports and {REPORT}: this version cannot read the documents of the run ({error})",
                "results",
                "exports",
                "report",
            )
        return None
    if not (folder / RESULTS).is_file():
        return _Evidence(folder, entries, job, whole, "")
    head = _head(entries)
    at = next((number for number, entry in enumerate(entries, start=1) if entry.hash == head), None)
    if at is None:
        findings.fault("report", REPORT, "the report names no line of this journal")
        return None
    return _Evidence(folder, entries, job, replay(entries[:at]), head)


def _job(folder: Path, history: History) -> Job:
    """Plan the run again, as of its day: a passport may have expired since. Raises ScriptError."""
    documents = load_documents(str(folder / SEQUENCE_COPY), str(folder / STATION_COPY))
    day = datetime.fromisoformat(history.started_utc).date()
    planned = make_plan(*documents, passport_copy=folder / PASSPORT_COPY, today=day)
    if planned.faults:
        raise ValueError("; ".join(str(fault) for fault in planned.faults))
    return Job.from_plan(planned, seed=history.started["seed"], operator=history.started["operator"])


def _head(entries: Sequence[Entry]) -> str:
    """Return the hash of the journal's line that the report prints, as the journal states it; empty if it does not."""
    return next(
        (str(entry.data.get("head")) for entry in reversed(entries) if entry.event == Event.WRITTEN), ""
    )


def _check_first_line(evidence: _Evidence, findings: Findings) -> None:
    """Compare what the journal's first line repeats of the documents."""
    job, started = evidence.job, evidence.history.started
    due = {
        "sequence": job.plan.sequence.value.name,
        "station": job.plan.station.value.name,
        "simulated": job.simulated,
        **({"plugins": plugins_of_run(job.station).get("plugins")} if started.get("plugins") else {}),
    }
    for difference in differences({name: started.get(name) for name in due}, due):
        findings.fault("journal", f"{JOURNAL}:1", f"{difference}, by the run's documents")


def _check_steps(evidence: _Evidence, findings: Findings) -> None:
    """Check that the run did every step of its sequence; else it has not finished, or lines were removed."""
    history = replay(evidence.entries)
    recorded = history.accepted()
    for step in evidence.job.steps:
        if step.number not in history.done_steps and not history.is_left_out(step.number):
            findings.fault(
                "journal", JOURNAL, f"it does not tell that step {step.number} of the sequence was done"
            )
            return
        is_left_out = history.is_left_out(step.number)
        if isinstance(step, RecordStep) and not is_left_out and step.pose.index not in recorded:
            taken = history.attempts_at(step.pose.index) or history.lost.get(step.pose.index)
            if not taken and step.pose.index not in history.skipped:
                what = f"it tells of no recording at pose {step.pose.index}, and of no reason"
                findings.fault("journal", JOURNAL, what)


def _check_attempts(evidence: _Evidence, findings: Findings, progress: Reached) -> dict[int, Measurement]:
    """Measure every recording again and compare with the journal; return the measurements of the accepted ones."""
    kept: dict[int, Measurement] = {}
    other = other_software(evidence.history.started.get("software", {}))
    attempts = evidence.history.attempts
    for done, attempt in enumerate(attempts):
        progress(done, len(attempts))
        name = str(attempt.stored["capture"])
        if not (evidence.folder / name).is_file():
            findings.remarks.append(
                f"{name} was lost before the run was resumed, so it was not measured again"
            )
            continue
        again = measure_again(evidence.job, evidence.folder, attempt)
        if attempt.accepted and again.view is not None:
            kept[attempt.pose_index] = again
        if attempt.checked is None:
            continue
        due = _due_verdict(evidence.job, attempt, again)
        had = {name: attempt.checked.get(name) for name in due}
        where = f"pose {attempt.pose_index} attempt {attempt.attempt}"
        excused = other and had["accepted"] == due["accepted"]
        if excused:  # another program may have other words for the reasons
            had, due = ({**content, "reasons": []} for content in (had, due))
        seen = list(differences(had, due, tolerance({}), where))
        if excused:
            seen = [difference for difference in seen if not is_excused(difference, {})]
        for difference in seen[:MOST_SHOWN]:
            findings.fault("journal", JOURNAL, f"the recordings do not give what it states: {difference}")
    progress(len(attempts), len(attempts))
    return kept


def _due_verdict(job: Job, attempt: Attempt, again: Measurement) -> dict[str, Any]:
    """Return what the journal must hold about a recording; of the expected grid, which is not known, what it states."""
    step = job.record_step(attempt.pose_index)
    verdict = judged(job.camera_kind, step, job.frequency_hz(step), attempt.stored, again)
    facts = {name: value for name, value in again.facts.items() if name != "expected_grid"}
    stated = attempt.measured.get("expected_grid")
    return {**verdict, "measured": {**facts, **({"expected_grid": stated} if stated is not None else {})}}


def _made_again(
    evidence: _Evidence, measured: dict[int, Measurement], findings: Findings
) -> MadeAgain | None:
    """Calibrate again, as the run did; None if that fails, which ``findings`` then tells."""
    job, history, step = evidence.job, evidence.history, evidence.solve_step
    if step is None:
        findings.fault("results", RESULTS, "the journal tells of no solve step")
        return None
    try:
        solution = solve_run(job, evidence.folder, step, history, measured)
        results = results_content(
            job, history, solution, simulated_truth(job.station, job.seed), evidence.used
        )
        stored = StoredRun(evidence.folder).results_as_written.get("previous")
        if stored is not None and evidence.history.ledger:
            results["previous"] = cast("PreviousData", _previous_again(stored, results))
    except (BenchError, CalibrationError, DriverError) as error:
        findings.fault("results", RESULTS, f"the run cannot be calibrated again: {error}")
        return None
    except UNREADABLE as error:
        findings.fault("results", RESULTS, f"the results have no calibration to compare ({error!r})")
        return None
    # Some causes rest on earlier runs, whose folders may have gone: as the journal states them.
    again = {
        **main_numbers(solution.calibration),
        **{k: v for k, v in history.solved.items() if k == "causes"},
    }
    _check_solved(evidence, solution.calibration.sigma, again, findings)
    _check_causes(evidence, solution.calibration, findings)
    return MadeAgain(results, solution.views, job.camera_name, job.target, evidence.used, evidence.head)


def _previous_again(stored: Mapping[str, Any], results: Mapping[str, Any]) -> dict[str, Any]:
    """Return the comparison with the earlier run that the results name; its folder may have gone."""
    if stored.get("run") is None:
        return dict(stored)
    return {**stored, "change": change_since(stored["calibration"], results["calibration"])}


def _check_solved(
    evidence: _Evidence, sigma: Mapping[str, float], again: Mapping[str, Any], findings: Findings
) -> None:
    """Compare the main numbers of the calibration in the journal with those that were calculated again."""
    solved = evidence.history.solved
    had, must = (
        {"calibration": {**numbers, "camera": numbers.get("values"), "values": None}}
        for numbers in (solved, again)
    )
    seen = list(differences(had, must, tolerance(sigma)))
    if other_software(evidence.used):
        seen = [difference for difference in seen if not is_excused(difference, sigma)]
    add_faults("journal", JOURNAL, "the recordings do not give what it states: ", seen, findings)


def _check_causes(evidence: _Evidence, calibration: Calibration, findings: Findings) -> None:
    """Check that the journal names what this run shows of people, and nothing else.

    A computer that stood still while the run calculated may be named, and need not.
    """
    if other_software(evidence.used):
        return
    job, history = evidence.job, evidence.history
    lines = evidence.entries[
        : next(at for at, entry in enumerate(evidence.entries) if entry.hash == evidence.head)
    ]
    solving = [
        at
        for at, line in enumerate(lines)
        if line.event == Event.ENTERING and line.data.get("state") == "solving"
    ]
    before = replay(lines[: solving[-1]]) if solving else history
    stated = {cause["kind"] for cause in history.solved.get("causes", ())}
    due, possible = (kinds_by_run_alone(job, until_then, calibration) for until_then in (before, history))
    for kind in sorted(due - stated):
        findings.fault("journal", JOURNAL, f"it does not name what the run shows: {kind}")
    for kind in sorted(stated - possible - kinds_by_earlier_run(job)):
        findings.fault("journal", JOURNAL, f"it names what the run does not show: {kind}")
