"""Status of a batch for another terminal: what is done, what comes when, and when the batch ends.

Reads the batch's folder and changes nothing in it. Future runs follow the same schedule as the batch itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError
from bench.batch.batch_plan import planned_duration_s
from bench.batch.batch_record import BatchRecord
from bench.batch.batch_summary import RUNS, read_batch
from bench.batch.schedule import Item, look_ahead
from bench.plan.plan_text import duration_text
from bench.records.folder_lock import is_locked
from bench.records.run_folder import JOURNAL
from bench.records.storage import storage_errors
from bench.run.status import read_status

FOLLOW_S = 1.0
_TICK_WAITS = 2
"""With ``ticks``, the status is read again after this many waits."""
_MOST_UPCOMING = 12


@dataclass(frozen=True)
class UpcomingRun:
    """A run in progress or to come."""

    item: str
    # begin, end: Expected times; None if no time is left for it.
    begin: datetime | None
    end: datetime | None


@dataclass(frozen=True)
class BatchStatus:
    """Status of a batch."""

    # folder, queue, zone: Folder of the batch, name of its queue, and time zone of the printed times.
    folder: str
    queue: str
    zone: tzinfo | None
    # running, rehearsal: Whether a process works on it; whether it is a rehearsal.
    running: bool
    rehearsal: bool
    # ended, why: How it ended, and why; empty if it has not ended.
    ended: str
    why: str
    done: tuple[tuple[str, str, str], ...]
    current_run: str  # The run in progress, in words; empty between runs
    # Runs in progress and to come, in their order; runs without time are last.
    upcoming: tuple[UpcomingRun, ...]
    withdrawn: tuple[str, ...]

    @property
    def end(self) -> datetime | None:
        """Time at which the last run is expected to end; None if no run is to come."""
        return max((run.end for run in self.upcoming if run.end is not None), default=None)

    def to_dict(self) -> dict[str, Any]:
        """Return the status as JSON holds it.

        Returns: Object of schema ``starbench/batch-status/1``; times in UTC.
        """
        return {
            "schema": "starbench/batch-status/1",
            "folder": self.folder,
            "queue": self.queue,
            "running": self.running,
            "rehearsal": self.rehearsal,
            "ended": self.ended,
            "why": self.why,
            "done": [{"item": item, "how": how, "why": why} for item, how, why in self.done],
            "at_work": self.current_run,
            "coming": [
                {"item": run.item, "begin_utc": _iso(run.begin), "end_utc": _iso(run.end)}
                for run in self.upcoming
            ],
            "withdrawn": list(self.withdrawn),
            "end_utc": _iso(self.end),
        }


def read_batch_status(
    folder: Path, utc_now: Callable[[], datetime] = lambda: datetime.now(UTC)
) -> BatchStatus:
    """Read the status of a batch; changes nothing and disturbs no process.

    Raises RunFolderError, JournalBroken, StorageError: When there is no batch in the folder, or it cannot be
      read.
    """
    running = is_locked(folder)  # before the journal: a batch that ends meanwhile does not appear as killed
    record = read_batch(folder)
    done = tuple(
        (key, end.how, end.why)
        for key, end in record.ends.items()
        if record.is_done(record.items[key]) and key != record.current_run
    )
    return BatchStatus(
        folder=str(folder),
        queue=record.queue.name,
        zone=record.queue.tzinfo,
        running=running,
        rehearsal=record.rehearsal,
        ended="" if running else record.ended,
        why="" if running else record.why,
        done=done,
        current_run=_current_run_text(folder, record) if running and record.current_run else "",
        upcoming=_upcoming(record, utc_now(), under_way=running),
        withdrawn=tuple(sorted(record.withdrawn)),
    )


def follow_batch(
    folder: Path, sleep: Callable[[float], None] = time.sleep, *, ticks: bool = False
) -> Iterator[BatchStatus]:
    """Read the status whenever a run begins or ends, until no process works on the batch.

    sleep: Waits for a number of seconds.
    ticks: Whether to read it also when no run has begun or ended, for the course of the run in progress.
    """
    seen, waits = -1, 0
    while True:
        with storage_errors(folder):
            size = (folder / JOURNAL).stat().st_size
        running = is_locked(folder)
        waits += 1
        if size != seen or not running or (ticks and waits >= _TICK_WAITS):
            seen, waits = size, 0
            yield read_batch_status(folder)
        if not running:
            return
        sleep(FOLLOW_S)


def _upcoming(record: BatchRecord, now: datetime, *, under_way: bool) -> tuple[UpcomingRun, ...]:
    """Predict the times of the run in progress and of the runs to come."""
    if record.begun is None or (record.ended and not under_way):
        return ()

    def duration_of(item: Item) -> float:
        return record.expected_duration_s(item, planned_duration_s(item.job))

    at_s, first = record.seconds(now), []
    pending = record.pending()
    if record.current_run and under_way:
        item = record.items[record.current_run]
        since_s = record.seconds(record.current_since or now)
        at_s = max(at_s, since_s + duration_of(item))
        first = [UpcomingRun(item.key, record.moment(since_s), record.moment(at_s))]
        pending = [other for other in pending if other.key != item.key]
    slots = look_ahead(pending, at_s, record.bounds, duration_of)
    return (
        *first,
        *(
            UpcomingRun(
                slot.item.key,
                None if slot.begin_s is None else record.moment(slot.begin_s),
                None if slot.end_s is None else record.moment(slot.end_s),
            )
            for slot in slots
        ),
    )


def _current_run_text(folder: Path, record: BatchRecord) -> str:
    try:
        status = read_status(folder / RUNS / record.current_run)
    except BenchError:  # its journal has no line yet
        return f"{record.current_run}: starting"
    held = f", HELD by {status.held_by}" if status.held_by else ""
    left = "" if status.left_s is None else f", {duration_text(status.left_s)} left"
    return f"{record.current_run}: {status.state}, {status.accepted} of {status.poses} poses recorded{held}{left}"


def batch_status_text(status: BatchStatus) -> str:
    """Describe the status of a batch for the operator."""
    state = "running" if status.running else status.ended or "interrupted (killed or power lost)"
    state += f": {status.why}" if status.why else ""
    lines = [f"Batch {status.queue}{'  REHEARSAL' if status.rehearsal else ''}: {state}"]
    failed = [one for one in status.done if one[1] != "finished"]
    lines.append(f"{len(status.done) - len(failed)} runs with a result, {len(failed)} runs without")
    lines += [f"  {item}: {how}{': ' if why else ''}{why}" for item, how, why in failed]
    if status.withdrawn:
        lines.append(f"Withdrawn: {', '.join(status.withdrawn)}")
    if status.current_run:
        lines.append(f"In progress: {status.current_run}")
    lines += _upcoming_lines(status)
    if status.end is not None and status.running:
        lines.append(f"Expected end: {_clock(status.end, status.zone, day=True)}")
    if not status.running and status.ended != "finished":
        lines.append(f"No process works on it; continue with: starbench batch QUEUE --output {status.folder}")
    return "\n".join(lines)


def _upcoming_lines(status: BatchStatus) -> list[str]:
    planned = [run for run in status.upcoming if run.begin is not None and run.end is not None]
    lines = [
        f"  {_clock(run.begin, status.zone)} to {_clock(run.end, status.zone)}  {run.item}"
        for run in planned[:_MOST_UPCOMING]
        if run.begin is not None and run.end is not None
    ]
    if len(planned) > _MOST_UPCOMING:
        lines.append(f"  ... {len(planned) - _MOST_UPCOMING} more")
    cut = [run.item for run in status.upcoming if run.begin is None]
    return [*lines, *([f"No time for: {', '.join(cut)}"] if cut else [])]


def _clock(moment: datetime, zone: tzinfo | None, *, day: bool = False) -> str:
    return f"{moment.astimezone(zone):{'%a %H:%M %Z' if day else '%H:%M'}}"


def _iso(moment: datetime | None) -> str | None:
    return moment.isoformat() if moment else None
