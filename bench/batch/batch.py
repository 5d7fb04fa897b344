"""A night of runs: takes them from a queue file one by one, each in a worker of its own, and goes on after anything.

What has happened stands in the batch's own journal; a batch that was cut off goes on where it stopped. A run that was
cut off is taken up again, never begun anew beside its first half and never taken for done. Which run comes next is
the schedule's business (`schedule`), what has happened the record's (`batch_record`). Knows no devices.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.base.clock import Aborted, BenchClock
from bench.base.errors import BenchError, RunFolderError
from bench.batch.batch_messages import BatchMessages
from bench.batch.batch_plan import planned_duration_s
from bench.batch.batch_record import BatchEvent, BatchRecord, resume_text
from bench.batch.batch_requests import Request, RequestInbox, refusal
from bench.batch.batch_summary import RUNS, write_summary
from bench.batch.schedule import NEVER_S, Item, choose_next
from bench.batch.supervisor import WorkerEnd, adopt, make_safe_after, supervise
from bench.records.folder_lock import lock_folder
from bench.records.history import History, replay
from bench.records.journal import Journal, read_journal
from bench.records.run_folder import JOURNAL, is_sealed
from bench.records.run_index import QUEUE_COPY
from bench.records.storage import make_folder, storage_errors, sync_folder, write_atomic
from bench.records.unsynced_journal import UnsyncedJournal
from sequences.queue import Queue
from sequences.reader import Located, check_document

WAIT_POLL_S = 1.0
"""While the batch waits for a time, it looks so often whether a job was added."""

RunWork = Callable[[Item, Path, Path], WorkerEnd]
"""Runs an item in its run folder to its end; what it says goes to a log file."""


class Batch:
    """A batch in its folder, held by this process.

    Parameters
    ----------
    folder
        New, empty, or that of a batch that was cut off.
    queue
        What is to be run; the folder keeps a copy, and goes on with no other.
    clock
        The batch's clock; a stop asked of it ends the run at work safely, and the batch.
    say
        Where to tell the operator.
    work
        Runs an item to its end: in a process of its own, watched, unless told otherwise.
    rehearsal
        Whether nothing of it is real; a rehearsed batch never goes on as a real one, nor the other way round.
    """

    def __init__(
        self,
        folder: Path,
        queue: Located[Queue],
        clock: BenchClock,
        say: Callable[[str], None],
        work: RunWork | None = None,
        *,
        rehearsal: bool = False,
    ) -> None:
        self.folder = folder.absolute()
        self._queue, self._clock, self._say = queue, clock, say
        self._work = work or self._run_in_process
        self._rehearsal = rehearsal
        self._look_s = NEVER_S if rehearsal else WAIT_POLL_S
        self._record = BatchRecord(queue.value)
        self._lock = threading.RLock()
        self._messages = BatchMessages(clock, say)

    def run(self) -> dict[str, Any]:
        """Do every run that is not done yet.

        Returns
        -------
        dict
            The summary, as in ``summary.json``.

        Raises
        ------
        RunFolderError
            When the folder holds something else, or another process works on it.
        StorageError
            When the disk does not take it.
        """
        make_folder(self.folder / RUNS)
        lock = lock_folder(self.folder)
        try:
            self._keep_queue()
            path = self.folder / JOURNAL
            clocks: dict[str, Any] = {"utc_now": self._clock.utc_now, "monotonic": self._clock.monotonic}
            kind = UnsyncedJournal if self._rehearsal else Journal
            opened = kind.open if path.exists() else kind.create
            with opened(path, **clocks) as journal:
                self._journal = journal
                self._run_locked()
            return write_summary(self.folder, self._record)
        finally:
            self._messages.close()
            os.close(lock)

    def _keep_queue(self) -> None:
        copy = self.folder / QUEUE_COPY
        if not copy.exists():
            write_atomic(copy, self._queue.text)
        elif copy.read_bytes() != self._queue.text:
            raise RunFolderError(
                "This folder belongs to another queue.",
                where=str(self.folder),
                remedy="Choose another --output.",
            )

    def _run_locked(self) -> None:
        for entry in self._journal.entries:
            self._record.apply(entry)
        if self._record.begun is None:
            said: dict[str, Any] = {"rehearsal": True} if self._rehearsal else {}
            self._journal_event(BatchEvent.BEGUN, queue=self._queue.value.name, files=self._files(), **said)
        else:
            self._say(resume_text(self._record))
        if self._record.rehearsal != self._rehearsal:
            raise RunFolderError(
                "A rehearsed batch and a real one never go on in one folder.",
                where=str(self.folder),
                remedy="Choose another --output.",
            )
        self._begun_s = self._clock.monotonic() - max(0.0, self._record.seconds(self._clock.utc_now()))
        if not self._rehearsal:
            self._messages.add_recipients(job.station for job in self._queue.value.jobs)
        requests = RequestInbox(self.folder, self._answer, self._clock)
        requests.drain()
        requests.watch()
        try:
            how, why = self._run_all()
        finally:
            requests.close()
        self._journal_event(BatchEvent.ENDED, how=how, why=why)
        if not self._rehearsal:
            runs = [
                f"{key}: {end.how}{': ' if end.why else ''}{end.why}"
                for key, end in self._record.ends.items()
            ]
            self._messages.batch_ended(
                self._queue.value.name, how, why, runs, self.folder, self._journal.head
            )

    def _files(self) -> dict[str, str]:
        """Say which files the queue means by the names in it, where it does not name them in full."""
        written = check_document(self._queue.text, QUEUE_COPY, Queue).value
        pairs = zip(written.jobs, self._queue.value.jobs, strict=True)
        names = [(w, f) for a, b in pairs for w, f in ((a.sequence, b.sequence), (a.station, b.station))]
        return {said: meant for said, meant in names if said != meant}

    def _journal_event(self, event: BatchEvent, **data: Any) -> None:
        with self._lock:
            self._record.apply(self._journal.append(event, **data))

    def _answer(self, request: Request | None, name: str) -> None:
        """Decide on a request, once, and journal it."""
        with self._lock:
            if request is None:
                self._journal_event(
                    BatchEvent.REQUESTED, id=name, word="unknown", taken=False, why="it is no request"
                )
            elif request.id not in self._record.answered:
                try:
                    why = refusal(request, self._record)
                except Exception as error:  # noqa: BLE001 - a request that nobody foresaw must not end the night
                    why = f"it cannot be judged: {type(error).__name__}: {error}"
                said = request.model_dump(exclude={"format"}, exclude_none=True)
                self._journal_event(BatchEvent.REQUESTED, **said, taken=not why, why=why)
                what = request.name or (request.job.name if request.job else "")
                self._say(f"{request.word} {what} by {request.by}: {why or 'taken'}")

    def _choose_next(self) -> Item | float | None:
        with self._lock:
            record = self._record
            at_s = self._clock.monotonic() - self._begun_s
            return choose_next(
                record.pending(),
                at_s,
                record.bounds,
                lambda item: record.expected_duration_s(item, planned_duration_s(item.job)),
            )

    def _run_all(self) -> tuple[str, str]:
        """Do run after run; say how that ended, and why."""
        told_wait = False
        try:
            self._recover_last_run()
            while (found := self._choose_next()) is not None:
                if not isinstance(found, Item):
                    if not told_wait:
                        self._say(f"waiting until {self._time_after(found)}")
                    told_wait = True
                    self._clock.sleep(min(found + 0.01, self._look_s))
                    continue
                told_wait = False
                self._run_item(found)
                end = self._record.ends[found.key]
                if end.how != "finished" and self._record.is_done(found) and found.job.on_failure == "stop":
                    return "stopped", f"{found.key} failed, and the queue says to stop then"
        except Aborted as stop:
            return "aborted", stop.reason
        if pending := self._record.pending():
            left = ", ".join(item.key for item in pending[:5]) + (" ..." if len(pending) > 5 else "")
            return "stopped", f"no time was left for {len(pending)} runs: {left}"
        failed = [key for key, end in self._record.ends.items() if end.how != "finished"]
        return ("finished", "") if not failed else ("failed", f"without a result: {', '.join(failed)}")

    def _time_after(self, wait_s: float) -> str:
        """Say at what time of day a wait is over."""
        moment = self._record.moment(self._clock.monotonic() - self._begun_s + wait_s)
        return f"{moment.astimezone(self._queue.value.tzinfo):%a %H:%M %Z}"

    def _run_item(self, item: Item) -> None:
        """Begin a run, or take it up again, and wait for its end."""
        run, record, unreadable = self.folder / RUNS / item.key, self._record, ""
        self._wait_for_orphan(item, run)
        if is_sealed(run):  # done, but cut off before that was told
            self._end(item, WorkerEnd("finished", ""))
            return
        try:
            _set_aside_unbegun(run)
            recorded = _poses_recorded(run)
        except BenchError as error:  # one folder that cannot be read must not end the night
            unreadable, recorded = str(error), record.recorded.get(item.key, 0)
        again = (run / JOURNAL).exists()
        attempt = record.attempts.get(item.key, 0) + 1
        self._journal_event(
            BatchEvent.ITEM_BEGUN, item=item.key, again=again, attempt=attempt, recorded=recorded
        )
        if unreadable:
            self._end(item, WorkerEnd("failed", unreadable))
            return
        self._say(f"{item.key}: {'taken up again' if again else 'begun'}")
        self._end(item, self._work(item, run, self.folder / RUNS / f"{item.key}.log"))

    def _recover_last_run(self) -> None:
        """See to the run that was at work when the process before this one died: before any other is begun."""
        item = self._record.items.get(self._record.current_run)
        if item is None:
            return
        run = self.folder / RUNS / item.key
        hung = self._wait_for_orphan(item, run)
        if is_sealed(run):
            self._end(item, WorkerEnd("finished", ""))
        elif not hung and not _has_ended(run):
            unsafe = make_safe_after(run, self._clock)
            for fault in unsafe:
                self._say(f"CHECK THE BENCH: {fault}")
            self._alarm(item, WorkerEnd("died", "together with what watched it", 0.0, unsafe))

    def _wait_for_orphan(self, item: Item, run: Path) -> bool:
        """Watch whoever works on a run already: it outlived its supervisor. Tell whether it hung."""
        silent_s = adopt(run, self._clock, self._say) if run.is_dir() else 0.0
        if silent_s:
            self._alarm(item, WorkerEnd("hung", f"gave no sign of life for {silent_s:.1f} s", silent_s))
        return silent_s > 0.0

    def _end(self, item: Item, end: WorkerEnd) -> None:
        self._journal_event(BatchEvent.ITEM_ENDED, item=item.key, **asdict(end))
        self._alarm(item, end)

    def _alarm(self, item: Item, end: WorkerEnd) -> None:
        """Say how a run ended; and tell those who are away, where it should not have ended so."""
        self._say(f"{item.key}: {end.how}{': ' if end.why else ''}{end.why}")
        if not self._rehearsal:
            run = self.folder / RUNS / item.key
            self._messages.run_ended(item.key, item.job.station, run, end, self._journal.head)

    def _run_in_process(self, item: Item, run: Path, log: Path) -> WorkerEnd:
        command = [sys.executable, "-m", "bench", *worker_command(item, run)]
        return supervise(command, run, log, self._clock, self._say)


def worker_command(item: Item, run: Path) -> list[str]:
    """Say the command that begins a run, or takes it up again where its folder has a journal."""
    if (run / JOURNAL).exists():
        return ["resume", str(run)]
    words = ["run", item.job.sequence, "--station", item.job.station, "--output", str(run)]
    words += [word for path, text in item.job.settings.items() for word in ("--set", f"{path}={text}")]
    words += [] if item.job.seed is None else ["--seed", str(item.job.seed + item.number)]
    return words + ([] if item.job.operator is None else ["--operator", item.job.operator])


def _history_of(run: Path) -> History:
    return replay(read_journal(run / JOURNAL)[0] if (run / JOURNAL).is_file() else ())


def _has_ended(run: Path) -> bool:
    """Whether the journal of a run tells of an end, and so of a bench left safe; not where it cannot be read."""
    try:
        return bool(_history_of(run).ended)
    except BenchError:
        return False


def _poses_recorded(run: Path) -> int:
    """Count the poses of a run that are done with: recorded and accepted, or skipped."""
    history = _history_of(run)
    return len(history.accepted().keys() | history.skipped.keys())


def _set_aside_unbegun(run: Path) -> None:
    """Keep, under another name, what a run left that was cut off before its first line: it cannot be taken up."""
    if not run.is_dir() or ((run / JOURNAL).exists() and read_journal(run / JOURNAL)[0]):
        return
    number = 1
    while (aside := run.with_name(f"{run.name}.unbegun-{number}")).exists():
        number += 1
    with storage_errors(run):
        run.rename(aside)
        sync_folder(run.parent)
