"""Plan of a batch: checks the queue with all its files, and predicts when each run begins and ends. Writes nothing."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, TypeVar

from bench.base.errors import ScriptError
from bench.batch.batch_record import (
    BatchRecord,
    Bounds,
    DurationOf,
    Item,
    Slot,
    bounds_of,
    items_of,
    look_ahead,
)
from bench.plan.plan import Plan, load_documents, make_plan
from bench.plan.url_secrets import find_url_secrets
from bench.record.pace import Pace, pace_of
from sequences.errors import DocumentFaults
from sequences.queue import JobConfig, JobFile, Queue
from sequences.reader import Located, read_document

Document = TypeVar("Document", Queue, JobFile)
_TOLD_FROM = 2.0
"""A forecast that is longer than the plans by this factor says why; a smaller one surprises nobody."""
_WHY_SLOW = (
    "The times below include this: the computer is slower than planned, or other programs keep it busy."
)
WORKER_S = 2.5
"""Time to start a run's process and to seal its folder, s; measured on the simulated bench."""


def read_queue(path: Path) -> Located[Queue]:
    """Read and check a queue file and all files that it names; its jobs have full paths, except for shipped files."""
    read = _document(path, Queue)
    jobs = [_resolve_files(job, path.parent) for job in read.value.jobs]
    queue = dataclasses.replace(read, value=read.value.model_copy(update={"jobs": jobs}))
    pairs = {_key(job): job for job in queue.value.jobs}
    faults = [fault for job in pairs.values() for fault in job_faults(job)]
    if faults:
        raise ScriptError(list(dict.fromkeys(faults)))
    return queue


def read_job(path: Path) -> JobConfig:
    """Read and check a file with one job, and all files that it names; it has full paths, except for shipped files."""
    job = _resolve_files(_document(path, JobFile).value.job(), path.parent)
    if faults := job_faults(job):
        raise ScriptError(faults)
    return job


def _document(path: Path, model: type[Document]) -> Located[Document]:
    """Read a queue or a job, and refuse credentials in it: it is copied into the folder of the batch."""
    try:
        read = read_document(path, model)
    except DocumentFaults as error:
        raise ScriptError([str(fault) for fault in error.faults]) from error
    if faults := find_url_secrets(read):
        raise ScriptError([str(fault) for fault in faults])
    return read


def _resolve_files(job: JobConfig, base: Path) -> JobConfig:
    """Replace file names of a job, also of passports in settings, by full paths: beside the queue, else in the cwd."""
    names = {key: file for key in ("sequence", "station") if (file := _beside(base, getattr(job, key)))}
    passports = {path: text for path, text in job.settings.items() if path.endswith(".passport")}
    found_passports = {
        path: json.dumps(file) for path, text in passports.items() if (file := _beside(base, text))
    }
    return job.model_copy(update={**names, "settings": {**job.settings, **found_passports}})


def _beside(base: Path, name: str) -> str | None:
    """Return the full path of a file beside the queue file or in the current folder; None if there is none."""
    existing = next((path for path in (base / name, Path(name)) if path.is_file()), None)
    return str(existing.resolve()) if existing is not None else None


def job_faults(job: JobConfig) -> list[str]:
    """Return every fault of the files that a job names."""
    try:
        return [
            str(fault) for fault in make_plan(*load_documents(job.sequence, job.station, job.settings)).faults
        ]
    except ScriptError as error:
        return error.faults


def plan_of(job: JobConfig) -> Plan:
    """Plan one run of a job; the result is cached."""
    return _plan_of(*_key(job))


def _key(job: JobConfig) -> tuple[str, str, tuple[tuple[str, str], ...]]:
    """Return everything that the plan of a job depends on."""
    return job.sequence, job.station, tuple(job.settings.items())


@functools.lru_cache(maxsize=256)
def _plan_of(sequence: str, station: str, settings: tuple[tuple[str, str], ...]) -> Plan:
    return make_plan(*load_documents(sequence, station, dict(settings)))


def planned_duration_s(job: JobConfig) -> float:
    """Return the planned duration of one run with the start of its process, s; 0 if its files cannot be read."""
    try:
        return plan_of(job).duration_s + WORKER_S
    except ScriptError:  # the run itself will report it
        return 0.0


def durations(record: BatchRecord) -> DurationOf:
    """Return what tells the expected duration of a run, s: by those of its job before, or else by its plan."""
    return lambda item: record.expected_duration_s(item, planned_duration_s(item.job))


@dataclass(frozen=True)
class BatchPlan:
    """A batch before it is run."""

    queue: Queue
    begun: datetime
    bounds: Bounds  # Times between which it works
    slots: tuple[Slot, ...]  # Expected times of each run; runs without time are last
    plans: dict[str, Plan]
    paces: Mapping[str, Pace]  # By the name of the station

    @property
    def slow(self) -> list[str]:
        """Why the forecast is longer than the plans, for each station where it is."""
        stations = {plan.station.value.name for plan in self.plans.values()}
        known = (pace_of(self.paces, name) for name in sorted(stations))
        texts = (f"{pace.text()} {_WHY_SLOW}" for pace in known if pace.factor >= _TOLD_FROM)
        return list(dict.fromkeys(texts))

    @property
    def end(self) -> datetime:
        """Time at which the last run is expected to end."""
        return self.moment(max((slot.end_s for slot in self.slots if slot.end_s is not None), default=0.0))

    @property
    def without_time(self) -> tuple[Item, ...]:
        """Runs for which no time is left."""
        return tuple(slot.item for slot in self.slots if slot.begin_s is None)

    @property
    def size_bytes(self) -> int:
        """Expected disk space of all runs that have a time, bytes."""
        return sum(self.plans[s.item.job.name].size_bytes for s in self.slots if s.begin_s is not None)

    def moment(self, at_s: float) -> datetime:
        """Convert seconds after the begin of the batch to a time, in the zone of `begun`."""
        return self.begun + timedelta(seconds=at_s)

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as JSON of schema ``starbench/night/1`` holds it; times in UTC."""
        without_time = {item.key for item in self.without_time}
        return {
            "schema": "starbench/night/1",
            "queue": self.queue.name,
            "begin_utc": self.begun.isoformat(),
            "opens_utc": self.moment(self.bounds.opens_s).isoformat(),
            "end_utc": self.end.isoformat(),
            "runs": len(self.slots) - len(without_time),
            "size_bytes": self.size_bytes,
            "slow": self.slow,
            "items": [slot.in_batch(self.begun).to_dict() for slot in self.slots],
            "no_time_for": sorted(without_time),
        }


def plan_batch(queue: Queue, begun: datetime, paces: Mapping[str, Pace] | None = None) -> BatchPlan:
    """Predict when each run begins and ends; ``paces`` are what earlier runs took over their plans, by station."""
    bounds = bounds_of(queue, begun)
    items = items_of(queue.jobs, begun, bounds.opens_s, queue.zone)
    plans = {job.name: plan_of(job) for job in queue.jobs}
    known = paces or {}

    def duration_s(item: Item) -> float:
        return planned_duration_s(item.job) * pace_of(known, plan_of(item.job).station.value.name).factor

    slots = look_ahead(items, 0.0, bounds, duration_s)
    return BatchPlan(queue, begun, bounds, tuple(slots), plans, known)
