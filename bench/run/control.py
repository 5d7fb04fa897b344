"""Commands from operators to a running run, from another terminal or a program: hold, release, abort, skip, answer.

A command is one JSON file, written whole into ``control/``; a thread journals the decision, then removes the file.
``abort`` goes to the clock at once, the others wait for the next safe point. Who holds a run owns it until the release.
"""

from __future__ import annotations

import getpass
import shutil
import socket
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal, Self, cast

from pydantic import BaseModel, ConfigDict, Field, model_validator

from bench.base.clock import BenchClock
from bench.base.errors import RunFolderError, StorageError
from bench.base.pasteable import pasteable
from bench.record import events
from bench.record.events import Commanded, Event
from bench.record.folder_lock import is_locked, resume_process, suspended_process
from bench.record.history import History
from bench.record.inbox import Inbox, KnownBy, MessageId, Poller
from bench.record.journal import lines_after
from bench.record.run_folder import JOURNAL, MANIFEST
from bench.record.run_log import RunLog
from bench.record.storage import make_folder, storage_errors
from bench.record.stored_run import StoredRun
from bench.run.heartbeat import CONTROL, HEARTBEAT
from bench.run.last_view import LAST_VIEW
from drivers.durable import sync_folder
from sequences.schema import Answer

POLL_S = 0.1  # A person at a terminal does not notice it
_MAX_BYTES = 4096  # A command has some hundred
_PATIENCE_S = 10.0  # A run answers between two polls, also on a busy computer

_ASK_OR_END = "If the process does not respond at all, end it by the signal SIGTERM. See what it does: {}"

Word = Literal["hold", "release", "abort", "skip", "answer"]
Line = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]


class Command(BaseModel):
    """Command of an operator to a run."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    format: Literal["starbench/command/1"] = "starbench/command/1"
    # Unique name of the command; the journal's answer carries it.
    id: MessageId = Field(default_factory=lambda: uuid.uuid4().hex)
    word: Word
    by: Line
    known_by: KnownBy = "typed"
    pose: Annotated[int, Field(ge=1)] | None = None  # Pose to skip; None for the current one
    answer: Answer | None = None  # Answer to the question of the run: ``continue`` or ``abort``
    take_over: bool = False  # Whether to become the owner of a run that another operator holds

    @model_validator(mode="after")
    def _answers(self) -> Command:
        if (self.word == "answer") != (self.answer is not None):
            raise ValueError("the command `answer`, and no other, needs an answer: continue or abort")
        return self


def operator_at_terminal() -> str:
    """Return ``user@host`` of the person at this terminal."""
    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # no such user in the system's list, as in a container
        user = "somebody"
    return f"{user}@{socket.gethostname()}"


def refusal(command: Command, history: History, poses: Mapping[int, str]) -> str:
    """Return why a command is refused, once ``pose`` of ``skip`` is filled in; empty if it is accepted."""
    if command.word == "abort":
        return ""
    if history.holder not in {"", command.by} and not command.take_over:
        return f"the run is held by {history.holder}; --take-over makes you its owner"
    if command.word == "answer":
        return "" if history.question and history.answer is None else "the run asks no question"
    if command.word == "release" and not history.holder:
        return "no operator holds the run"
    return _skip_refusal(command.pose, history, poses) if command.word == "skip" else ""


def _skip_refusal(pose: int | None, history: History, poses: Mapping[int, str]) -> str:
    if pose is None:
        return "no pose is at work; give the number of the pose to skip"
    if pose not in poses:
        return f"there is no pose {pose}; the poses are 1 to {max(poses, default=0)}"
    if pose in history.accepted():
        return f"pose {pose} ({poses[pose]}) is already recorded and accepted"
    return f"pose {pose} ({poses[pose]}) is already skipped" if pose in history.to_skip else ""


class CommandInbox:
    """Answers commands in a thread from ``open`` to ``close``; a decision that cannot be journaled fails the run."""

    def __init__(
        self,
        folder: Path,
        log: RunLog,
        poses: Mapping[int, str],
        clock: BenchClock,
        round_tasks: Sequence[Callable[[], None]] = (),
    ) -> None:
        self._inbox = inbox_of(folder)
        self._log = log
        self._poses = poses
        self._clock = clock
        self._round_tasks = round_tasks
        # After an error in this thread nothing guards the run any more, so the run must not continue.
        self._poller = Poller(self._do_round, clock.request_failure, name="commands", period_s=POLL_S)

    @property
    def closed(self) -> bool:
        """Whether commands are no longer taken."""
        return self._poller.closed

    def open(self) -> Self:
        """Begin to accept commands. Commands to an earlier process that has died are refused."""
        make_folder(self._inbox.folder)
        self._drain("it was sent to a process that has died")
        self._poller.start()
        return self

    def close(self) -> None:
        """Stop accepting commands, refuse the remaining ones, and remove the inbox. A second call does nothing."""
        if self.closed:
            return
        self._poller.close()
        self._drain("the run was ending")
        remove_inbox(self._inbox.folder.parent)

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _do_round(self) -> None:
        self._drain("")
        for task in self._round_tasks:
            task()

    def _drain(self, why_not: str) -> None:
        self._inbox.drain(lambda command, name: self.decide(command, name, why_not))

    def decide(self, command: Command | None, name: str, why_not: str = "") -> None:
        """Decide on a command (None: the file holds none) and journal it; ``why_not`` refuses any command."""
        if command is None:
            self._log.write(events.Commanded, id=name, word="unknown", taken=False, why="it is not a command")
            return
        with self._log.held() as history:
            if command.word == "skip" and command.pose is None:
                command = command.model_copy(update={"pose": history.at_pose})
            why_not = why_not or refusal(command, history, self._poses)
            if command.word == "abort" and not why_not:  # a stop does not wait for the disk
                self._clock.request_stop(f"abort by {command.by}")
            fields = command.model_dump(exclude={"format"})
            self._log.write(events.Commanded, **fields, taken=not why_not, why=why_not)


def inbox_of(folder: Path) -> Inbox[Command]:
    """Return the inbox of a run's commands, which ignores what else stands in its folder."""
    return Inbox(folder / CONTROL, Command, _MAX_BYTES, ignored=frozenset({HEARTBEAT, LAST_VIEW}))


