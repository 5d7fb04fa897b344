"""Rehearse runs: the same steps, states and journal as a run, on a virtual clock and with virtual devices.

It leaves out what would be evidence: events, ledger, seal, messages, report; its results are the calibration alone.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.base.bounded_json import canonical_json
from bench.base.clock import BenchClock
from bench.base.progress import Progress
from bench.batch.virtual_devices import VirtualDevices, read_view
from bench.measure.camera_kinds import CameraKind, EventKind
from bench.measure.measure import ExpectedGrid, Measurement
from bench.plan.job import Job, documents_of
from bench.plan.plan import CHECK_S, CHOOSE_S, PREFLIGHT_S, REPORT_S, SOLVE_S, Plan, load_documents, make_plan
from bench.record.events import Event, Solved, UntilDecided
from bench.record.history import History, replay
from bench.record.journal import Journal
from bench.record.measured_facts import MeasuredFacts
from bench.record.run_folder import JOURNAL, RESULTS, RunFolder
from bench.record.run_log import RunLog
from bench.record.stored_run import results_of
from bench.record.unsynced_journal import UnsyncedJournal
from bench.run.runner import RunEnd, Runner
from bench.solve.interim import decide_until
from bench.solve.result import Outcome, ResultWriter
from bench.solve.software import plugins_of_run, run_software
from bench.solve.solution import accepted_measurements, compare_with_truth, main_numbers, views_in
from bench.solve.solve_options import solve_options
from bench.stations.devices import Devices
from calib.engine import Calibration, calibrate
from calib.errors import CalibrationError
from calib.target import StarTarget
from sequences.script import RecordStep, SolveStep

SCHEMA = "starbench/rehearsal/1"
FAULTLESS: MeasuredFacts = {
    "flicker_source": "triggers",
    "trigger_jitter_us": 0.0,
    "flicker_disagreement_percent": 0.0,
    "motion_px": 0.0,
    "image": {"silent_rows": 0, "hot_pixels": 0},
}
"""Numbers of each rehearsed recording: in a virtual room nothing shakes, one light flickers, and no pixel is dead."""
COUNTED = {"triggers_missed", "flicker_off_percent", "data_rate_gbit_s", "rate_controller_loss_percent"}
"""Numbers that other gates find in what the virtual light and camera state."""


class RehearsedKind(EventKind):
    """A camera whose recordings hold stars instead of events; it replaces event and frame cameras alike."""

    def __init__(self, clock: BenchClock) -> None:
        super().__init__({})
        self._clock = clock

    def measure(
        self,
        path: Path,
        step: RecordStep,
        frequency_hz: float,
        target: StarTarget,
        expected_grid: ExpectedGrid | None,  # noqa: ARG002 - the file states the stars' ids
        *,
        motion: bool = True,  # noqa: ARG002
    ) -> Measurement:
        """See `EventKind.measure`. Reads the stars of a rehearsed recording."""
        self._clock.sleep(CHECK_S)
        try:
            view, edges = read_view(path, step.pose.name, target)
        except (OSError, ValueError, KeyError, CalibrationError) as error:
            return Measurement(None, None, {}, f"this is not a rehearsed recording: {error}")
        facts: MeasuredFacts = {
            **FAULTLESS,
            "flicker_hz": frequency_hz,
            "triggers_found": edges,
            "triggers_expected": edges,
        }
        return Measurement(view, None, facts)


@dataclass(frozen=True)
class RehearsedJob(Job):
    """Task of a rehearsed run."""

    clock: BenchClock

    @property
    def simulated(self) -> bool:
        """True, because nothing is measured."""
        return True

    @property
    def camera_kind(self) -> CameraKind:
        """One kind for all cameras."""
        return RehearsedKind(self.clock)


class RehearsedResults(ResultWriter):
    """Calculates the calibration of a rehearsed run and writes it; no comparison and no report."""

    def __init__(self, job: RehearsedJob, folder: RunFolder) -> None:
        super().__init__(job, folder)
        self._clock = job.clock
        self._calibration: Calibration  # `solve` sets it: each plan solves before it reports

    def solve(
        self,
        step: SolveStep,
        history: History,
        measured: MutableMapping[int, Measurement],
        check: Callable[[], None],
    ) -> Solved:
        """See `ResultWriter.solve`. Without checks."""
        check()
        self._clock.sleep(SOLVE_S)
        measurements, readings = accepted_measurements(self._job, self._folder.path, history, measured)
        options = solve_options(self._job, step, readings)
        self._calibration = calibrate(views_in(measurements), options)
        return main_numbers(self._calibration)

    def write(self, log: RunLog, truth: Mapping[str, Any] | None) -> None:
        """Write results.json, which states that it is from a rehearsal."""
        self._clock.sleep(REPORT_S)
        content: dict[str, Any] = {
            "schema": SCHEMA,
            "rehearsal": True,
            "run": {"id": log.history.started["id"], "started_utc": log.history.started_utc},
            "calibration": self._calibration.to_dict(),
            "comparison": compare_with_truth(self._calibration, truth) if truth is not None else [],
        }
        if log.history.decisions:
            content["untils"] = list(log.history.decisions)
        content["deviations"] = list(log.history.deviations)
        data = canonical_json(content)
        path = self._folder.write_atomic(RESULTS, data)
        self.outcome = Outcome(results_of(data, path), path)


def rehearse_run(
    sequence: str,
    station: str,
    *,
    seed: int,
    operator: str | None,
    folder: Path,
    clock: BenchClock,
    settings: Mapping[str, str] | None = None,
) -> RunEnd:
    """Rehearse a run in a new folder, or continue a rehearsed run that did not finish in its own."""
    planned = _without_room_interlocks(make_plan(*load_documents(sequence, station, settings)))
    task = Job.from_plan(planned, seed=seed, operator=operator)
    job = RehearsedJob(task.plan, task.steps, task.seed, task.operator, clock)

    def open_devices() -> Devices:
        clock.sleep(PREFLIGHT_S)
        return VirtualDevices(job.station, seed=seed, clock=clock)

    return rehearse_job(job, folder, open_devices)


def _without_room_interlocks(planned: Plan) -> Plan:
    """Remove the interlocks that check the real room and this computer's disk."""
    value = planned.station.value
    interlocks = value.interlocks.model_copy(update={"door": None, "disk_space": None})
    station = replace(planned.station, value=value.model_copy(update={"interlocks": interlocks}))
    return replace(planned, station=station)


