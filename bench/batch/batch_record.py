"""A batch so far: what its journal amounts to. Which runs there are, how each stands, what jobs came or went.

Knows the events of a batch's journal; no files and no devices. The batch under way, its status and its summary all
read from here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from enum import StrEnum
from statistics import fmean
from typing import Any

from pydantic import ValidationError

from bench.base.errors import JournalBroken
from bench.batch.schedule import Bounds, Item, bounds_of, items_of
from bench.records.journal import Entry
from sequences.queue import JobConfig, Queue


class BatchEvent(StrEnum):
    """What a line of a batch's journal tells."""

    BEGUN = "batch_begun"
    """First line: the queue's name."""
    ITEM_BEGUN = "item_begun"
    """A run begins, or is taken up again (``again``), for the so-and-so-many-th time (``attempt``)."""
    ITEM_ENDED = "item_ended"
    """It ended (a ``WorkerEnd``)."""
    REQUESTED = "requested"
    """An operator's request (`bench.batch.batch_requests`): what, by whom, whether and why not it was taken."""
    ENDED = "batch_ended"
    """The batch ended: how and why. It may be called again, and goes on."""


@dataclass(frozen=True)
class RunAttempt:
    """One try of a run: from when to when its worker worked, and how that ended."""

    begun: datetime
    ended: datetime
    how: str

    @property
    def duration_s(self) -> float:
        """How long, s."""
        return (self.ended - self.begun).total_seconds()


@dataclass(frozen=True)
class ItemEnd:
    """How a run of a batch ended last, and when it had begun for the first time."""

    how: str
    why: str
    begun: datetime
    ended: datetime


