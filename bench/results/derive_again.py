"""Derives the files of a sealed run again from each other, and compares them; nothing is calibrated here.

`check_run` starts from the journal and the documents of the run. What follows from them is compared with plan.json and
results.json; what follows from results.json and views.h5 is compared with exports and report. So a change that was
sealed again, even with the bench's own key, contradicts another file. `bench.results.reproduce` starts from the
recordings instead. Both read only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError, StorageError
from bench.evidence.findings import Findings
from bench.plan.job import Job
from bench.plan.plan import load_documents, make_plan
from bench.records.events import Event
from bench.records.history import History, replay
from bench.records.journal import read_journal
from bench.records.journal_entry import Entry
from bench.records.reading import read_json
from bench.records.run_folder import (
    JOURNAL,
    PASSPORT_COPY,
    PLAN,
    REPORT,
    RESULTS,
    SEQUENCE_COPY,
    STATION_COPY,
)
from bench.results.compare_json import Difference, differences, within
from bench.results.derive_calculated import check_calculated
from bench.results.derive_devices import check_recorded_with, check_wire_log
from bench.results.derive_instructions import check_instructions
from bench.results.derive_report import EXPORTS, UNREADABLE, check_exports, check_report
from bench.results.derive_views import check_views
from bench.results.other_software import other_program
from bench.results.results_content import journal_content, software
from bench.results.solve_options import limited_numbers
from bench.results.station_software import plugins_missing, plugins_of_run, plugins_stated
from bench.results.stored_calibration import stored_calibration
from bench.views.gates import solution_gates
from calib.calibration import Calibration
from calib.errors import CalibrationError
from drivers.errors import DriverError
from sequences.script import RecordStep, SolveStep

_MOST_SHOWN = 12
"""Differences of one file that are shown one by one."""
_SAME = within(1e-9)


@dataclass(frozen=True)
class RunEvidence:
    """What a run folder holds, as read for the checks."""

    folder: Path
    entries: Sequence[Entry]
    job: Job
    # History of the run up to the moment when its results were made; of the whole run if it has none.
    history: History
    results: Mapping[str, Any] | None  # Content of results.json; None if the run has no report step
    head: str  # Hash of the journal's line that the report prints; empty if the run has none

    @property
    def solve_step(self) -> SolveStep | None:
        """The solve step whose calibration the results state."""
        done = self.history.done_steps
        return next(
            (s for s in reversed(self.job.steps) if isinstance(s, SolveStep) and s.number in done), None
        )


def check_run(folder: Path) -> Findings:
    """Compare the files of a run with what follows from its journal, its documents and each other.

    folder: The run folder; seal and journal have no fault.
    Returns: What contradicts, what was not compared, and which software made the results.
    Raises OSError: When a file cannot be read.
    """
    found = Findings()
    evidence = read_evidence(folder, found)
    if evidence is None:
        return found
    check_instructions(folder, evidence.history.started.get("software", {}), found)
    found.remarks += [
        f"the {drivers} was driven by a plug-in: {package}"
        for package, drivers in plugins_stated(evidence.history.started).items()
    ]
    _check_first_line(evidence, found)
    _check_plan(evidence, found)
    _check_steps(evidence, found)
    check_wire_log(folder, evidence.entries, evidence.job, found)
    check_recorded_with(folder, evidence.history, found)
    if evidence.results is not None:
        try:
            _check_results(evidence, evidence.results, found)
        except UNREADABLE as error:
            found.fault("results", RESULTS, f"the results are incomplete ({error!r})")
    return found


def read_evidence(folder: Path, found: Findings) -> RunEvidence | None:
    """Read journal, documents and results of a run.

    found: Findings; faults are added.
    Returns: None if a part cannot be read; the fault is then in ``found``.
    """
    entries, _ = read_journal(folder / JOURNAL)
    whole = replay(entries)
    try:
        job = _job(folder, whole)
    except (BenchError, DriverError, CalibrationError, *UNREADABLE) as error:
        used = whole.started.get("software", {})
        if missing := plugins_missing(whole.started):
            found.not_compared.append(
                f"{RESULTS}, exports and {REPORT}: the station needs {', '.join(missing)}, which this computer does"
                " not have; install it and verify again"
            )
        elif used.get("program") == software()["program"]:
            found.fault("plan", STATION_COPY, f"the run cannot be planned again from its documents: {error}")
        else:
            found.not_compared.append(
                f"{RESULTS}, exports and {REPORT}: this version cannot read the documents of the run ({error})"
            )
        return None
    if not (folder / RESULTS).is_file():
        return RunEvidence(folder, entries, job, whole, None, "")
    try:
        results = read_json(folder / RESULTS)
    except (StorageError, ValueError) as error:
        found.fault("results", RESULTS, f"the file cannot be read ({error})")
        return None
    head = _head(folder, entries)
    at = next((number for number, entry in enumerate(entries, start=1) if entry.hash == head), None)
    if at is None:
        found.fault("report", REPORT, "the report names no line of this journal")
        return None
    return RunEvidence(folder, entries, job, replay(entries[:at]), results, head)


def _job(folder: Path, history: History) -> Job:
    """Plan the run again, as of its day: a passport may have expired since. Raises ScriptError."""
    documents = load_documents(str(folder / SEQUENCE_COPY), str(folder / STATION_COPY))
    day = datetime.fromisoformat(history.started_utc).date()
    planned = make_plan(*documents, passport_copy=folder / PASSPORT_COPY, today=day)
    if planned.faults:
        raise ValueError("; ".join(str(fault) for fault in planned.faults))
    return Job.from_plan(planned, seed=history.started["seed"], operator=history.started["operator"])


def _head(folder: Path, entries: Sequence[Entry]) -> str:
    """Return the hash of the journal's line that the report prints; runs of earlier versions state it there alone."""
    written = [str(entry.data.get("head")) for entry in entries if entry.event == Event.WRITTEN]
    if written:
        return written[-1]
    report = (folder / REPORT).read_text(encoding="utf-8", errors="replace")
    return next((entry.hash for entry in entries if entry.hash in report), "")


