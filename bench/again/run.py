"""Makes the results of a run again from its recordings, and compares the folder: `verify --again` of a run.

The writer of runs makes results, views, exports, report and plan again; the journal is compared, too. Nothing is
written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from bench.again.compare import Difference, Limits, Maker, differences, judge
from bench.again.files import MadeAgain, compare_files, compare_plan, maker_of
from bench.base.errors import BenchError, RunFolderError
from bench.evidence.findings import UNREADABLE, Findings
from bench.measure.measure import Measurement
from bench.measure.verdict import judged
from bench.plan.job import Job
from bench.plan.plan import load_documents, make_plan
from bench.record.events import Event
from bench.record.history import Attempt, History, replay
from bench.record.journal_line import Entry
from bench.record.results import PreviousData, Results
from bench.record.run_folder import (
    JOURNAL,
    PASSPORT_COPY,
    REPORT,
    RESULTS,
    SEQUENCE_COPY,
    STATION_COPY,
)
from bench.record.stored_run import StoredRun
from bench.solve.causes import kinds_by_earlier_run, kinds_by_run_alone
from bench.solve.measured_again import measure_again
from bench.solve.offline import Reached, nothing_shown
from bench.solve.result import change_since
from bench.solve.results_content import other_software, results_content
from bench.solve.software import plugins_missing, plugins_of_run, plugins_stated
from bench.solve.solution import main_numbers, solve_run
from bench.stations.devices import simulated_truth
from calib.calibration import Calibration
from calib.errors import CalibrationError
from drivers.camera.raw_header import MAX_HEADER_BYTES, parse_header
from drivers.errors import DriverError
from sequences.script import RecordStep, SolveStep

_NUMBERS = f"{RESULTS}, exports and {REPORT}"


@dataclass(frozen=True)
class _Evidence:
    """What a run folder holds, as read for the checks."""

    folder: Path
    entries: Sequence[Entry]
    job: Job
    # History of the run up to the moment when its results were made; of the whole run if it has none.
    history: History
    head: str  # Hash of the journal's line that the report prints; empty if the run has no results
    results: Mapping[str, Any] = field(default_factory=dict)  # As written; empty if the run has none

    @cached_property
    def maker(self) -> Maker:
        """Who made the results: the engine that they state, and the software of the process by the journal."""
        begun: Mapping[str, Any] = {}
        for entry in self.entries:
            if entry.event in {Event.RUN_STARTED, Event.RUN_RESUMED}:
                begun = entry.data.get("software", {})
            if entry.hash == self.head:
                break
        return maker_of(self.results, begun)

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
    findings.remarks += [
        f"the {drivers} was driven by a plug-in: {package}"
        for package, drivers in plugins_stated(started).items()
    ]
    _check_first_line(evidence, findings)
    compare_plan(folder, evidence.job.plan.to_dict(), started.get("software", {}), findings)
    _check_steps(evidence, findings)
    measured = _check_attempts(evidence, findings, progress)
    if not evidence.head:
        findings.remarks.append("this run has no results to calculate again")
        return findings
    if other := other_software(evidence.maker.software):
        findings.remarks.append(f"the results were made with {other}")
    if (made := _made_again(evidence, measured, findings)) is not None:
        compare_files(folder, made, evidence.maker.software, findings)
    return findings


def _read(folder: Path, findings: Findings) -> _Evidence | None:
    """Read journal and documents of a run; None if a part cannot be read, which ``findings`` then tells."""
    run = StoredRun(folder)
    entries, whole = run.entries, run.history
    try:
        job = _job(folder, whole)
    except (BenchError, DriverError, CalibrationError, *UNREADABLE) as error:
        if missing := plugins_missing(whole.started):
            why = f"the station needs {', '.join(missing)}, which this computer does not have"
            findings.not_compared.append(f"{_NUMBERS}: {why}; install it and verify again")
        elif Maker(whole.started.get("software", {})).is_same_program:
            what = f"the run cannot be planned again from its documents: {error}"
            findings.fault("plan", STATION_COPY, what)
        else:
            why = f"this version cannot read the documents of the run ({error})"
            findings.not_compared.append(f"{_NUMBERS}: {why}")
        return None
    if not run.has_results:
        return _Evidence(folder, entries, job, whole, "")
    head = _head(entries)
    at = next((number for number, entry in enumerate(entries, start=1) if entry.hash == head), None)
    if at is None:
        findings.fault("report", REPORT, "the report names no line of this journal")
        return None
    try:
        results = run.results_as_written
    except RunFolderError as error:
        findings.fault("results", RESULTS, error.what.rstrip("."))
        return None
    return _Evidence(folder, entries, job, replay(entries[:at]), head, results)


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
    attempts = evidence.history.attempts
    seen: list[Difference] = []
    for done, attempt in enumerate(attempts):
        progress(done, len(attempts))
        path = evidence.folder / str(attempt.stored["capture"])
        if not path.is_file():
            findings.remarks.append(
                f"{attempt.stored['capture']} was lost before the run was resumed, so it was not measured again"
            )
            continue
        _check_camera(path, attempt, findings)
        again = measure_again(evidence.job, evidence.folder, attempt)
        if attempt.accepted and again.view is not None:
            kept[attempt.pose_index] = again
        if attempt.checked is None:
            continue
        due = _due_verdict(evidence.job, attempt, again)
        had = {name: attempt.checked.get(name) for name in due}
        where = f"pose {attempt.pose_index} attempt {attempt.attempt}"
        seen += differences(had, due, where=where)
    judge("journal", JOURNAL, seen, evidence.maker, findings)
    progress(len(attempts), len(attempts))
    return kept


def _check_camera(path: Path, attempt: Attempt, findings: Findings) -> None:
    """Compare the camera that the head of a RAW file names with the one that the journal states."""
    try:
        with path.open("rb") as file:
            head = parse_header(file.read(MAX_HEADER_BYTES), where=path.name)
    except DriverError:
        return  # no RAW file, or a damaged one, which cannot be measured
    facts = attempt.stored.get("facts", {})
    of_file = {"serial": head.fields.get("serial_number"), "width": head.width, "height": head.height}
    for name, value in of_file.items():
        if value and name in facts and facts[name] != value:  # type: ignore[literal-required]
            what = f"its head names the {name} {value}; the journal states {facts[name]}"  # type: ignore[literal-required]
            findings.fault("recording", str(attempt.stored["capture"]), what)


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
    used = evidence.maker.software
    try:
        solution = solve_run(job, evidence.folder, step, history, measured)
        truth = simulated_truth(job.station, job.seed)
        results = results_content(job, history, solution, truth, used)
        stored = evidence.results.get("previous")
        if stored is not None and history.ledger:
            results["previous"] = _previous_again(stored, results)
    except (BenchError, CalibrationError, DriverError) as error:
        findings.fault("results", RESULTS, f"the run cannot be calibrated again: {error}")
        return None
    except UNREADABLE as error:
        findings.fault("results", RESULTS, f"the results have no calibration to compare ({error!r})")
        return None
    _check_solved(evidence, solution.calibration, results["calibration"], findings)
    return MadeAgain(results, solution.views, job.camera_name, job.target, evidence.head)


def _previous_again(stored: PreviousData, results: Results) -> PreviousData:
    """Return the comparison with the earlier run that the results name; its folder may have gone."""
    if stored.get("run") is None:
        return stored
    return {**stored, "change": change_since(stored["calibration"], results["calibration"])}


def _check_solved(
    evidence: _Evidence, calibration: Calibration, limits: Mapping[str, Any], findings: Findings
) -> None:
    """Compare the main numbers of the calibration in the journal, and the kinds of causes, with those made again.

    Causes that rest on an earlier run, and a computer that stood still while the run calculated, need not be named.
    """
    solved = evidence.history.solved
    had, made = (
        {"calibration": {**numbers, "camera": numbers.get("values"), "values": None, "causes": None}}
        for numbers in (solved, main_numbers(calibration))
    )
    seen = list(differences(had, made, Limits(limits)))
    stated = {cause["kind"] for cause in solved.get("causes", ())}
    due = _kinds_before_solving(evidence, calibration)
    job = evidence.job
    possible = kinds_by_run_alone(job, evidence.history, calibration) | kinds_by_earlier_run(job)
    seen += [Difference(f"causes: {kind}", "missing", None, kind) for kind in sorted(due - stated)]
    seen += [Difference(f"causes: {kind}", "added", kind, None) for kind in sorted(stated - possible)]
    judge("journal", JOURNAL, seen, evidence.maker, findings)


def _kinds_before_solving(evidence: _Evidence, calibration: Calibration) -> set[str]:
    at_head = next(at for at, entry in enumerate(evidence.entries) if entry.hash == evidence.head)
    lines = evidence.entries[:at_head]
    solving = [
        at
        for at, line in enumerate(lines)
        if line.event == Event.ENTERING and line.data.get("state") == "solving"
    ]
    before = replay(lines[: solving[-1]]) if solving else evidence.history
    return kinds_by_run_alone(evidence.job, before, calibration)
