"""A night of runs: takes them from a queue file one by one, each in a worker of its own, and goes on after anything.

What has happened stands in the batch's own journal; a batch that was cut off goes on where it stopped. A run that was
cut off is taken up again, never begun anew beside its first half and never taken for done. Knows no devices.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from bench.clock import Aborted, BenchClock
from bench.errors import RunFolderError, ScriptError
from bench.folder_lock import hold_folder, is_worked_on
from bench.journal import Entry, Journal, read_journal
from bench.plan import load, plan
from bench.run_folder import JOURNAL, is_sealed
from bench.storage import make_folder, storing, sync_folder, write_whole
from bench.supervisor import WorkerEnd, make_safe_after, supervise
from sequences.errors import DocumentFaults
from sequences.queue import JobWords, Queue
from sequences.reader import Located, read_document

QUEUE_COPY = "queue.yaml"
SUMMARY = "summary.json"
RUNS = "runs"
BEGUN, ITEM_BEGUN, ITEM_ENDED, BATCH_ENDED = "batch_begun", "item_begun", "item_ended", "batch_ended"

Supervise = Callable[[Sequence[str], Path, Path], WorkerEnd]


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
    """

    key: str
    job: JobWords
    number: int

    @property
    def due_s(self) -> float:
        """Earliest begin after the begin of the batch, s."""
        return self.number * self.job.every_min * 60.0

    def words(self, folder: Path) -> list[str]:
        """Say the command that begins it, or takes it up again where its folder has a journal."""
        if (folder / JOURNAL).exists():
            return ["resume", str(folder)]
        words = ["run", self.job.sequence, "--station", self.job.station, "--output", str(folder)]
        words += [] if self.job.seed is None else ["--seed", str(self.job.seed + self.number)]
        return words + ([] if self.job.operator is None else ["--operator", self.job.operator])


def items_of(queue: Queue) -> list[Item]:
    """List every run of a queue: higher priorities first, then as written."""
    jobs = sorted(queue.jobs, key=lambda job: -job.priority)
    return [Item(f"{job.name}-{n + 1:03d}", job, n) for job in jobs for n in range(job.times)]