def remove_inbox(folder: Path) -> None:
    """Remove the inbox of a run that accepts no more commands. A sealed run folder must not contain one."""
    path = folder / CONTROL
    with storage_errors(path):
        for _ in range(10):  # a command may arrive while the folder is being emptied
            if not path.exists():
                return
            shutil.rmtree(path, ignore_errors=True)
        shutil.rmtree(path)
        sync_folder(folder)


def send(folder: Path, command: Command, *, patience_s: float = _PATIENCE_S) -> Commanded:
    """Send a command and return its answer in the journal, ``word by pose taken why``; withdraw it if none comes."""
    inbox = inbox_of(folder)
    if not is_locked(folder) or not inbox.folder.is_dir():
        raise _nothing_to_tell(folder)
    with storage_errors(folder):
        begin = (folder / JOURNAL).stat().st_size  # the answer comes after this place
    try:
        path = inbox.drop(command, command.id)
    except StorageError as error:
        if inbox.folder.is_dir():
            raise
        raise RunFolderError(
            "The run is ending and accepts no more commands.",
            where=str(folder),
            remedy=f"See what it does: {pasteable('status', folder)}",
        ) from error
    deadline = time.monotonic() + patience_s
    while time.monotonic() < deadline:
        answer = _answer_in(folder, command.id, begin)
        if answer is not None:
            return answer
        if not path.exists() and not is_locked(folder):
            break
        time.sleep(POLL_S)
    path.unlink(missing_ok=True)
    answer = _answer_in(folder, command.id, begin)  # it may have come at the last moment
    if answer is not None:
        return answer
    suspended = suspended_process(folder)
    raise RunFolderError(
        f"The run did not answer within {patience_s:g} s; the command was withdrawn.",
        where=str(folder),
        remedy=resume_process(suspended) if suspended else _ASK_OR_END.format(pasteable("status", folder)),
    )


def _nothing_to_tell(folder: Path) -> RunFolderError:
    """Return why no process works on a run, and what to do."""
    if (folder / MANIFEST).is_file() and StoredRun(folder).history.ended == "finished":
        return RunFolderError(
            "The run has finished, so it takes no more commands.",
            where=str(folder),
            remedy=f"See its result: {pasteable('status', folder)}",
        )
    return RunFolderError(
        "No process works on this run.",
        where=str(folder),
        remedy=f"To see where it stands: {pasteable('status', folder)}. To continue it: {pasteable('resume', folder)}",
    )


def _answer_in(folder: Path, command_id: str, begin: int) -> Commanded | None:
    lines = lines_after(folder / JOURNAL, begin)
    answers = (data for event, data in lines if event == Event.COMMANDED and data.get("id") == command_id)
    return cast("Commanded | None", next(answers, None))


def command_text(answer: Commanded, folder: Path) -> str:
    """Return what happened to a command to the run of a folder, by the answer of `send`, as a sentence.

    >>> command_text({"word": "hold", "taken": False, "why": "the run is held by ada@lab"}, Path("run"))
    'Refused: the run is held by ada@lab.'
    """
    if not answer["taken"]:
        return f"Refused: {answer['why']}."
    return {
        "hold": "Accepted: the run holds at its next safe point, with the light off, until "
        f"`{pasteable('tell', folder, 'release')}`.",
        "release": "Accepted: the run continues.",
        "abort": "Accepted: the run ends now, safely. It can be resumed.",
        "answer": f"Accepted: {answer.get('answer')}.",
        "skip": f"Accepted: pose {answer.get('pose')} is skipped.",
    }[answer["word"]]