@dataclass
class BatchRecord:
    """A batch so far; ``apply`` keeps it up to date, line by line."""

    queue: Queue
    begun: datetime | None = None
    bounds: Bounds = field(default_factory=Bounds)
    """Between which moments it works."""
    rehearsal: bool = False
    items: dict[str, Item] = field(default_factory=dict)
    """Every run there is or was, by its name."""
    withdrawn: set[str] = field(default_factory=set)
    """Runs that were withdrawn before they began."""
    attempts: dict[str, int] = field(default_factory=dict)
    attempts_without_progress: dict[str, int] = field(default_factory=dict)
    """Tries of a run in a row before which no further pose had been recorded."""
    recorded: dict[str, int] = field(default_factory=dict)
    """Poses that a run had recorded when it was begun last."""
    ends: dict[str, ItemEnd] = field(default_factory=dict)
    begun_at: dict[str, datetime] = field(default_factory=dict)
    """When each run was begun first."""
    current_run: str = ""
    """The run at work; empty between runs."""
    current_since: datetime | None = None
    ended_attempts: dict[str, list[RunAttempt]] = field(default_factory=dict)
    answered: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    """What became of each request, by its id."""
    ended: str = ""
    why: str = ""

    def jobs(self) -> dict[str, list[Item]]:
        """List the runs of each job, withdrawn ones too."""
        found: dict[str, list[Item]] = {}
        for item in self.items.values():
            found.setdefault(item.job.name, []).append(item)
        return found

    def pending(self) -> list[Item]:
        """List the runs that are still to be done, or to be taken up again."""
        return [item for item in self.items.values() if not self.is_done(item)]

    def is_done(self, item: Item) -> bool:
        """Whether nothing more is to be done about a run."""
        if item.key in self.withdrawn:
            return True
        end = self.ends.get(item.key)
        if end is None:
            return False
        if end.how in {"finished", "aborted"}:  # whoever aborted a run does not want it taken up again
            return True
        return self.attempts_without_progress.get(item.key, 0) >= item.job.attempts

    def expected_duration_s(self, item: Item, planned_duration_s: float) -> float:
        """Expect a run to take as long as others of its job took; before there are such, as planned."""
        took = [
            self.ended_attempts[key][0].duration_s
            for key, end in self.ends.items()
            if end.how == "finished"
            and self.attempts.get(key) == 1
            and self.items[key].job.name == item.job.name
        ]
        return fmean(took) if took else planned_duration_s

    def withdrawable(self, job: str) -> list[Item]:
        """List the runs of a job that have not begun."""
        return [
            item
            for item in self.jobs().get(job, [])
            if item.key not in self.attempts and item.key not in self.withdrawn
        ]

    def seconds(self, moment: datetime) -> float:
        """Give a moment as seconds after the begin."""
        assert self.begun is not None
        return (moment - self.begun).total_seconds()

    def apply(self, entry: Entry) -> None:
        """Take a line of the journal.

        Raises
        ------
        JournalBroken
            When it lacks what it must carry.
        """
        try:
            self._apply(entry, datetime.fromisoformat(entry.utc))
        except (KeyError, TypeError, ValueError, ValidationError) as error:
            raise JournalBroken(
                f"Line {entry.seq + 1} ({entry.event}) of the batch lacks something: {error}.",
                remedy="This journal was written by another program or version.",
            ) from error

    def _apply(self, entry: Entry, now: datetime) -> None:
        data = entry.data
        match entry.event:
            case BatchEvent.BEGUN:
                self.begun, self.bounds = now, bounds_of(self.queue, now)
                self.rehearsal = bool(data.get("rehearsal", False))
                files = data.get("files", {})
                self._add(
                    items_of(
                        [_with_files(job, files) for job in self.queue.jobs],
                        now,
                        self.bounds.opens_s,
                        self.queue.zone,
                    )
                )
            case BatchEvent.ITEM_BEGUN:
                key = data["item"]
                self._count_try(key, data.get("recorded", 0))
                self.begun_at.setdefault(key, now)
                self.current_run, self.current_since = key, now
                self.ended = self.why = ""
            case BatchEvent.ITEM_ENDED:
                self._end(data["item"], data["how"], data["why"], now)
            case BatchEvent.REQUESTED:
                self._answer(data, now)
            case BatchEvent.ENDED:
                self.ended, self.why = data["how"], data["why"]

    def _count_try(self, key: str, recorded: int) -> None:
        gained = recorded > self.recorded.get(key, 0)
        self.attempts_without_progress[key] = 1 if gained else self.attempts_without_progress.get(key, 0) + 1
        self.attempts[key] = self.attempts.get(key, 0) + 1
        self.recorded[key] = recorded

    def _end(self, key: str, how: str, why: str, now: datetime) -> None:
        begun = self.begun_at.get(key, now)
        self.ends[key] = ItemEnd(how, why, begun, now)
        since = self.current_since if self.current_run == key and self.current_since else now
        self.ended_attempts.setdefault(key, []).append(RunAttempt(since, now, how))
        self.current_run, self.current_since = "", None

    def _answer(self, data: Mapping[str, Any], now: datetime) -> None:
        self.answered[data["id"]] = data
        if not data["taken"]:
            return
        assert self.begun is not None
        if data["word"] == "add":
            job = JobConfig.model_validate(data["job"])
            now_s = max(self.seconds(now), self.bounds.opens_s)
            self._add(items_of([job], self.begun, now_s, self.queue.zone))
        else:
            self.withdrawn |= {item.key for item in self.withdrawable(data["name"])}

    def _add(self, items: Iterable[Item]) -> None:
        self.items |= {item.key: item for item in items}

    def moment(self, at_s: float) -> datetime:
        """Give seconds after the begin as a moment."""
        assert self.begun is not None
        return self.begun + timedelta(seconds=at_s)


def _with_files(job: JobConfig, files: Mapping[str, str]) -> JobConfig:
    """Name a job's files as the batch was begun with."""
    names = {key: files.get(getattr(job, key), getattr(job, key)) for key in ("sequence", "station")}
    return job.model_copy(update=names)


def resume_text(record: BatchRecord) -> str:
    """Say what a batch that was cut off, or has ended, will do when it is called again."""
    pending = record.pending()
    again = [item.key for item in pending if item.key in record.attempts]
    fresh = [item.key for item in pending if item.key not in record.attempts]
    said = [f"{len(record.items) - len(pending)} of {len(record.items)} runs are done with"]
    said += [f"to take up again: {', '.join(again)}"] if again else []
    said += [f"to begin: {_shortened(fresh)}"] if fresh else []
    return f"{record.queue.name} goes on: {'; '.join(said)}."


def _shortened(keys: list[str], most: int = 8) -> str:
    more = f" and {len(keys) - most} more" if len(keys) > most else ""
    return ", ".join(keys[:most]) + more


def replay_batch(queue: Queue, entries: Iterable[Entry]) -> BatchRecord:
    """Replay a batch's journal. Raises JournalBroken."""
    record = BatchRecord(queue)
    for entry in entries:
        record.apply(entry)
    return record
