"""Status of a batch, also while it runs: what is done, what is in progress, and when further runs begin."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from bench.base.encoding import counted
from bench.base.errors import BenchError
from bench.base.pasteable import pasteable
from bench.batch.batch_plan import durations
from bench.batch.batch_record import BatchRecord, UpcomingRun, look_ahead
from bench.batch.batch_summary import RUNS, missed_goals, read_batch, to_go_on
from bench.record.device_end import NO_END
from bench.record.folder_lock import is_locked, resume_process, suspended_process
from bench.record.run_folder import JOURNAL
from bench.record.storage import storage_errors
from bench.run.status import read_plan, read_status
from bench.wording.numbers import duration

FOLLOW_S = 1.0  # The times shown are whole seconds
_TICK_WAITS = 2
"""With ``ticks``, the status is read again after this many waits, 2 s: its times go on without a change of the
journal."""
_MOST_UPCOMING = 12  # More do not fit on one screen below the rest of the status


class DoneRun(NamedTuple):
    """A run of a batch that needs no further attempt."""

    item: str
    how: str
    why: str
    goals_missed: tuple[str, ...] = ()  # Each ``until`` that ended without its goals, as sentences

    @property
    def text(self) -> str:
        """The run's end as one line."""
        return ": ".join(filter(None, (self.item, self.how, self.why, " ".join(self.goals_missed))))


@dataclass(frozen=True)
class BatchStatus:
    """Status of a batch."""

    folder: str  # Folder of the batch
    queue: str  # Name of the queue
    zone: tzinfo | None  # Time zone of the printed times
    running: bool  # Whether a process works on it
    rehearsal: bool  # Whether it is a rehearsal
    simulated: bool  # Whether any device of a run is simulated
    ended: str  # How it ended; empty if it has not ended
    why: str  # Why it ended so; empty if there is nothing to say
    done: tuple[DoneRun, ...]
    current_run: str  # The run in progress, in words; empty between runs
    # Runs in progress and to come, in their order; runs without time are last.
    upcoming: tuple[UpcomingRun, ...]
    withdrawn: tuple[str, ...]
    last_end: datetime | None = None  # Of the runs so far
    file: str = ""  # Full path of the queue file that it began with; empty if unknown

    @property
    def end(self) -> datetime | None:
        """Time at which the last run is expected to end; None if no run is to come."""
        return max((run.end for run in self.upcoming if run.end is not None), default=None)

    def to_dict(self) -> dict[str, Any]:
        """Return the status as JSON of schema ``starbench/batch-status/1`` holds it; times in UTC."""
        return {
            "schema": "starbench/batch-status/1",
            "folder": self.folder,
            "queue": self.queue,
            "running": self.running,
            "rehearsal": self.rehearsal,
            "simulated": self.simulated,
            "ended": self.ended,
            "why": self.why,
            "done": [run._asdict() for run in self.done],
            "at_work": self.current_run,
            "coming": [run.to_dict() for run in self.upcoming],
            "withdrawn": list(self.withdrawn),
            "end_utc": self.end.isoformat() if self.end else None,
        }


def read_batch_status(
    folder: Path, utc_now: Callable[[], datetime] = lambda: datetime.now(UTC)
) -> BatchStatus:
    """Read the status of a batch; changes nothing and disturbs no process."""
    running = is_locked(folder)  # before the journal: a batch that ends meanwhile does not appear as killed
    record = read_batch(folder)
    done = tuple(
        DoneRun(
            run.item.key,
            run.ended[-1].how,
            run.ended[-1].why,
            _missed_goals(folder / RUNS / run.item.key, len(run.ended)),
        )
        for run in record.with_end
        if run.is_done and run.item.key != record.current_run
    )
    return BatchStatus(
        folder=str(folder),
        queue=record.queue.name,
        file=record.file,
        zone=record.queue.tzinfo,
        running=running,
        rehearsal=record.rehearsal,
        simulated=any(
            read_plan(folder / RUNS / key).simulated for key, run in record.runs.items() if run.begun
        ),
        ended="" if running else record.ended,
        why="" if running else record.why,
        done=done,
        current_run=_current_run_text(folder, record) if running and record.current_run else "",
        upcoming=_upcoming(record, utc_now(), under_way=running),
        withdrawn=tuple(sorted(key for key, run in record.runs.items() if run.withdrawn)),
        last_end=record.last_end,
    )


@cache  # a journal may be long, and a follower asks again and again
def _missed_goals(run: Path, _attempts: int) -> tuple[str, ...]:
    return missed_goals(run)


def follow_batch(folder: Path, *, ticks: bool) -> Iterator[BatchStatus]:
    """Read the status at each begin and end, with ``ticks`` also in between, until no process works on the batch."""
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
        time.sleep(FOLLOW_S)


def _upcoming(record: BatchRecord, now: datetime, *, under_way: bool) -> tuple[UpcomingRun, ...]:
    """Predict the times of the run in progress and of the runs to come."""
    if record.begun is None or (record.ended and not under_way):
        return ()
    at_s, first, duration_of = record.seconds(now), [], durations(record)
    pending = record.pending()
    if record.current_run and under_way:
        run = record.runs[record.current_run]
        item, since_s = run.item, record.seconds(run.begun[-1])
        at_s = max(at_s, since_s + duration_of(item))
        first = [UpcomingRun(item.key, record.moment(since_s), record.moment(at_s))]
        pending = [other for other in pending if other.key != item.key]
    slots = look_ahead(pending, at_s, record.bounds, duration_of)
    return (*first, *(slot.in_batch(record.begun) for slot in slots))


def _current_run_text(folder: Path, record: BatchRecord) -> str:
    try:
        status = read_status(folder / RUNS / record.current_run)
    except BenchError:  # its journal has no line yet
        return f"{record.current_run}: starting"
    held = f", HELD by {status.held_by}" if status.held_by else ""
    left = "" if status.left_s is None else f", {duration(status.left_s)} left"
    poses = f"{status.accepted} of {status.poses_text} poses recorded"
    return f"{record.current_run}: {status.state}, {poses}{held}{left}"


def batch_status_text(status: BatchStatus) -> str:
    """Describe the status of a batch for the operator."""
    state = "running" if status.running else status.ended or f"interrupted ({NO_END})"
    state += f": {status.why}" if status.why else ""
    mark = "  REHEARSAL" if status.rehearsal else "  SIMULATED" if status.simulated else ""
    lines = [f"Batch {status.queue}{mark}: {state}"]
    finished = sum(run.how == "finished" for run in status.done)
    lines.append(f"{counted(finished, 'run')} with a result, {len(status.done) - finished} without")
    lines += [f"  {run.text}" for run in status.done if run.how != "finished" or run.goals_missed]
    if status.withdrawn:
        lines.append(f"Withdrawn: {', '.join(status.withdrawn)}")
    if status.current_run:
        lines.append(f"In progress: {status.current_run}")
    lines += _upcoming_lines(status)
    if status.running and (suspended := suspended_process(Path(status.folder))):
        lines.append(resume_process(suspended))
    elif status.end is not None and status.running:
        lines.append(f"Expected end: {_clock(status.end, status.zone, day=True)}")
    broken_off = not status.running and status.ended != "finished"
    if broken_off and status.rehearsal:
        lines.append("A rehearsal cannot be continued.")
    elif broken_off and status.ended == "failed":
        lines += to_go_on(Path(status.folder), (run.item for run in status.done if run.how != "finished"))
    elif broken_off:
        again = pasteable("batch", status.file or "QUEUE", "--output", status.folder)
        lines.append(f"No process works on it. To continue: {again}")
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
