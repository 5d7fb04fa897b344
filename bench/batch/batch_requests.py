"""Requests to a batch from another terminal: add a job, withdraw a job.

A request is one file, written atomically into ``requests/`` of the batch's folder. It stays there until
it is answered, even while no process works on the batch. The batch decides, records the decision in its
journal and then removes the file. The journal is therefore the answer, and no request is answered twice.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from bench.base.clock import BenchClock
from bench.base.errors import BenchError, RunFolderError
from bench.batch.batch_plan import job_faults
from bench.batch.batch_record import BatchEvent, BatchRecord, Requested
from bench.record.folder_lock import is_locked
from bench.record.inbox import Inbox, KnownBy, MessageId, Poller
from bench.record.journal import read_journal
from bench.record.run_folder import JOURNAL
from bench.record.run_index import require_batch
from bench.record.storage import make_folder
from bench.record.stored_run import StoredRun
from sequences.queue import JobConfig, Key

REQUESTS = "requests"
POLL_S = 0.2  # A person at a terminal does not notice it
_PATIENCE_S = 15.0  # A batch answers between two looks, also on a busy computer
_MAX_BYTES = 16_384  # A job of a queue has some hundred

Word = Literal["add", "withdraw"]


class Request(BaseModel):
    """An operator's request to a batch."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal["starbench/request/1"] = "starbench/request/1"
    # Unique id; the answer in the journal has the same id.
    id: MessageId = Field(default_factory=lambda: uuid.uuid4().hex)
    word: Word
    by: str = Field(min_length=1, max_length=200)
    known_by: KnownBy = "typed"
    job: JobConfig | None = None
    name: Key | None = None

    @model_validator(mode="after")
    def _complete(self) -> Request:
        if (self.job is None) is (self.word == "add") or (self.name is None) is (self.word == "withdraw"):
            raise ValueError("add needs a job, withdraw needs a name")
        return self


def refusal(request: Request, record: BatchRecord) -> str:
    """Return why a request is refused; empty if it is accepted."""
    if request.word == "withdraw":
        assert request.name is not None
        if request.name not in record.jobs:
            return f"there is no job {request.name}"
        if record.withdrawable(request.name):
            return ""
        return f"all runs of {request.name} have begun or are withdrawn"
    assert request.job is not None
    if request.job.name.lower() in map(str.lower, record.jobs):
        return f"the batch already has or had a job {request.job.name}"
    return "; ".join(job_faults(request.job)[:3])


@contextmanager
def answered(
    folder: Path, answer: Callable[[Request | None, str], None], clock: BenchClock
) -> Iterator[None]:
    """Answer the requests to a batch in its folder, locked by this process, before the block and beside it.

    ``answer`` journals a decision on a request (None: the file holds none) in a file; if it cannot, the clock is asked
    to stop. Requests that remain wait for the next process.
    """

    def failed(error: Exception) -> None:
        if not isinstance(error, BenchError):
            raise error
        clock.request_stop(f"requests cannot be answered any more: {error}")

    inbox = _inbox_of(folder)
    poller = Poller(lambda: inbox.drain(answer), failed, name="requests", period_s=POLL_S)
    inbox.drain(answer)
    poller.start()
    try:
        yield
    finally:
        poller.close()


def _inbox_of(folder: Path) -> Inbox[Request]:
    return Inbox(folder / REQUESTS, Request, _MAX_BYTES)


def send_request(folder: Path, request: Request, *, patience_s: float = _PATIENCE_S) -> Requested | None:
    """Send a request to a batch; return the journal's answer, ``word by taken why`` and ``job`` or ``name``.

    None if no process works on the batch: the request then stays until it continues. A rehearsal that has ended takes
    none.
    """
    require_batch(folder)
    if not is_locked(folder) and StoredRun(folder).is_rehearsal:
        raise RunFolderError(
            "This batch is a rehearsal, which cannot be continued.",
            where=str(folder),
            remedy="Change the queue file, and rehearse it again.",
        )
    inbox = _inbox_of(folder)
    make_folder(inbox.folder)
    path = inbox.drop(request, request.id)
    deadline = time.monotonic() + patience_s
    while time.monotonic() < deadline and (path.exists() is False or is_locked(folder)):
        if not path.exists():
            return _answer_in(folder, request.id)
        time.sleep(POLL_S / 2)
    return None


def _answer_in(folder: Path, request_id: str) -> Requested | None:
    entries, _ = read_journal(folder / JOURNAL)
    answers = (e for e in reversed(entries) if e.event == BatchEvent.REQUESTED and e.data["id"] == request_id)
    entry = next(answers, None)
    return entry.of(Requested) if entry is not None else None


def answer_text(answer: Requested | None) -> str:
    """Describe the answer of `send_request`.

    >>> answer_text({"word": "withdraw", "name": "cam7", "taken": True, "why": ""})
    'Accepted: cam7 is withdrawn; a run in progress continues.'
    """
    if answer is None:
        return "Stored: no process works on the batch. The batch answers the request when it continues."
    if not answer["taken"]:
        return f"Refused: {answer['why']}."
    if answer["word"] == "add":
        return f"Accepted: {answer['job']['name']} is in the batch."
    return f"Accepted: {answer['name']} is withdrawn; a run in progress continues."
