"""Makes the results of a run again from its recordings, and compares the folder: `verify --again` of a run.

The writer of runs makes results, views, exports, report and plan again; the journal is compared, too. Nothing is
written.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.again.compare import Difference, Maker, differences, judge
from bench.again.files import MadeAgain, compare_files, compare_plan, maker_of
from bench.again.limits import OF_RECORDING
from bench.base.bounded_json import canonical_json, parse_json
from bench.base.errors import BenchError
from bench.evidence.findings import UNREADABLE, Findings
from bench.measure.measure import Measurement
from bench.measure.verdict import judged
from bench.plan.job import Job
from bench.plan.plan import load_documents, make_plan
from bench.record.events import Event
from bench.record.history import Attempt, History, replay
from bench.record.run_folder import JOURNAL, PASSPORT_COPY, REPORT, RESULTS, SEQUENCE_COPY, STATION_COPY
from bench.record.stored_run import StoredRun
from bench.solve.causes import causes_of_run
from bench.solve.measured_again import measure_again
from bench.solve.offline import Reached, nothing_shown
from bench.solve.result import change_since
from bench.solve.results_content import causes_without_earlier_run, other_software, results_content
from bench.solve.software import plugins_missing, plugins_stated
from bench.solve.solution import solve_run
from bench.stations.devices import simulated_truth
from calib.calibration import Calibration
from calib.errors import CalibrationError
from drivers.camera.raw_header import MAX_HEADER_BYTES, parse_header
from drivers.errors import DriverError
from sequences.script import RecordStep, SolveStep

_NUMBERS = f"{RESULTS}, exports and {REPORT}"


@dataclass(frozen=True)
class _Evidence:
    """What a run folder states of the making of its results."""

    run: StoredRun
    job: Job
    # History of the run up to the moment when its results were made; of the whole run if it has none.
    history: History
    head: str  # Hash of the journal's line that the report prints; empty if the run has no results
    maker: Maker  # By the engine that the results state, and the software that the journal states


def check_run_again(folder: Path, progress: Reached = nothing_shown) -> Findings:
    """Make the results of a run again from its recordings, and compare every file with what follows from them.

    ``progress`` is told how many recordings of all have been measured.
    """
    findings, run = Findings(), StoredRun(folder)
    if (job := _planned_again(run, findings)) is None:
        return findings
    started = run.history.started
    findings.remarks += [
        f"the {drivers} was driven by a plug-in: {package}"
        for package, drivers in plugins_stated(started).items()
    ]
    plan = job.plan
    due = {
        "sequence": plan.sequence.value.name,
        "station": plan.station.value.name,
        "simulated": job.simulated,
    }
    for difference in differences({name: started.get(name) for name in due}, due):
        findings.fault("journal", f"{JOURNAL}:1", f"{difference}, by the run's documents")
    compare_plan(folder, plan.to_dict(), started.get("software", {}), findings)
    _check_steps(job, run.history, findings)
    if (evidence := _read(run, job, findings)) is None:
        return findings
    measured = _check_attempts(evidence, findings, progress)
    if not evidence.head:
        findings.remarks.append("this run has no results to calculate again")
        return findings
    if other := other_software(evidence.maker.software):
        findings.remarks.append(f"the results were made with {other}")
    with findings.unreadable("results", RESULTS, "the run cannot be calibrated again"):
        compare_files(folder, _made_again(evidence, measured, findings), evidence.maker, findings)
    return findings


def _planned_again(run: StoredRun, findings: Findings) -> Job | None:
    """Plan a run again from its documents; None if they cannot be read, which ``findings`` then tells."""
    started = run.history.started
    try:
        return _job(run.folder, run.history)
    except (BenchError, DriverError, CalibrationError, *UNREADABLE) as error:
        if missing := plugins_missing(started):
            why = f"the station needs {', '.join(missing)}, which this computer does not have"
            findings.not_compared.append(f"{_NUMBERS}: {why}; install it and verify again")
        elif Maker(started.get("software", {})).is_same_program:
            what = f"the run cannot be planned again from its documents: {error}"
            findings.fault("plan", STATION_COPY, what)
        else:
            why = f"this version cannot read the documents of the run ({error})"
            findings.not_compared.append(f"{_NUMBERS}: {why}")
        return None


def _read(run: StoredRun, job: Job, findings: Findings) -> _Evidence | None:
    """Read the journal up to the making of the results; None, and a fault, if it does not tell of that."""
    entries = list(run.entries)
    head = next((str(e.data.get("head")) for e in reversed(entries) if e.event == Event.WRITTEN), "")
    made_at = [number for number, entry in enumerate(entries, start=1) if entry.hash == head]
    if head and not made_at:
        findings.fault("report", REPORT, "the report names no line of this journal")
        return None
    until = entries[: made_at[0]] if made_at else entries
    begun = [entry for entry in until if entry.event in {Event.RUN_STARTED, Event.RUN_RESUMED}]
    used = begun[-1].data.get("software", {})
    maker = maker_of(run.results_as_written, used) if head else Maker(used)
    return _Evidence(run, job, replay(until), head, maker)


def _job(folder: Path, history: History) -> Job:
    """Plan the run again, as of its day: a passport may have expired since. Raises ScriptError."""
    documents = load_documents(str(folder / SEQUENCE_COPY), str(folder / STATION_COPY))
    day = datetime.fromisoformat(history.started_utc).date()
    planned = make_plan(*documents, passport_copy=folder / PASSPORT_COPY, today=day)
    if planned.faults:
        raise ValueError("; ".join(str(fault) for fault in planned.faults))
    return Job.from_plan(planned, seed=history.started["seed"], operator=history.started["operator"])


def _check_steps(job: Job, history: History, findings: Findings) -> None:
    """Check that the run did every step of its sequence; else it has not finished, or lines were removed."""
    recorded = history.accepted()
    for step in job.steps:
        if history.is_left_out(step.number):
            continue
        if step.number not in history.done_steps:
            what = f"it does not tell that step {step.number} of the sequence was done"
            findings.fault("journal", JOURNAL, what)
            return
        if isinstance(step, RecordStep) and step.pose.index not in {*recorded, *history.skipped}:
            taken = history.attempts_at(step.pose.index) or history.lost.get(step.pose.index)
            if not taken:
                what = f"it tells of no recording at pose {step.pose.index}, and of no reason"
                findings.fault("journal", JOURNAL, what)


def _check_attempts(evidence: _Evidence, findings: Findings, progress: Reached) -> dict[int, Measurement]:
    """Measure every recording again and compare with the journal; return the measurements of the accepted ones."""
    kept: dict[int, Measurement] = {}
    attempts = evidence.history.attempts
    seen: list[Difference] = []
    for done, attempt in enumerate(attempts):
        progress(done, len(attempts))
        path = evidence.run.folder / str(attempt.stored["capture"])
        if not path.is_file():
            findings.remarks.append(
                f"{attempt.stored['capture']} was lost before the run was resumed, so it was not measured again"
            )
            continue
        _check_camera(path, attempt, findings)
        again = measure_again(evidence.job, evidence.run.folder, attempt)
        if attempt.accepted and again.view is not None:
            kept[attempt.pose_index] = again
        if attempt.checked is None:
            continue
        due = _due_verdict(evidence.job, attempt, again)
        had = {name: attempt.checked.get(name) for name in due}
        where = f"pose {attempt.pose_index} attempt {attempt.attempt}"
        seen += differences(had, due, OF_RECORDING, where=where)
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
    step = job.record_steps[attempt.pose_index]
    verdict = judged(job.camera_kind, step, job.frequency_hz(step), attempt.stored, again)
    facts = {name: value for name, value in again.facts.items() if name != "expected_grid"}
    stated = attempt.measured.get("expected_grid")
    return {**verdict, "measured": {**facts, **({"expected_grid": stated} if stated is not None else {})}}


def _made_again(evidence: _Evidence, measured: dict[int, Measurement], findings: Findings) -> MadeAgain:
    """Calibrate again, as the run did."""
    job, history, run = evidence.job, evidence.history, evidence.run
    done = [s for s in job.steps if isinstance(s, SolveStep) and s.number in history.done_steps]
    if not done:
        raise ValueError("the journal tells of no solve step")
    solution = solve_run(job, run.folder, done[-1], history, measured)
    truth = simulated_truth(job.station, job.seed)
    results = results_content(job, history, solution, truth, evidence.maker.software)
    stored = run.results_as_written.get("previous")
    if stored is not None and history.ledger:
        results["previous"] = _previous_again(stored, results)
    _check_causes(evidence, solution.calibration, findings)
    content = parse_json(canonical_json(results))
    return MadeAgain(content, solution.views, job.camera_name, job.target, evidence.head)


def _previous_again(stored: Mapping[str, Any], results: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the comparison with the earlier run that the results name; its folder may have gone."""
    if stored.get("run") is None:
        return stored
    return {**stored, "change": change_since(stored["calibration"], results["calibration"])}


def _check_causes(evidence: _Evidence, calibration: Calibration, findings: Findings) -> None:
    """Compare the kinds of causes that the journal tells with those that the calibration shows, and that there can be.

    Causes that rest on an earlier run, or on a computer that stood still, need not be told again.
    """
    stated = {cause["kind"] for cause in causes_without_earlier_run(evidence.history.solved)}
    due = {cause.kind for cause in calibration.causes}
    possible = {cause.kind for cause in causes_of_run(evidence.job, evidence.history, calibration)}
    seen = [Difference(f"causes: {kind}", "missing", None, kind) for kind in sorted(due - stated)]
    seen += [Difference(f"causes: {kind}", "added", kind, None) for kind in sorted(stated - possible)]
    judge("journal", JOURNAL, seen, evidence.maker, findings)
