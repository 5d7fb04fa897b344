"""Commands of operators to a run under way, from another terminal or a program: hold, release, abort, skip, answer.

A command is one JSON file, written whole into ``control/`` of the run folder. A thread of the run looks there, decides,
journals what it decided and removes the file; so the journal is the answer, and a command is never taken twice.
``abort`` goes to the clock at once, past the queue of the work; the rest is done at the next safe point, by the
runner. Who holds a run owns it until the release: others are refused, but for ``abort``, which nobody is refused.
Knows no devices.
"""

from __future__ import annotations

import getpass
import shutil
import socket
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from bench.base.clock import BenchClock
from bench.base.errors import RunFolderError, StorageError
from bench.records.events import Event
from bench.records.folder_lock import is_locked
from bench.records.history import History
from bench.records.inbox import Inbox, Poller
from bench.records.journal import lines_after
from bench.records.run_folder import JOURNAL
from bench.records.run_log import RunLog
from bench.records.storage import make_folder, storage_errors, sync_folder
from bench.run.heartbeat import CONTROL, HEARTBEAT
from sequences.schema import Answer

POLL_S = 0.1
_MAX_BYTES = 4096
_PATIENCE_S = 10.0

Word = Literal["hold", "release", "abort", "skip", "answer"]
Line = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]


