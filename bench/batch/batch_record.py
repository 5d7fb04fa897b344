"""State of a batch, from its journal alone, and its schedule: which run is next, when, and for which no time is left.

The schedule is of pure functions of times in s from the batch's begin; times of day are converted once, at the begin.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, time, timedelta
from enum import StrEnum
from statistics import fmean
from typing import Any, NotRequired, TypedDict
from zoneinfo import ZoneInfo

from pydantic import ValidationError

from bench.base.errors import JournalBroken
from bench.record.journal_line import Entry
from sequences.queue import JobConfig, Queue

NEVER_S = math.inf
MOST_CUTS = 10
"""A run is given up after this number of cuts without a further recorded pose: it may be what cuts the power."""

_MOST_NAMED = 8  # A line of a terminal
_MOST_STEP_S = 60.0
"""A run spans a restart of the computer if the monotonic clock shows so much more time than the system's, s: a system's
clock that is corrected goes back by less."""


@dataclass(frozen=True)
class Item:
    """One run of a batch."""

    key: str
    job: JobConfig
    number: int  # Number of the repetition, from 0
    # Earliest begin of the job's first repetition, s after the begin of the batch.
    first_begin_s: float = 0.0

    @property
    def due_s(self) -> float:
        """Earliest begin of this repetition, s after the begin of the batch."""
        return self.first_begin_s + self.number * self.job.every_min * 60.0


@dataclass(frozen=True)
class Bounds:
    """Times between which a batch works, s after its begin."""

    opens_s: float = 0.0  # No run begins before this time
    last_begin_s: float = NEVER_S  # No run begins after this time
    done_by_s: float = NEVER_S  # No run begins that is expected to end after this time

    def fits(self, begin_s: float, expected_duration_s: float) -> bool:
        """Return whether a run may begin at a time: it does not begin or end too late."""
        return begin_s <= self.last_begin_s and begin_s + expected_duration_s <= self.done_by_s


@dataclass(frozen=True)
class UpcomingRun:
    """A run in progress or to come, and its expected times; None if no time is left for it."""

    item: str
    begin: datetime | None
    end: datetime | None

    def to_dict(self) -> dict[str, Any]:
        """Return the run as JSON holds it."""
        begin, end = (moment.isoformat() if moment else None for moment in (self.begin, self.end))
        return {"item": self.item, "begin_utc": begin, "end_utc": end}


@dataclass(frozen=True)
class Slot:
    """Expected times of a run, s after the begin of the batch; None if no time is left for it."""

    item: Item
    begin_s: float | None
    end_s: float | None

    def in_batch(self, begun: datetime) -> UpcomingRun:
        """Return the run with its times, in a batch that began at a time, in the same zone."""
        times = (
            None if at_s is None else begun + timedelta(seconds=at_s) for at_s in (self.begin_s, self.end_s)
        )
        return UpcomingRun(self.item.key, *times)


DurationOf = Callable[[Item], float]
"""Expected duration of a run, s; the same for all runs of a job."""


def next_time(at: str, after: datetime, zone: str | None) -> datetime:
    """Find the next moment, UTC, strictly after another with its zone, at which clocks show a time as ``22:30``.

    ``zone`` None stands for the clocks of this machine. Where clocks are put forward over the time, it is as much
    later.

    >>> f"{next_time('22:30', datetime(2026, 3, 1, 21, 0, tzinfo=UTC), 'Europe/Berlin'):%d %H:%M}"
    '01 21:30'
    >>> f"{next_time('22:30', datetime(2026, 3, 1, 21, 30, tzinfo=UTC), 'Europe/Berlin'):%d %H:%M}"
    '02 21:30'
    """
    hour, minute = (int(part) for part in at.split(":"))
    place = ZoneInfo(zone) if zone else None
    day = after.astimezone(place).date()
    while True:
        for fold in (0, 1):  # clocks that are put back show it twice
            shown = datetime.combine(day, time(hour, minute, fold=fold))
            moment = (shown.replace(tzinfo=place) if place else shown.astimezone()).astimezone(UTC)
            if moment > after:
                return moment
        day += timedelta(days=1)


def bounds_of(queue: Queue, begun: datetime) -> Bounds:
    """Return the times between which a batch works, s after its begin."""
    opens = next_time(queue.start_at, begun, queue.zone) if queue.start_at else begun
    opens_s = (opens - begun).total_seconds()
    closes = next_time(queue.stop_by, opens, queue.zone) if queue.stop_by else None
    return Bounds(
        opens_s,
        opens_s + queue.stop_after_h * 3600.0 if queue.stop_after_h else NEVER_S,
        (closes - begun).total_seconds() if closes else NEVER_S,
    )


def items_of(
    jobs: Sequence[JobConfig], begun: datetime, now_s: float = 0.0, zone: str | None = None
) -> list[Item]:
    """List every repetition of some jobs in order; they may begin at ``now_s``. ``zone`` None is this computer's."""
    items = []
    for job in jobs:
        first_begin_s = now_s
        if job.start_at:
            moment = next_time(job.start_at, begun + timedelta(seconds=now_s, microseconds=-1), zone)
            first_begin_s = (moment - begun).total_seconds()
        items += [Item(f"{job.name}-{n + 1:03d}", job, n, first_begin_s) for n in range(job.times)]
    return items


