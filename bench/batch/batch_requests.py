"""Requests to a batch from another terminal: a job added, a job withdrawn.

A request is one file, written whole into ``requests/`` of the batch's folder; it stays until it is answered, also while
no process works on the batch. The batch decides, journals what it decided and removes the file; so the journal is
the answer, and no request is taken twice. Knows no devices.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from bench.base.clock import BenchClock
from bench.base.errors import BenchError, RunFolderError
from bench.batch.batch_plan import job_faults
from bench.batch.batch_record import BatchEvent, BatchRecord
from bench.records.folder_lock import is_locked
from bench.records.inbox import Inbox, Poller
from bench.records.journal import read_journal
from bench.records.run_folder import JOURNAL
from bench.records.run_index import QUEUE_COPY
from bench.records.storage import make_folder
from sequences.queue import JobConfig, Key

REQUESTS = "requests"
POLL_S = 0.2
_PATIENCE_S = 15.0
_MAX_BYTES = 16_384

Word = Literal["add", "withdraw"]


class Request(BaseModel):
    """What an operator wants of a batch.

    Attributes
    ----------
    id
        Its own; the journal answers by it.
    word, by
        What is wanted, and by whom.
    job
        The job to add.
    name
        The job to withdraw.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal["starbench/request/1"] = "starbench/request/1"
    id: str = Field(default_factory=lambda: uuid.uuid4().hex, min_length=1, max_length=64)
    word: Word
    by: str = Field(min_length=1, max_length=200)
    job: JobConfig | None = None
    name: Key | None = None

    @model_validator(mode="after")
    def _complete(self) -> Request:
        if (self.job is None) is (self.word == "add") or (self.name is None) is (self.word == "withdraw"):
            raise ValueError("add takes a job, withdraw a name")
        return self


def refusal(request: Request, record: BatchRecord) -> str:
    """Say why a request is not taken; empty when it is."""
    if request.word == "withdraw":
        assert request.name is not None
        if request.name not in record.jobs():
            return f"there is no job {request.name}"
        return "" if record.withdrawable(request.name) else f"no run of {request.name} is left to begin"
    assert request.job is not None
    if request.job.name.lower() in map(str.lower, record.jobs()):
        return f"the batch has a job {request.job.name}, or had one"
    return "; ".join(job_faults(request.job)[:3])


class RequestInbox:
    """Where a batch answers requests.

    Parameters
    ----------
    folder
        Folder of the batch, locked by this process.
    answer
        Decides on a request and writes the decision to the journal. It is called with None for a file that is not a
        request, and with the name of the file.
    clock
        Is asked to stop when answers cannot be written to the journal any more.
    """

    def __init__(
        self, folder: Path, answer: Callable[[Request | None, str], None], clock: BenchClock
    ) -> None:
        self._inbox = _inbox_of(folder)
        self._answer = answer
        self._clock = clock
        self._poller = Poller(self.drain, self._failed, name="requests", period_s=POLL_S)

    def drain(self) -> None:
        """Answer every request that lies there, oldest first.

        Raises
        ------
        StorageError
            When a request cannot be read or removed, or its answer cannot be written.
        """
        self._inbox.drain(self._answer)

    def watch(self) -> None:
        """Begin to answer while the batch is busy with a run."""
        self._poller.start()

    def close(self) -> None:
        """Answer no more; requests that remain wait for the next process."""
        self._poller.close()

    def _failed(self, error: Exception) -> None:
        if not isinstance(error, BenchError):
            raise error
        self._clock.request_stop(f"requests cannot be answered any more: {error}")


def _inbox_of(folder: Path) -> Inbox[Request]:
    return Inbox(folder / REQUESTS, Request, _MAX_BYTES)


def send_request(folder: Path, request: Request, *, patience_s: float = _PATIENCE_S) -> dict[str, Any] | None:
    """Leave a request with a batch, and wait for the answer where a process works on it.

    Returns
    -------
    dict or None
        The journal's answer: ``word by taken why`` and ``job`` or ``name``; None while there is none: the request
        then lies there until the batch goes on.

    Raises
    ------
    RunFolderError
        When there is no batch.
    StorageError
        When it cannot be written.
    """
    if not (folder / JOURNAL).is_file() or not (folder / QUEUE_COPY).is_file():
        raise RunFolderError(
            "There is no batch in this folder.",
            where=str(folder),
            remedy="Name the folder that `starbench batch` was given.",
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


def _answer_in(folder: Path, request_id: str) -> dict[str, Any] | None:
    entries, _ = read_journal(folder / JOURNAL)
    found = (e for e in reversed(entries) if e.event == BatchEvent.REQUESTED and e.data["id"] == request_id)
    entry = next(found, None)
    return dict(entry.data) if entry is not None else None


def answer_text(answer: dict[str, Any] | None) -> str:
    """Say what became of a request.

    Examples
    --------
    >>> answer_text({"word": "withdraw", "name": "cam7", "taken": True, "why": ""})
    'Taken: cam7 is withdrawn; a run of it that is under way goes on.'
    """
    if answer is None:
        return "Noted: no process works on the batch; it is taken up as soon as the batch goes on."
    if not answer["taken"]:
        return f"Not taken: {answer['why']}."
    if answer["word"] == "add":
        return f"Taken: {answer['job']['name']} is in the batch."
    return f"Taken: {answer['name']} is withdrawn; a run of it that is under way goes on."
