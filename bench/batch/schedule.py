"""Which run of a batch comes next, when, and what there is no time left for: the rule, and a look ahead by it.

Pure: seconds in, decisions out; the batch that is under way, the plan of a night and the status all ask here. Times
count from the begin of the batch. Times of day become seconds once, when they are first asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, time, timedelta
from zoneinfo import ZoneInfo

from sequences.queue import JobConfig, Queue

NEVER_S = math.inf


@dataclass(frozen=True)
class Item:
    """One run of a batch.

    Attributes
    ----------
    key
        Its name in the batch: the job's and the number of its repetition.
    job
        What the queue says.
    number
        Of the repetition, from 0.
    from_s
        When the job's first repetition may begin, s after the begin of the batch.
    """

    key: str
    job: JobConfig
    number: int
    first_begin_s: float = 0.0

    @property
    def due_s(self) -> float:
        """Earliest begin after the begin of the batch, s."""
        return self.first_begin_s + self.number * self.job.every_min * 60.0


@dataclass(frozen=True)
class Bounds:
    """Between which moments a batch works, s after its begin.

    Attributes
    ----------
    opens_s
        Nothing begins before.
    last_begin_s
        Nothing begins after.
    done_by_s
        Nothing begins that is not expected to be done by then.
    """

    opens_s: float = 0.0
    last_begin_s: float = NEVER_S
    done_by_s: float = NEVER_S

    def fits(self, begin_s: float, expected_duration_s: float) -> bool:
        """Whether a run may begin then."""
        return begin_s <= self.last_begin_s and begin_s + expected_duration_s <= self.done_by_s


@dataclass(frozen=True)
class Slot:
    """When a run is expected; ``begin_s`` and ``end_s`` are None where there is no time for it."""

    item: Item
    begin_s: float | None
    end_s: float | None


DurationOf = Callable[[Item], float]
"""Expected duration of a run, s; the same for all runs of a job."""


def next_time(at: str, after: datetime, zone: str | None) -> datetime:
    """Find the next moment, strictly after another, at which clocks show a time of day.

    Parameters
    ----------
    at
        Hours and minutes, as ``22:30``.
    after
        Aware of its zone.
    zone
        Whose clocks; None for those of this machine.

    Returns
    -------
    datetime
        UTC. Where clocks are put forward over it, as much later as they are put forward.

    Examples
    --------
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
    """Say between which moments a queue's batch works that was begun at a moment."""
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
    """List every run of some jobs.

    Parameters
    ----------
    jobs
        As the queue, or a file of a job added to it, has them.
    begun
        When the batch was begun.
    now_s
        From when on these jobs count, s after that: the opening of the batch, or when they were added.
    zone
        Of times of day.
    """
    items = []
    for job in jobs:
        first_begin_s = now_s
        if job.start_at:
            moment = next_time(job.start_at, begun + timedelta(seconds=now_s, microseconds=-1), zone)
            first_begin_s = (moment - begun).total_seconds()
        items += [Item(f"{job.name}-{n + 1:03d}", job, n, first_begin_s) for n in range(job.times)]
    return items


def by_priority(items: Sequence[Item]) -> list[Item]:
    """Put runs in the order in which they are tried: higher priorities first, else as they came."""
    return sorted(items, key=lambda item: -item.job.priority)


def choose_next(
    pending: Sequence[Item], at_s: float, bounds: Bounds, expected_duration_s: DurationOf
) -> Item | float | None:
    """Say what to do at a moment.

    Returns
    -------
    Item, float or None
        The run to begin; how long to wait before asking again, s; or None when no more run can be begun.
    """
    return _choose(by_priority(pending), at_s, bounds, _once_a_job(expected_duration_s))


def _once_a_job(expected_duration_s: DurationOf) -> DurationOf:
    """Ask only once for each job: a long night has many runs, and each answer may look at all that have ended."""
    known: dict[str, float] = {}

    def lasts(item: Item) -> float:
        name = item.job.name
        if name not in known:
            known[name] = expected_duration_s(item)
        return known[name]

    return lasts


def _choose(
    ordered: Sequence[Item], at_s: float, bounds: Bounds, expected_duration_s: DurationOf
) -> Item | float | None:
    wait_s = NEVER_S
    for item in ordered:
        begin_s = max(at_s, item.due_s, bounds.opens_s)
        if not bounds.fits(begin_s, expected_duration_s(item)):
            continue
        if begin_s <= at_s:
            return item
        wait_s = min(wait_s, begin_s - at_s)
    return None if wait_s == NEVER_S else wait_s


def look_ahead(
    pending: Sequence[Item], at_s: float, bounds: Bounds, expected_duration_s: DurationOf
) -> list[Slot]:
    """Say when each run is expected, in the order in which they will be done; those without time for them last.

    Examples
    --------
    >>> job = JobConfig(name="a", sequence="s", station="t", times=3, every_min=60)
    >>> items = items_of([job], datetime(2026, 3, 1, 20, tzinfo=UTC))
    >>> [(s.item.key, s.begin_s) for s in look_ahead(items, 0, Bounds(done_by_s=7000), lambda _: 600)]
    [('a-001', 0), ('a-002', 3600.0), ('a-003', None)]
    """
    left, slots, expected_duration_s = by_priority(pending), [], _once_a_job(expected_duration_s)
    while left:
        chosen = _choose(left, at_s, bounds, expected_duration_s)
        if chosen is None:
            break
        if isinstance(chosen, Item):
            begin_s, at_s = at_s, at_s + expected_duration_s(chosen)
            slots.append(Slot(chosen, begin_s, at_s))
            left.remove(chosen)
        else:
            at_s += chosen
    return slots + [Slot(item, None, None) for item in left]