def by_priority(items: Sequence[Item]) -> list[Item]:
    """Sort runs: higher priorities first, otherwise in the given order."""
    return sorted(items, key=lambda item: -item.job.priority)


def choose_next(
    pending: Sequence[Item], at_s: float, bounds: Bounds, duration_of: DurationOf
) -> Item | float | None:
    """Decide at a time, s after the batch's begin: the run to begin now, or the wait, s; None if none can begin."""
    return _choose(by_priority(pending), at_s, bounds, _once_a_job(duration_of))


def _once_a_job(duration_of: DurationOf) -> DurationOf:
    """Call the function once for each job only, because it may go through all runs that have ended."""
    known: dict[str, float] = {}

    def lasts(item: Item) -> float:
        name = item.job.name
        if name not in known:
            known[name] = duration_of(item)
        return known[name]

    return lasts


def _choose(
    ordered: Sequence[Item], at_s: float, bounds: Bounds, duration_of: DurationOf
) -> Item | float | None:
    wait_s = NEVER_S
    for item in ordered:
        begin_s = max(at_s, item.due_s, bounds.opens_s)
        if not bounds.fits(begin_s, duration_of(item)):
            continue
        if begin_s <= at_s:
            return item
        wait_s = min(wait_s, begin_s - at_s)
    return None if wait_s == NEVER_S else wait_s


def look_ahead(pending: Sequence[Item], at_s: float, bounds: Bounds, duration_of: DurationOf) -> list[Slot]:
    """Predict, at a time in s after the batch's begin, when each run that is not done begins and ends.

    ``bounds`` are the times between which the batch works; ``duration_of`` returns the expected duration of a run, s.
    Runs stand in the order of their beginning, those without time last.

    >>> job = JobConfig(name="a", sequence="s", station="t", times=3, every_min=60)
    >>> items = items_of([job], datetime(2026, 3, 1, 20, tzinfo=UTC))
    >>> [(s.item.key, s.begin_s) for s in look_ahead(items, 0, Bounds(done_by_s=7000), lambda _: 600)]
    [('a-001', 0), ('a-002', 3600.0), ('a-003', None)]
    """
    left, slots, duration_of = by_priority(pending), [], _once_a_job(duration_of)
    while left:
        chosen = _choose(left, at_s, bounds, duration_of)
        if chosen is None:
            break
        if isinstance(chosen, Item):
            begin_s, at_s = at_s, at_s + duration_of(chosen)
            slots.append(Slot(chosen, begin_s, at_s))
            left.remove(chosen)
        else:
            at_s += chosen
    return slots + [Slot(item, None, None) for item in left]


class BatchEvent(StrEnum):
    """Kinds of lines in a batch's journal."""

    BEGUN = "batch_begun"
    """First line: name of the queue."""
    ITEM_BEGUN = "item_begun"
    """A run begins or is resumed (``again``); ``attempt`` is the number of the attempt, from 1."""
    ITEM_ENDED = "item_ended"
    """The attempt ended (a ``WorkerEnd``)."""
    REQUESTED = "requested"
    """An operator's request (`bench.batch.batch_plan`) and the answer: accepted, or refused with a reason."""
    ENDED = "batch_ended"
    """The batch ended: how and why. If it is called again, it continues."""


class BatchBegun(TypedDict):
    """Payload of ``batch_begun``; ``files`` gives the full path of each file that the queue names by a shorter name."""

    queue: str
    files: Mapping[str, str]
    file: NotRequired[str]  # Full path of the queue file; earlier versions did not write it
    rehearsal: NotRequired[bool]


class ItemBegun(TypedDict):
    """Payload of ``item_begun``: the run, whether it is resumed, the attempt, and the poses recorded before it."""

    item: str
    again: bool
    attempt: int
    recorded: int