def _check_first_line(evidence: RunEvidence, found: Findings) -> None:
    """Compare what the journal's first line repeats of the documents."""
    job, started = evidence.job, evidence.history.started
    plan = job.plan
    due = {
        "sequence": plan.sequence.value.name,
        "station": plan.station.value.name,
        "simulated": job.simulated,
        **({"plugins": plugins_of_run(job.station).get("plugins")} if started.get("plugins") else {}),
    }
    for one in differences({name: started.get(name) for name in due}, due):
        found.fault("journal", f"{JOURNAL}:1", f"{one}, by the run's documents")


def _check_plan(evidence: RunEvidence, found: Findings) -> None:
    """Compare plan.json with the plan of the run's documents, except the names of files."""
    try:
        stored = read_json(evidence.folder / PLAN)
        plans = [_without_names(plan) for plan in (stored, evidence.job.plan.to_dict())]
        seen = list(differences(plans[0], plans[1], _SAME))
    except (StorageError, *UNREADABLE) as error:
        found.fault("plan", PLAN, f"the file cannot be read ({error!r})")
        return
    add_differences(
        "plan", PLAN, seen, found, other=other_program(dict(evidence.history.started.get("software", {})))
    )


def _without_names(plan: Mapping[str, Any]) -> dict[str, Any]:
    """Remove the name of the file from each remark: the copies in the folder have other names."""
    return {**plan, "remarks": [{**remark, "file": ""} for remark in plan["remarks"]]}


def _check_steps(evidence: RunEvidence, found: Findings) -> None:
    """Check that the run did every step of its sequence; else it has not finished, or lines were removed."""
    history = replay(evidence.entries)
    recorded = history.accepted()
    for step in evidence.job.steps:
        if step.number not in history.done_steps and not history.is_left_out(step.number):
            found.fault(
                "journal", JOURNAL, f"it does not tell that step {step.number} of the sequence was done"
            )
            return
        is_left_out = history.is_left_out(step.number)
        if isinstance(step, RecordStep) and not is_left_out and step.pose.index not in recorded:
            told = history.attempts_at(step.pose.index) or history.lost.get(step.pose.index)
            if not told and step.pose.index not in history.skipped:
                what = f"it tells of no recording at pose {step.pose.index}, and of no reason"
                found.fault("journal", JOURNAL, what)


