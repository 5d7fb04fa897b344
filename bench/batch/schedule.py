"""Schedule of a batch: which run is next, when it begins, and for which runs no time is left.

Pure functions of times in s from the batch's begin; times of day are converted once, when the batch begins.
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
class Slot:
    """Expected times of a run, s after the begin of the batch; None if no time is left for it."""

    item: Item
    begin_s: float | None
    end_s: float | None


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