class ItemEnded(TypedDict):
    """Payload of ``item_ended``: the run, and its `bench.batch.supervisor.WorkerEnd`."""

    item: str
    how: str
    why: str
    noticed_s: float
    unsafe: Sequence[str]
    outside: NotRequired[bool]
    devices: NotRequired[Sequence[Mapping[str, str]]]


class Requested(TypedDict):
    """Payload of ``requested``: the request, who made it, whether it was accepted, and why not."""

    id: str
    word: str
    taken: bool
    why: str
    by: NotRequired[str]
    known_by: NotRequired[str]
    name: NotRequired[str]
    job: NotRequired[Mapping[str, Any]]


class BatchEnded(TypedDict):
    """Payload of ``batch_ended``."""

    how: str
    why: str


@dataclass(frozen=True)
class RunAttempt:
    """One attempt at a run that has an end."""

    begun: datetime
    ended: datetime
    how: str  # How it ended, as in ``WorkerEnd``
    why: str
    duration_s: float  # While the computer was awake, s


@dataclass
class RunState:
    """What the journal of a batch tells of one of its runs."""

    item: Item
    withdrawn: bool = False  # Before it began
    begun: list[datetime] = field(default_factory=list)  # Begin of each attempt
    begun_mono_s: float = 0.0  # Begin of the last attempt by the monotonic clock, s
    ended: list[RunAttempt] = field(default_factory=list)  # The attempts that have an end
    recorded: int = 0  # Number of poses that it had recorded when its last attempt began
    failures: int = 0  # Failures of its own processes since it last recorded a further pose
    # Attempts since then that something else ended: a power cut, a kill, the end of the batch's own process.
    cuts: int = 0

    @property
    def is_done(self) -> bool:
        """Whether it needs no further attempt.

        It finished, was aborted or withdrawn, or its processes failed ``attempts`` times without a further recorded
        pose. A power cut or a kill is no failure, up to ``MOST_CUTS``.
        """
        if self.withdrawn or not self.ended:
            return self.withdrawn
        if self.ended[-1].how in {"finished", "aborted"}:  # an aborted run is not resumed
            return True
        return self.failures >= self.item.job.attempts or self.cuts >= MOST_CUTS


