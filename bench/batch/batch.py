"""A batch: does the runs of a queue file one by one, each in its own process, and continues after any failure.

From its journal an interrupted batch continues; an interrupted run is resumed, never started twice, never counted as
done.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec

from bench.base.clock import Aborted, BenchClock
from bench.base.errors import BenchError, RunFolderError, ScriptError, UsageError
from bench.base.home import home_folder
from bench.batch.batch_messages import BatchMessages
from bench.batch.batch_plan import durations
from bench.batch.batch_record import (
    NEVER_S,
    BatchBegun,
    BatchEnded,
    BatchEvent,
    BatchRecord,
    Item,
    ItemBegun,
    ItemEnded,
    Requested,
    choose_next,
    replay_batch,
    resume_text,
)
from bench.batch.batch_requests import REQUESTS, Request, answered, refusal
from bench.batch.batch_status import DoneRun
from bench.batch.batch_summary import RUNS, missed_goals, summarise, write_summary
from bench.batch.supervisor import WorkerEnd, adopt, make_safe_after, supervise
from bench.charts.check_standard import standard_problem
from bench.plan.plan import load_documents
from bench.record.events import event_name
from bench.record.folder_lock import lock_folder
from bench.record.history import History
from bench.record.journal import Journal
from bench.record.run_folder import JOURNAL, is_sealed
from bench.record.run_index import QUEUE_COPY
from bench.record.storage import is_temporary, make_folder, storage_errors, write_atomic
from bench.record.stored_run import StoredRun
from bench.record.summaries import BatchSummary
from bench.record.unsynced_journal import UnsyncedJournal
from drivers.durable import sync_folder
from sequences.queue import Queue
from sequences.reader import Located, check_document

P = ParamSpec("P")


WAIT_POLL_S = 1.0
"""Period at which a waiting batch checks whether a job was added, s: a person notices no delay, and a disk is hardly
read."""

RunWork = Callable[[Item, Path, Path], WorkerEnd]
"""Does a run, in its run folder, to its end; the output goes to a log file."""


class Batch:
    """A batch in its folder, which this process locks: a new one, or an interrupted one of the same queue."""

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
        self._told_of_standard = ""

    def run(self) -> BatchSummary:
        """Do every run that is not done yet, in a folder that belongs to nothing else."""
        self._refuse_occupied()
        make_folder(self.folder / RUNS)
        lock = lock_folder(self.folder)
        try:
            self._keep_queue()
            path = self.folder / JOURNAL
            kind = UnsyncedJournal if self._rehearsal else Journal
            opened = kind.open if path.exists() else kind.create
            with opened(path, self._clock) as journal:
                self._journal = journal
                self._run_locked()
            return write_summary(self.folder, self._record)
        finally:
            self._messages.close()
            os.close(lock)

    @property
    def runs_done(self) -> tuple[int, int]:
        """Number of runs that are done, and of all."""
        runs = self._record.runs
        return sum(run.is_done for run in runs.values()), len(runs)

    def _refuse_occupied(self) -> None:
        """Refuse a folder that holds anything, such as a sealed run, unless this batch began there."""
        if (self.folder / QUEUE_COPY).exists() or not self.folder.exists():
            return
        with storage_errors(self.folder):
            entries = (path for path in self.folder.iterdir() if path.name not in {RUNS, REQUESTS})
            occupied = next((path for path in entries if not is_temporary(path)), None)
        if occupied is not None:
            raise UsageError(
                f"No batch has begun in this folder, and it is not empty: it contains {occupied.name}.",
                where=str(self.folder),
                remedy="Choose another --output.",
            )

    def _keep_queue(self) -> None:
        copy = self.folder / QUEUE_COPY
        if not copy.exists():
            write_atomic(copy, self._queue.text)
        elif copy.read_bytes() != self._queue.text:
            raise self._cannot_continue("The folder belongs to another queue.")

    def _cannot_continue(self, what: str) -> RunFolderError:
        return RunFolderError(what, where=str(self.folder), remedy="Choose another --output.")

    def _run_locked(self) -> None:
        self._record = replay_batch(self._queue.value, self._journal.entries)
        if self._record.begun is None:
            begun: BatchBegun = {"queue": self._queue.value.name, "files": self._files()}
            if self._rehearsal:
                begun["rehearsal"] = True
            elif self._queue.folder is not None:
                begun["file"] = str((self._queue.folder / Path(self._queue.file).name).absolute())
            self._journal_event(BatchBegun, **begun)
        elif self._record.rehearsal != self._rehearsal:
            raise self._cannot_continue(
                "A rehearsed batch and a real one cannot continue in the same folder."
            )
        else:
            self._say(resume_text(self._record))
        if not self._rehearsal:
            self._messages.add_recipients(job.station for job in self._queue.value.jobs)
        with answered(self.folder, self._answer, self._clock):
            how, why = self._run_all()
        self._journal_event(BatchEnded, how=how, why=why)
        if not self._rehearsal:
            summary = summarise(self.folder, self._record)
            self._messages.batch_ended(summary, self.folder, self._journal.head)

    def _files(self) -> dict[str, str]:
        """Return the full path of each file that the queue names by a shorter name."""
        written = check_document(self._queue.text, QUEUE_COPY, Queue).value
        pairs = zip(written.jobs, self._queue.value.jobs, strict=True)
        names = [(w, f) for a, b in pairs for w, f in ((a.sequence, b.sequence), (a.station, b.station))]
        return {name: path for name, path in names if name != path}

    def _journal_event(self, payload: Callable[P, object], *_: P.args, **data: P.kwargs) -> None:
        with self._lock:
            self._record.apply(self._journal.append(BatchEvent(event_name(payload)), **data))

    def _answer(self, request: Request | None, name: str) -> None:
        """Decide on a request once, and record the decision in the journal."""
        with self._lock:
            if request is None:
                why = "the file is not a request"
                self._journal_event(Requested, id=name, word="unknown", taken=False, why=why)
            elif request.id not in self._record.answered:
                try:
                    why = refusal(request, self._record)
                except Exception as error:  # noqa: BLE001 - an unexpected request must not end the batch
                    why = f"the request cannot be processed: {type(error).__name__}: {error}"
                content = request.model_dump(exclude={"format"}, exclude_none=True)
                self._journal_event(Requested, **content, taken=not why, why=why)
                what = request.name or (request.job.name if request.job else "")
                self._say(
                    f"{request.word} {what} by {request.by}: {f'refused, {why}' if why else 'accepted'}"
                )

    def _at_s(self) -> float:
        """Return the time since the begin, s, by the system's time: it goes on while the computer sleeps."""
        return max(0.0, self._record.seconds(self._clock.utc_now()))

    def _choose_next(self) -> Item | float | None:
        with self._lock:
            record = self._record
            return choose_next(record.pending(), self._at_s(), record.bounds, durations(record))

    def _run_all(self) -> tuple[str, str]:
        """Do all runs; return how this ended, and why."""
        wait_announced = False
        try:
            self._recover_last_run()
            while (choice := self._choose_next()) is not None:
                if not isinstance(choice, Item):
                    if not wait_announced:
                        self._say(f"waiting until {self._time_after(choice)}")
                    wait_announced = True
                    self._clock.sleep(min(choice + 0.01, self._look_s))
                    continue
                wait_announced = False
                if why := self._stopped_by_standard(choice):
                    return "stopped", why
                self._run_item(choice)
                run = self._record.runs[choice.key]
                if run.ended[-1].how != "finished" and run.is_done and choice.job.on_failure == "stop":
                    return "stopped", f"{choice.key} failed, and its job has on_failure: stop"
        except Aborted as stop:
            return "aborted", stop.reason
        if pending := self._record.pending():
            left = ", ".join(item.key for item in pending[:5]) + (" ..." if len(pending) > 5 else "")
            return "stopped", f"no time was left for {len(pending)} runs: {left}"
        failed = [run.item.key for run in self._record.with_end if run.ended[-1].how != "finished"]
        return ("finished", "") if not failed else ("failed", f"without a result: {', '.join(failed)}")

    def _stopped_by_standard(self, item: Item) -> str:
        """Return why a run must not begin, by the check standard of its station; the standard itself always may."""
        if self._rehearsal:
            return ""
        try:
            station = load_documents(item.job.sequence, item.job.station, item.job.settings)[1].value
        except ScriptError:  # the run itself says what is wrong
            return ""
        standard = station.check_standard
        if standard is None or standard.serial == station.camera.serial:
            return ""
        problem = standard_problem(station, home_folder(), self._clock.utc_now())
        if problem and problem != self._told_of_standard:
            self._told_of_standard = problem
            self._say(f"CHECK THE BENCH: {problem}")
        return f"{problem} Before {item.key}, measure it again." if problem and standard.stop_batch else ""

    def _time_after(self, wait_s: float) -> str:
        """Return the time of day at the end of a wait."""
        moment = self._record.moment(self._at_s() + wait_s)
        return f"{moment.astimezone(self._queue.value.tzinfo):%a %H:%M %Z}"

    def _run_item(self, item: Item) -> None:
        """Begin or resume a run, and wait for its end."""
        run, state, unreadable = self.folder / RUNS / item.key, self._record.runs[item.key], ""
        self._wait_for_orphan(item, run)
        if is_sealed(run):  # done, but interrupted before the end was recorded
            self._end(item, WorkerEnd("finished", ""))
            return
        try:
            _set_aside_unbegun(run)
            recorded = _poses_recorded(run)
        except BenchError as error:  # one folder that cannot be read must not end the batch
            unreadable, recorded = str(error), state.recorded
        again = (run / JOURNAL).exists()
        attempt = len(state.begun) + 1
        self._journal_event(ItemBegun, item=item.key, again=again, attempt=attempt, recorded=recorded)
        if unreadable:
            self._end(item, WorkerEnd("failed", unreadable))
            return
        self._say(f"{item.key}: {'resumed' if again else 'begun'}")
        self._end(item, self._work(item, run, self.folder / RUNS / f"{item.key}.log"))

    def _recover_last_run(self) -> None:
        """Take care of the run that was in progress when the previous process died, before another run begins."""
        if not self._record.current_run:
            return
        item = self._record.runs[self._record.current_run].item
        run = self.folder / RUNS / item.key
        hung = self._wait_for_orphan(item, run)
        if is_sealed(run):
            self._end(item, WorkerEnd("finished", ""))
        elif not hung and not _has_ended(run):
            end = WorkerEnd("died", "its supervisor died, too", 0.0, make_safe_after(run, self._clock))
            for fault in end.unsafe:
                self._say(f"CHECK THE BENCH: {fault}")
            self._alarm(item, end)

    def _wait_for_orphan(self, item: Item, run: Path) -> bool:
        """Supervise a process that outlived its supervisor and still works on the run; return whether it hung."""
        hung = adopt(run, self._clock, self._say) if run.is_dir() else None
        if hung is not None:
            self._alarm(item, hung)
        return hung is not None

    def _end(self, item: Item, end: WorkerEnd) -> None:
        self._journal_event(ItemEnded, item=item.key, **end.to_dict())
        self._alarm(item, end)

    def _alarm(self, item: Item, end: WorkerEnd) -> None:
        """Report how a run ended, and send messages if it should not have ended so."""
        run = self.folder / RUNS / item.key
        self._say(DoneRun(item.key, end.how, end.why, missed_goals(run)).text)
        if not self._rehearsal:
            self._messages.run_ended(item.key, item.job.station, run, end, self._journal.head)

    def _run_in_process(self, item: Item, run: Path, log: Path) -> WorkerEnd:
        command = [sys.executable, "-m", "bench", *worker_command(item, run)]
        return supervise(command, run, log, self._clock, self._say)