def _check_results(evidence: RunEvidence, results: Mapping[str, Any], found: Findings) -> None:
    folder, job = evidence.folder, evidence.job
    _check_software(evidence, results, found)
    calibration = stored_calibration(results["calibration"])
    step = evidence.solve_step
    if step is None:
        found.fault("results", RESULTS, "the journal tells of no solve step")
        return
    judged = [gate.as_data() for gate in solution_gates(step.limits, limited_numbers(calibration))]
    _check_journal_content(evidence, results, calibration, len(judged), found)
    held = check_views(folder, results, found, all_stars=step.guard_band >= 1)
    if held is None:
        return
    views = [stored.view for stored in held.views]
    check_calculated(evidence.history, job, step, results, calibration, views, judged, found)
    names = sorted(path.name for path in (folder / EXPORTS).glob("*"))
    check_exports(folder, names, results, calibration, job.camera_name, job.board or job.target, found)
    check_report(folder, results, held.shown(results), evidence.head, found)


def _check_software(evidence: RunEvidence, results: Mapping[str, Any], found: Findings) -> None:
    """Compare the software of the results with that of the process that made them, as the journal states it."""
    begun: dict[str, Any] = {}
    for entry in evidence.entries:
        if entry.event in {Event.RUN_STARTED, Event.RUN_RESUMED}:
            begun = dict(entry.data.get("software", {}))
        if entry.hash == evidence.head:
            break
    used = results["run"]["software"]
    add_differences("results", RESULTS, list(differences(used, begun, where="run.software")), found)
    if other := other_program(used):
        found.remarks.append(f"the results were made with {other}")


def _check_journal_content(
    evidence: RunEvidence,
    results: Mapping[str, Any],
    calibration: Calibration,
    judged: int,
    found: Findings,
) -> None:
    """Compare what results.json repeats of journal, station and sequence; its first ``judged`` gates are calculated."""
    due = journal_content(evidence.job, evidence.history, calibration.views)
    had = {name: results.get(name) for name in due}
    had["run"] = {name: value for name, value in results["run"].items() if name != "software"}
    had["gates"] = results["gates"][judged:]
    seen = list(differences(had, due))
    add_differences("results", RESULTS, seen, found, other=other_program(results["run"]["software"]))
    solved = evidence.history.solved
    stated = {
        "model": calibration.model,
        "converged": calibration.converged,
        "rms_px": calibration.rms_px,
        "values": dict(zip(calibration.parameter_names, calibration.values.tolist(), strict=True)),
        "sigma": results["calibration"]["sigma"],
        **({"coverage_factor": calibration.coverage_factor} if "coverage_factor" in solved else {}),
    }
    add_differences("results", RESULTS, list(differences(stated, solved, where="calibration")), found)


def add_differences(
    kind: str, name: str, seen: Sequence[Difference], found: Findings, *, other: str = ""
) -> None:
    """Add differences of a file to the findings.

    found: Findings; they are added.
    other: How the program that made the file differs from this one. Another program may state more or less;
      what only one of them states is then not compared. A value that both state must be the same.
    """
    faults = [one for one in seen if one.kind == "value" or not other]
    for one in faults[:_MOST_SHOWN]:
        found.fault(kind, name, str(one))
    if len(faults) > _MOST_SHOWN:
        found.fault(kind, name, f"{len(faults) - _MOST_SHOWN} further values differ")
    unknown = [one.where for one in seen if one.kind != "value" and other]
    if unknown:
        found.not_compared.append(f"{', '.join(unknown[:_MOST_SHOWN])} of {name}: another program wrote it")


def check_results_folder(folder: Path) -> Findings:
    """Compare the files of a folder of recalculated results.

    folder: The folder; its seal has no fault.
    Returns: What contradicts, and what was not compared.
    """
    from bench.results.derive_offline import check_offline

    found = Findings()
    try:
        check_offline(folder, found)
    except UNREADABLE as error:
        found.fault("results", RESULTS, f"the results are incomplete ({error!r})")
    return found
