"""How a batch stands, for somebody who looks on from another terminal: what is done, what comes when, when it ends.

Read from the batch's folder, which stays untouched; what is to come, by the same rule as the batch goes by.
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
_MOST_UPCOMING = 12


@dataclass(frozen=True)
class UpcomingRun:
    """A run that is under way or to come; ``begin`` and ``end`` are None where there is no time for it."""

    item: str
    begin: datetime | None
    end: datetime | None


@dataclass(frozen=True)
class BatchStatus:
    """How a batch stands.

    Attributes
    ----------
    folder, queue, zone
        Where it is, its name, and whose clocks its times are told by.
    running, rehearsal
        Whether a process works on it; whether it is a rehearsal.
    ended, why
        How it ended, and why; empty while it has not.
    done
        For each run that is done with: its name, how it ended, and why.
    at_work
        The run under way, in words; empty between runs.
    coming
        Runs under way and to come, in their order; those there is no time for last.
    withdrawn
        Runs that were withdrawn.
    """

    folder: str
    queue: str
    zone: tzinfo | None
    running: bool
    rehearsal: bool
    ended: str
    why: str
    done: tuple[tuple[str, str, str], ...]
    current_run: str
    upcoming: tuple[UpcomingRun, ...]
    withdrawn: tuple[str, ...]

    @property
    def end(self) -> datetime | None:
        """When the last run is expected to end; None where nothing is to come."""
        return max((run.end for run in self.upcoming if run.end is not None), default=None)

    def to_dict(self) -> dict[str, Any]:
        """Give it as JSON carries it; times in UTC."""
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
    """Look at a batch; nothing is changed, and no process of it is disturbed.

    Raises
    ------
    RunFolderError, JournalBroken, StorageError
        When there is no batch, or it cannot be read.
    """
    record = read_batch(folder)
    running = is_locked(folder)
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


def follow_batch(folder: Path, sleep: Callable[[float], None] = time.sleep) -> Iterator[BatchStatus]:
    """Look at a batch again whenever a run of it begins or ends, until no process works on it."""
    seen = -1
    while True:
        with storage_errors(folder):
            size = (folder / JOURNAL).stat().st_size
        running = is_locked(folder)
        if size != seen or not running:
            seen = size
            yield read_batch_status(folder)
        if not running:
            return
        sleep(FOLLOW_S)


def _upcoming(record: BatchRecord, now: datetime, *, under_way: bool) -> tuple[UpcomingRun, ...]:
    """Look ahead from now on, past the end of the run under way."""
    if record.begun is None or (record.ended and not under_way):
        return ()

    def expected_duration_s(item: Item) -> float:
        return record.expected_duration_s(item, planned_duration_s(item.job))

    at_s, first = record.seconds(now), []
    pending = record.pending()
    if record.current_run and under_way:
        item = record.items[record.current_run]
        since_s = record.seconds(record.current_since or now)
        at_s = max(at_s, since_s + expected_duration_s(item))
        first = [UpcomingRun(item.key, record.moment(since_s), record.moment(at_s))]
        pending = [other for other in pending if other.key != item.key]
    slots = look_ahead(pending, at_s, record.bounds, expected_duration_s)
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
    except BenchError:  # it has not written its first line yet
        return f"{record.current_run}: beginning"
    held = f", HELD by {status.held_by}" if status.held_by else ""
    left = "" if status.left_s is None else f", {duration_text(status.left_s)} left"
    return f"{record.current_run}: {status.state}, {status.accepted} of {status.poses} poses recorded{held}{left}"


def batch_status_text(status: BatchStatus) -> str:
    """Say how a batch stands, for people."""
    state = "running" if status.running else status.ended or "killed or cut off"
    state += f": {status.why}" if status.why else ""
    lines = [f"Batch {status.queue}{'  REHEARSAL' if status.rehearsal else ''}: {state}"]
    failed = [one for one in status.done if one[1] != "finished"]
    lines.append(f"{len(status.done) - len(failed)} runs with a result, {len(failed)} without")
    lines += [f"  {item}: {how}{': ' if why else ''}{why}" for item, how, why in failed]
    if status.withdrawn:
        lines.append(f"Withdrawn: {', '.join(status.withdrawn)}")
    if status.current_run:
        lines.append(f"At work: {status.current_run}")
    lines += _upcoming_lines(status)
    if status.end is not None and status.running:
        lines.append(f"Expected end: {_clock(status.end, status.zone, day=True)}")
    if not status.running and status.ended != "finished":
        lines.append(f"No process works on it; go on with: starbench batch QUEUE --output {status.folder}")
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