def worker_command(item: Item, run: Path) -> list[str]:
    """Return the arguments of ``starbench`` that begin a run, or resume it if its folder has a journal."""
    if (run / JOURNAL).exists():
        return ["resume", str(run)]
    words = ["run", item.job.sequence, "--station", item.job.station, "--output", str(run)]
    words += [word for path, text in item.job.settings.items() for word in ("--set", f"{path}={text}")]
    words += [] if item.job.seed is None else ["--seed", str(item.job.seed + item.number)]
    return words + ([] if item.job.operator is None else ["--operator", item.job.operator])


def _history_of(run: Path) -> History:
    return StoredRun(run).history if (run / JOURNAL).is_file() else History()


def _has_ended(run: Path) -> bool:
    """Whether the journal of a run records a safe end, or not even a begin; False if it cannot be read."""
    try:
        return bool((history := _history_of(run)).ended) or not history.started
    except BenchError:
        return False


def _poses_recorded(run: Path) -> int:
    """Return the number of poses of a run that are done: recorded and accepted, or skipped."""
    history = _history_of(run)
    return len(history.accepted().keys() | history.skipped.keys())


def _set_aside_unbegun(run: Path) -> None:
    """Rename the folder of a run that was interrupted before its first line in the journal: it cannot be resumed."""
    if not run.is_dir() or ((run / JOURNAL).exists() and StoredRun(run).entries):
        return
    number = 1
    while (aside := run.with_name(f"{run.name}.unbegun-{number}")).exists():
        number += 1
    with storage_errors(run):
        run.rename(aside)
        sync_folder(run.parent)
