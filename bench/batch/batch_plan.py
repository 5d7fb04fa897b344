"""A night before it is run: the queue with all it names checked, when each run is expected, and what it will be worth.

Time is the schedule's own (`schedule`), fed with the plan of every run; nothing is run and nothing written.
"""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from bench.base.errors import ScriptError
from bench.batch.schedule import Bounds, Item, Slot, bounds_of, items_of, look_ahead
from bench.plan.plan import Plan, load_documents, make_plan
from sequences.errors import DocumentFaults
from sequences.queue import JobConfig, JobFile, Queue
from sequences.reader import Located, read_document

_HEAD_BYTES = 4096
WORKER_S = 2.5
"""Beginning a run's process and sealing what it leaves, as measured on the simulated bench."""


def is_queue(name: str) -> bool:
    """Whether a file says that it is a queue; whether it is a sound one, ``read_queue`` tells."""
    try:
        with Path(name).open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except (OSError, ValueError):
        return False
    return b"starbench/queue/" in head


def read_queue(path: Path) -> Located[Queue]:
    """Read a queue file, and everything it names; its jobs then name their files in full, shipped ones aside.

    Raises
    ------
    ScriptError
        With every fault of the queue, or of the sequences and stations in it.
    """
    try:
        read = read_document(path, Queue)
    except DocumentFaults as error:
        raise ScriptError([str(fault) for fault in error.faults]) from error
    jobs = [_resolve_files(job, path.parent) for job in read.value.jobs]
    queue = dataclasses.replace(read, value=read.value.model_copy(update={"jobs": jobs}))
    pairs = {_key(job): job for job in queue.value.jobs}
    faults = [fault for job in pairs.values() for fault in job_faults(job)]
    if faults:
        raise ScriptError(list(dict.fromkeys(faults)))
    return queue


def read_job(path: Path) -> JobConfig:
    """Read a file of one job, and everything it names; its files are named in full afterwards, shipped ones aside.

    Raises
    ------
    ScriptError
        With every fault.
    """
    try:
        job = _resolve_files(read_document(path, JobFile).value.job(), path.parent)
    except DocumentFaults as error:
        raise ScriptError([str(fault) for fault in error.faults]) from error
    if faults := job_faults(job):
        raise ScriptError(faults)
    return job


def _resolve_files(job: JobConfig, base: Path) -> JobConfig:
    """Name the files of a job so that they are found from anywhere: beside the file that names them, or from here."""
    names = {}
    for key in ("sequence", "station"):
        said = Path(getattr(job, key))
        found = next((path for path in (base / said, said) if path.is_file()), None)
        if found is not None:
            names[key] = str(found.resolve())
    return job.model_copy(update=names)


def job_faults(job: JobConfig) -> list[str]:
    """Say what is wrong with the files a job names; empty when nothing is."""
    try:
        return [
            str(fault) for fault in make_plan(*load_documents(job.sequence, job.station, job.settings)).faults
        ]
    except ScriptError as error:
        return error.faults


def plan_of(job: JobConfig) -> Plan:
    """Plan one run of a job, once a process. Raises ScriptError where a file cannot be read."""
    return _plan_of(*_key(job))


def _key(job: JobConfig) -> tuple[str, str, tuple[tuple[str, str], ...]]:
    """Give what the plan of a job depends on."""
    return job.sequence, job.station, tuple(job.settings.items())


@functools.lru_cache(maxsize=256)
def _plan_of(sequence: str, station: str, settings: tuple[tuple[str, str], ...]) -> Plan:
    return make_plan(*load_documents(sequence, station, dict(settings)))


def planned_duration_s(job: JobConfig) -> float:
    """Expected duration of one run of a job, its process included, s; nothing where its files cannot be read."""
    try:
        return plan_of(job).duration_s + WORKER_S
    except ScriptError:  # the run itself will say so
        return 0.0


@dataclass(frozen=True)
class BatchPlan:
    """A batch before it is run.

    Attributes
    ----------
    queue
        What is to be run.
    begun
        When it would be begun.
    bounds
        Between which moments it works.
    slots
        When each run is expected; those there is no time for come last.
    plans
        The plan of one run of each job.
    """

    queue: Queue
    begun: datetime
    bounds: Bounds
    slots: tuple[Slot, ...]
    plans: dict[str, Plan]

    @property
    def end(self) -> datetime:
        """When the last run is expected to end."""
        return self.moment(max((slot.end_s for slot in self.slots if slot.end_s is not None), default=0.0))

    @property
    def without_time(self) -> tuple[Item, ...]:
        """Runs for which there is no time."""
        return tuple(slot.item for slot in self.slots if slot.begin_s is None)

    @property
    def size_bytes(self) -> int:
        """Disk expected."""
        return sum(self.plans[s.item.job.name].size_bytes for s in self.slots if s.begin_s is not None)

    def moment(self, at_s: float) -> datetime:
        """Give seconds after the begin as a moment."""
        return self.begun + timedelta(seconds=at_s)

    def to_dict(self) -> dict[str, Any]:
        """Give it as JSON carries it; times in UTC."""
        without_time = {item.key for item in self.without_time}
        return {
            "schema": "starbench/night/1",
            "queue": self.queue.name,
            "begin_utc": self.begun.isoformat(),
            "opens_utc": self.moment(self.bounds.opens_s).isoformat(),
            "end_utc": self.end.isoformat(),
            "runs": len(self.slots) - len(without_time),
            "size_bytes": self.size_bytes,
            "items": [
                {
                    "item": slot.item.key,
                    "begin_utc": None if slot.begin_s is None else self.moment(slot.begin_s).isoformat(),
                    "end_utc": None if slot.end_s is None else self.moment(slot.end_s).isoformat(),
                }
                for slot in self.slots
            ],
            "no_time_for": sorted(without_time),
        }


def plan_batch(queue: Queue, begun: datetime) -> BatchPlan:
    """Say when each run of a queue would begin and end, were the batch begun at a moment.

    Raises
    ------
    ScriptError
        When a file it names cannot be read.
    """
    bounds = bounds_of(queue, begun)
    items = items_of(queue.jobs, begun, bounds.opens_s, queue.zone)
    slots = look_ahead(items, 0.0, bounds, lambda item: planned_duration_s(item.job))
    return BatchPlan(queue, begun, bounds, tuple(slots), {job.name: plan_of(job) for job in queue.jobs})