def rehearse_job(
    job: RehearsedJob,
    folder: Path,
    open_devices: Callable[[], Devices],
    journal_type: type[Journal] = UnsyncedJournal,
) -> RunEnd:
    """Rehearse a task on given devices as `rehearse_run`; the kind ``Journal`` stores it as durably as a real run."""
    clock = job.clock
    begun = (folder / JOURNAL).exists()
    with RunFolder.open(folder) if begun else RunFolder.create(folder) as held:
        if not begun:
            for name, text in documents_of(job.plan).items():
                held.write_atomic(name, text)
        opened = journal_type.open if begun else journal_type.create
        with opened(held.journal_path, clock) as journal:
            if begun and replay(journal.entries).ended == "finished":
                return RunEnd("finished", "", held.path, None)
            _journal_begin(journal, job, held, again=begun)
            progress = Progress(job.plan.duration_s, stream=io.StringIO())

            def decide(*given: Any) -> UntilDecided:
                clock.sleep(CHOOSE_S)
                return decide_until(job, held.path, *given)

            results = RehearsedResults(job, held)
            runner = Runner(job, held, journal, open_devices, clock, progress, results=results, decide=decide)
            return runner.run()


def _journal_begin(journal: Journal, job: RehearsedJob, folder: RunFolder, *, again: bool) -> None:
    if again:
        journal.append(
            Event.RUN_RESUMED,
            torn_bytes=len(journal.torn),
            software=run_software(job.station),
            rehearsal=True,
        )
        return
    plan = job.plan
    journal.append(
        Event.RUN_STARTED,
        id=folder.path.name,
        rehearsal=True,
        sequence=plan.sequence.value.name,
        station=plan.station.value.name,
        sha256={name: hashlib.sha256(text).hexdigest() for name, text in documents_of(plan).items()},
        seed=job.seed,
        operator=job.operator,
        simulated=True,
        software=run_software(job.station),
        **plugins_of_run(job.station),
    )
    _name_gates_without_numbers(journal, job)


def _name_gates_without_numbers(journal: Journal, job: RehearsedJob) -> None:
    numbers = {*FAULTLESS, *FAULTLESS["image"], *COUNTED}
    gates = {name for step in job.steps if isinstance(step, RecordStep) for name in step.gates.limits}
    for name in sorted(gate for gate in gates if gate.split("_", 1)[1] not in numbers):
        what = f"The gate {name} was not judged: a rehearsal has no number for it."
        journal.append(Event.DEVIATION, what=what)