@dataclass
class BatchRecord:
    """State of a batch; `apply` updates it with each line of the journal."""

    queue: Queue
    begun: datetime | None = None
    bounds: Bounds = field(default_factory=Bounds)
    """Times between which the batch works."""
    rehearsal: bool = False
    file: str = ""
    """Full path of the queue file with which the batch was begun; empty if its journal does not say."""
    runs: dict[str, RunState] = field(default_factory=dict)
    """Every run, including withdrawn ones, by its name, in the order of the queue."""
    with_end: list[RunState] = field(default_factory=list)
    """The runs of which an attempt has ended, in the order of their first end."""
    current_run: str = ""
    """Name of the run in progress; empty between runs."""
    answered: dict[str, Requested] = field(default_factory=dict)
    """Answer to each request, by its id."""
    ended: str = ""
    why: str = ""

    @property
    def jobs(self) -> list[str]:
        """The names of the jobs, including withdrawn ones."""
        return list(dict.fromkeys(run.item.job.name for run in self.runs.values()))

    def pending(self) -> list[Item]:
        """List the runs that are still to begin or to resume, in the order of the queue."""
        return [run.item for run in self.runs.values() if not run.is_done]

    def expected_duration_s(self, item: Item, planned_duration_s: float) -> float:
        """Return the mean duration of the job's runs that finished in their first attempt, else the planned one."""
        took = [
            run.ended[0].duration_s
            for run in self.with_end
            if run.ended[-1].how == "finished" and len(run.begun) == 1 and run.item.job.name == item.job.name
        ]
        return fmean(took) if took else planned_duration_s

    def withdrawable(self, job: str) -> list[RunState]:
        """List the runs of a job that have not begun."""
        ours = [run for run in self.runs.values() if run.item.job.name == job]
        return [run for run in ours if not run.begun and not run.withdrawn]

    @property
    def last_end(self) -> datetime | None:
        """When the last attempt so far ended; None before any."""
        return max((run.ended[-1].ended for run in self.with_end), default=None)

    def seconds(self, moment: datetime) -> float:
        """Convert a time to seconds after the begin of the batch."""
        assert self.begun is not None
        return (moment - self.begun).total_seconds()

    def apply(self, entry: Entry) -> None:
        """Update the state with one line of the journal. Raises JournalBroken when it lacks a field."""
        try:
            self._apply(entry, datetime.fromisoformat(entry.utc))
        except (KeyError, TypeError, ValueError, ValidationError) as error:
            raise JournalBroken(
                f"Line {entry.seq + 1} ({entry.event}) of the batch's journal is incomplete: {error}.",
                remedy="Another program or version wrote this journal; use that version.",
            ) from error

    def _apply(self, entry: Entry, now: datetime) -> None:
        match entry.event:
            case BatchEvent.BEGUN:
                self._begin(entry.of(BatchBegun), now)
            case BatchEvent.ITEM_BEGUN:
                self._begin_run(entry.of(ItemBegun), now, entry.mono_s)
            case BatchEvent.ITEM_ENDED:
                self._end_run(entry.of(ItemEnded), now, entry.mono_s)
            case BatchEvent.REQUESTED:
                self._answer(entry.of(Requested), now)
            case BatchEvent.ENDED:
                ended = entry.of(BatchEnded)
                self.ended, self.why = ended["how"], ended["why"]

    def _begin(self, data: BatchBegun, now: datetime) -> None:
        self.file = data.get("file", "")
        self.begun, self.bounds = now, bounds_of(self.queue, now)
        self.rehearsal = bool(data.get("rehearsal", False))
        jobs = [_with_files(job, data.get("files", {})) for job in self.queue.jobs]
        self._add(items_of(jobs, now, self.bounds.opens_s, self.queue.zone))

    def _begin_run(self, data: ItemBegun, now: datetime, mono_s: float) -> None:
        run, recorded = self.runs[data["item"]], data.get("recorded", 0)
        # Its last attempt has no end: the batch's own process was cut off, too
        if self.current_run == data["item"]:
            run.cuts += 1
        if recorded > run.recorded:
            run.failures = run.cuts = 0
        run.recorded = recorded
        run.begun.append(now)
        run.begun_mono_s = mono_s
        self.current_run = data["item"]
        self.ended = self.why = ""

    def _end_run(self, data: ItemEnded, now: datetime, mono_s: float) -> None:
        run = self.runs[data["item"]]
        if data.get("outside"):
            run.cuts += 1
        else:
            run.failures += 1
        if not run.ended:
            self.with_end.append(run)
        since, took_s = now, 0.0
        if self.current_run == data["item"]:
            since, took_s = run.begun[-1], mono_s - run.begun_mono_s
            passed_s = (now - since).total_seconds()
            if took_s < 0 or 0 <= passed_s < took_s - _MOST_STEP_S:
                took_s = max(0.0, passed_s)  # the computer has started anew, and its monotonic clock, too
        run.ended.append(RunAttempt(since, now, data["how"], data["why"], took_s))
        self.current_run = ""

    def _answer(self, data: Requested, now: datetime) -> None:
        self.answered[data["id"]] = data
        if not data["taken"]:
            return
        assert self.begun is not None
        if data["word"] == "add":
            job = JobConfig.model_validate(data["job"])
            now_s = max(self.seconds(now), self.bounds.opens_s)
            self._add(items_of([job], self.begun, now_s, self.queue.zone))
        else:
            for run in self.withdrawable(data["name"]):
                run.withdrawn = True

    def _add(self, items: Iterable[Item]) -> None:
        self.runs |= {item.key: RunState(item) for item in items}

    def moment(self, at_s: float) -> datetime:
        """Convert seconds after the begin of the batch to a time."""
        assert self.begun is not None
        return self.begun + timedelta(seconds=at_s)


def _with_files(job: JobConfig, files: Mapping[str, str]) -> JobConfig:
    """Replace a job's file names by the paths with which the batch began."""
    names = {key: files.get(getattr(job, key), getattr(job, key)) for key in ("sequence", "station")}
    return job.model_copy(update=names)


def resume_text(record: BatchRecord) -> str:
    """Describe what an interrupted or ended batch does when it is called again."""
    pending = record.pending()
    again = [item.key for item in pending if record.runs[item.key].begun]
    fresh = [item.key for item in pending if not record.runs[item.key].begun]
    parts = [f"{len(record.runs) - len(pending)} of {len(record.runs)} runs are done"]
    parts += [f"to resume: {', '.join(again)}"] if again else []
    more = f" and {len(fresh) - _MOST_NAMED} more" if len(fresh) > _MOST_NAMED else ""
    parts += [f"to begin: {', '.join(fresh[:_MOST_NAMED])}{more}"] if fresh else []
    return f"{record.queue.name} continues: {'; '.join(parts)}."


def replay_batch(queue: Queue, entries: Iterable[Entry]) -> BatchRecord:
    """Compute the state of a batch from its journal. Raises JournalBroken when a line lacks a field."""
    record = BatchRecord(queue)
    for entry in entries:
        record.apply(entry)
    return record