def read_queue(path: Path) -> Located[Queue]:
    """Read a queue file, and everything it names.

    Raises
    ------
    ScriptError
        With every fault of the queue, or of the sequences and stations in it.
    """
    try:
        queue = read_document(path, Queue)
    except DocumentFaults as error:
        raise ScriptError([str(fault) for fault in error.faults]) from error
    faults: list[str] = []
    for sequence, station in dict.fromkeys((job.sequence, job.station) for job in queue.value.jobs):
        try:
            faults += [str(fault) for fault in plan(*load(sequence, station)).faults]
        except ScriptError as error:
            faults += error.faults
    if faults:
        raise ScriptError(list(dict.fromkeys(faults)))
    return queue


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
    supervise
        Runs a worker to its end; ``supervisor.supervise`` unless told otherwise.
    """

    def __init__(
        self,
        folder: Path,
        queue: Located[Queue],
        clock: BenchClock,
        say: Callable[[str], None],
        supervise: Supervise | None = None,
    ) -> None:
        self.folder = folder.absolute()
        self._queue, self._clock, self._say = queue, clock, say
        self._supervise = supervise or self._in_a_process
        self._ends: dict[str, WorkerEnd] = {}
        self._tries: dict[str, int] = {}

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
        lock = hold_folder(self.folder)
        try:
            return self._held()
        finally:
            os.close(lock)

    def _held(self) -> dict[str, Any]:
        copy, path = self.folder / QUEUE_COPY, self.folder / JOURNAL
        clocks: dict[str, Any] = {"utc_now": self._clock.utc_now, "monotonic": self._clock.monotonic}
        if not copy.exists():
            write_whole(copy, self._queue.text)
        elif copy.read_bytes() != self._queue.text:
            raise RunFolderError(
                "This folder belongs to another queue.",
                where=str(self.folder),
                remedy="Choose another --output.",
            )
        opened = Journal.open if path.exists() else Journal.create
        with opened(path, **clocks) as journal:
            begun_s = self._replay(journal.entries)
            if not journal.entries:
                journal.append(BEGUN, queue=self._queue.value.name)
            how, why = self._work(journal, begun_s)
            journal.append(BATCH_ENDED, how=how, why=why)
        summary = {
            "schema": "starbench/batch/1",
            "queue": self._queue.value.name,
            "how": how,
            "why": why,
            "items": [self._told(item) for item in items_of(self._queue.value)],
        }
        write_whole(self.folder / SUMMARY, (json.dumps(summary, indent=1) + "\n").encode())
        return summary

    def _replay(self, entries: Sequence[Entry]) -> float:
        """Take up what has happened; return when the batch was begun, s of this process's clock."""
        now_s = self._clock.monotonic()
        for entry in entries:
            if entry.event == ITEM_BEGUN:
                key = entry.data["item"]
                self._tries[key] = self._tries.get(key, 0) + 1
            elif entry.event == ITEM_ENDED:
                self._ends[entry.data["item"]] = WorkerEnd(entry.data["how"], entry.data["why"])
        if not entries:
            return now_s
        gone = self._clock.utc_now() - datetime.fromisoformat(entries[0].utc)
        return now_s - max(0.0, gone.total_seconds())

    def _work(self, journal: Journal, begun_s: float) -> tuple[str, str]:
        stop_s = (self._queue.value.stop_after_h or float("inf")) * 3600.0
        try:
            while undone := [item for item in items_of(self._queue.value) if not self._is_done(item)]:
                at_s = self._clock.monotonic() - begun_s
                if at_s > stop_s:
                    return "stopped", f"{self._queue.value.stop_after_h:g} h are over"
                item = next((i for i in undone if i.due_s <= at_s), None)
                if item is None:
                    self._clock.sleep(min(*(i.due_s for i in undone), stop_s) - at_s + 0.01)
                    continue
                self._one(item, journal)
                if (
                    self._ends[item.key].how != "finished"
                    and self._is_done(item)
                    and item.job.on_failure == "stop"
                ):
                    return "stopped", f"{item.key} failed, and the queue says to stop then"
        except Aborted as stop:
            return "aborted", stop.reason
        failed = [key for key, end in self._ends.items() if end.how != "finished"]
        return ("finished", "") if not failed else ("failed", f"without a result: {', '.join(failed)}")

    def _is_done(self, item: Item) -> bool:
        end = self._ends.get(item.key)
        if end is None:
            return False
        return end.how == "finished" or self._tries.get(item.key, 0) >= item.job.attempts

    def _one(self, item: Item, journal: Journal) -> None:
        """Begin a run, or take it up again, and wait for its end."""
        run = self.folder / RUNS / item.key
        while run.is_dir() and is_worked_on(run):  # a worker that outlived its supervisor
            self._clock.sleep(1.0)
        if is_sealed(run):  # done, but cut off before that was told
            self._end(item, WorkerEnd("finished", ""), journal)
            return
        if item.key in self._tries and item.key not in self._ends:  # its worker and we died: nobody made safe
            for fault in make_safe_after(run, self._clock):
                self._say(f"CHECK THE BENCH: {fault}")
        _set_aside_unbegun(run)
        words = item.words(run)
        self._tries[item.key] = self._tries.get(item.key, 0) + 1
        journal.append(ITEM_BEGUN, item=item.key, words=words, attempt=self._tries[item.key])
        self._say(f"{item.key}: {'begun' if words[0] == 'run' else 'taken up again'}")
        self._end(item, self._supervise(words, run, self.folder / RUNS / f"{item.key}.log"), journal)

    def _end(self, item: Item, end: WorkerEnd, journal: Journal) -> None:
        journal.append(ITEM_ENDED, item=item.key, **asdict(end))
        self._ends[item.key] = end
        self._say(f"{item.key}: {end.how}{': ' if end.why else ''}{end.why}")

    def _told(self, item: Item) -> dict[str, Any]:
        end = self._ends.get(item.key)
        return {
            "item": item.key,
            "folder": str(self.folder / RUNS / item.key),
            "how": end.how if end else "not begun",
            "why": end.why if end else "",
            "attempts": self._tries.get(item.key, 0),
        }

    def _in_a_process(self, words: Sequence[str], run: Path, log: Path) -> WorkerEnd:
        return supervise([sys.executable, "-m", "bench", *words], run, log, self._clock, self._say)


def _set_aside_unbegun(run: Path) -> None:
    """Keep, under another name, what a run left that was cut off before its first line: it cannot be taken up."""
    if not run.is_dir() or ((run / JOURNAL).exists() and read_journal(run / JOURNAL)[0]):
        return
    number = 1
    while (aside := run.with_name(f"{run.name}.unbegun-{number}")).exists():
        number += 1
    with storing(run):
        run.rename(aside)
        sync_folder(run.parent)
