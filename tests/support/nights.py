"""Batches in a test: a queue in a line, time that passes where somebody waits, workers that end as told."""

from datetime import UTC, datetime

from bench.base.clock import VirtualClock
from bench.batch.batch import Batch, worker_command
from bench.batch.supervisor import WorkerEnd
from bench.record.events import Event
from bench.record.journal import Journal
from bench.record.run_folder import RunFolder
from sequences.queue import JobConfig, Queue
from sequences.reader import check_document

BEGIN = datetime(2026, 3, 1, 20, 0, tzinfo=UTC)
JOB = "  - {{name: {}, sequence: three_pose, station: simulated{}}}\n"


def queue(*jobs, top=""):
    text = f"format: starbench/queue/1\nname: Night\n{top}jobs:\n" + "".join(JOB.format(*job) for job in jobs)
    return check_document(text.encode(), "queue.yaml", Queue)


def job_words(name, **words):
    return JobConfig(name=name, **{"sequence": "three_pose", "station": "simulated", **words})


def _nothing(_run):
    pass


class Workers:
    """Stands for the processes: ends as told, and leaves the folder a run would leave.

    ``before`` and ``after`` are called with the folder of each run.
    """

    def __init__(self, clock, *ends, before=_nothing, after=_nothing):
        self.clock, self.ends, self.begun = clock, list(ends), []
        self.before, self.after = before, after

    def __call__(self, item, run, _log):
        self.before(run)
        word = worker_command(item, run)[0]
        self.begun.append((word, run.name, self.clock.monotonic()))
        if word == "run":
            with RunFolder.create(run) as folder, Journal.create(folder.journal_path, self.clock) as journal:
                journal.append(Event.RUN_STARTED, id=run.name)
        self.clock.sleep(600.0)
        self.after(run)
        end = self.ends.pop(0) if self.ends else "finished"
        if isinstance(end, BaseException):
            raise end
        return end if isinstance(end, WorkerEnd) else WorkerEnd(end, "")


def night(folder, queue, *ends, clock=None, say=lambda _: None, before=_nothing, after=_nothing, **more):
    """A batch of a queue, and its workers."""
    clock = clock or VirtualClock(BEGIN)
    workers = Workers(clock, *ends, before=before, after=after)
    return Batch(folder, queue, clock, say, workers, **more), workers


def begun(workers):
    return [f"{word} {name}" for word, name, _ in workers.begun]


def hows(summary):
    return {item["item"]: item["how"] for item in summary["items"]}