class Command(BaseModel):
    """What an operator wants of a run.

    Attributes
    ----------
    id
        Its own; the journal answers by it.
    word
        What is wanted.
    by
        Who wants it.
    pose
        Which pose to skip; None for the one at work.
    answer
        To the question a run asks: ``continue`` or ``abort``.
    take_over
        Whether to become the owner of a run that somebody else holds.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    format: Literal["starbench/command/1"] = "starbench/command/1"
    id: Line = Field(default_factory=lambda: uuid.uuid4().hex)
    word: Word
    by: Line
    pose: Annotated[int, Field(ge=1)] | None = None
    answer: Answer | None = None
    take_over: bool = False

    @model_validator(mode="after")
    def _answers(self) -> Command:
        if (self.word == "answer") != (self.answer is not None):
            raise ValueError("an answer, and nothing else, says continue or abort")
        return self


def operator_at_terminal() -> str:
    """Name the person at this terminal: ``user@machine``."""
    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # no such user in the system's list, as in a container
        user = "somebody"
    return f"{user}@{socket.gethostname()}"


def refusal(command: Command, history: History, poses: Mapping[int, str]) -> str:
    """Say why a command is not taken; empty when it is.

    Parameters
    ----------
    command
        With its pose filled in.
    history
        The run so far.
    poses
        Names of the poses to record, by index.
    """
    if command.word == "abort":
        return ""
    if history.holder not in {"", command.by} and not command.take_over:
        return f"the run is held by {history.holder}; --take-over makes you its owner"
    if command.word == "answer":
        return "" if history.question and history.answer is None else "nothing is asked"
    if command.word == "release" and not history.holder:
        return "nobody holds the run"
    return _skip_refusal(command.pose, history, poses) if command.word == "skip" else ""


def _skip_refusal(pose: int | None, history: History, poses: Mapping[int, str]) -> str:
    if pose is None:
        return "no pose is at work; name the one to skip"
    if pose not in poses:
        return f"there is no pose {pose}; they are 1 to {max(poses, default=0)}"
    if pose in history.accepted():
        return f"pose {pose} ({poses[pose]}) is recorded already, and counts"
    return f"pose {pose} ({poses[pose]}) is skipped already" if pose in history.to_skip else ""


class CommandInbox:
    """The commands to this process's run: answered from ``open`` to ``close`` by a thread of its own.

    Parameters
    ----------
    folder
        The run folder, locked by this process.
    log
        Where decisions are written; runner and status act on them.
    poses
        Names of the poses to record, by index.
    clock
        Is asked to stop by ``abort``, and to fail when the journal does not take a decision.
    looks
        What else must be done in every round: signs of life, interlocks.
    """

    def __init__(
        self,
        folder: Path,
        log: RunLog,
        poses: Mapping[int, str],
        clock: BenchClock,
        looks: Sequence[Callable[[], None]] = (),
    ) -> None:
        self._inbox = _inbox_of(folder)
        self._log = log
        self._poses = poses
        self._clock = clock
        self._looks = looks
        # An error there: nobody commands or guards the run any more, so it must not go on.
        self._poller = Poller(self._look, clock.request_failure, name="commands", period_s=POLL_S)

    @property
    def closed(self) -> bool:
        """Whether commands are no longer taken."""
        return self._poller.closed

    def open(self) -> Self:
        """Begin to take commands. Commands to a process that has died are answered, and not done.

        Returns
        -------
        CommandInbox
            This inbox.

        Raises
        ------
        StorageError
            When the folder cannot be made, or an answer cannot be written.
        """
        make_folder(self._inbox.folder)
        self._drain("it was meant for a process that has died")
        self._poller.start()
        return self

    def close(self) -> None:
        """Take no more commands, answer those that remain, and remove the inbox. A second call does nothing."""
        if self.closed:
            return
        self._poller.close()
        self._drain("the run was ending")
        remove_inbox(self._inbox.folder.parent)

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _look(self) -> None:
        self._drain("")
        for look in self._looks:
            look()

    def _drain(self, why_not: str) -> None:
        self._inbox.drain(lambda command, name: self.decide(command, name, why_not))

    def decide(self, command: Command | None, name: str, why_not: str = "") -> None:
        """Decide on a command and write the decision to the journal.

        Parameters
        ----------
        command
            The command; None for a file that is not one.
        name
            Name of its file.
        why_not
            Why it is not taken, whatever it says; empty if that depends on the command.
        """
        if command is None:
            self._log.write(Event.COMMANDED, id=name, word="unknown", taken=False, why="it is no command")
            return
        with self._log.held() as history:
            if command.word == "skip" and command.pose is None:
                command = command.model_copy(update={"pose": history.at_pose})
            why_not = why_not or refusal(command, history, self._poses)
            said = command.model_dump(exclude={"format"})
            self._log.write(Event.COMMANDED, **said, taken=not why_not, why=why_not)
        if command.word == "abort" and not why_not:
            self._clock.request_stop(f"abort by {command.by}")


def _inbox_of(folder: Path) -> Inbox[Command]:
    return Inbox(folder / CONTROL, Command, _MAX_BYTES, ignored=frozenset({HEARTBEAT}))


def remove_inbox(folder: Path) -> None:
    """Remove the inbox of a run that takes no more commands; before a seal there must be none."""
    path = folder / CONTROL
    with storage_errors(path):
        for _ in range(10):  # a command may arrive while the folder is being emptied
            if not path.exists():
                return
            shutil.rmtree(path, ignore_errors=True)
        shutil.rmtree(path)
        sync_folder(folder)


def send(folder: Path, command: Command, *, patience_s: float = _PATIENCE_S) -> dict[str, Any]:
    """Give a command to a run under way, and wait for its answer.

    Parameters
    ----------
    folder
        The run folder.
    command
        What is wanted.
    patience_s
        How long to wait for the answer, s.

    Returns
    -------
    dict
        The journal's answer: ``word by pose taken why``.

    Raises
    ------
    RunFolderError
        When no process works on the run, or it ended, or did not answer in time; the command is then taken back.
    StorageError
        When it cannot be written.
    """
    inbox = _inbox_of(folder)
    if not is_locked(folder) or not inbox.folder.is_dir():
        raise RunFolderError(
            "No process works on this run.",
            where=str(folder),
            remedy="See `starbench status`; a run that was cut off goes on with `starbench resume`.",
        )
    with storage_errors(folder):
        begin = (
            (folder / JOURNAL).stat().st_size
        )  # the answer comes after it; long journals are not read again
    try:
        path = inbox.drop(command, command.id)
    except StorageError as error:
        if inbox.folder.is_dir():
            raise
        raise RunFolderError(
            "The run was ending: it takes no more commands.",
            where=str(folder),
            remedy="See `starbench status`.",
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
    raise RunFolderError(
        f"The run did not answer within {patience_s:g} s; the command was taken back.",
        where=str(folder),
        remedy="See `starbench status`. A process that hangs is ended by a signal (SIGTERM).",
    )


def _answer_in(folder: Path, command_id: str, begin: int) -> dict[str, Any] | None:
    told = lines_after(folder / JOURNAL, begin)
    answers = (data for event, data in told if event == Event.COMMANDED and data.get("id") == command_id)
    return next(answers, None)


def command_text(answer: Mapping[str, Any]) -> str:
    """Say what became of a command.

    Examples
    --------
    >>> command_text({"word": "hold", "taken": False, "why": "the run is held by ada@lab"})
    'Not taken: the run is held by ada@lab.'
    """
    if not answer["taken"]:
        return f"Not taken: {answer['why']}."
    return {
        "hold": "Taken: the run holds at its next safe point, with the light off, until `starbench release`.",
        "release": "Taken: the run goes on.",
        "abort": "Taken: the run ends now, safely; it can be resumed.",
        "answer": f"Taken: {answer.get('answer')}.",
        "skip": f"Taken: pose {answer.get('pose')} is skipped.",
    }[answer["word"]]
