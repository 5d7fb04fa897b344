"""The commands `status`, `tell` and `messages`: what another terminal sees of a run or a batch, and says to it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from bench.base.clock import BenchClock
from bench.base.errors import UsageError
from bench.base.home import home_folder
from bench.base.lost_output import output_is_lost
from bench.commands.options import (
    OPERATOR,
    ExistingFile,
    ExistingFolder,
    RunFolder,
    command,
    status_text,
)
from bench.commands.output import JSON, STOPPED, show, wants_json
from bench.commands.values import WholeNumber
from bench.record.folder_lock import is_locked
from bench.record.run_folder import JOURNAL
from bench.record.storage import storage_errors
from bench.run.status import Status, head_lines, line_text, read_status, read_with_entries

if TYPE_CHECKING:
    from bench.batch.batch_requests import Request
    from bench.batch.batch_status import BatchStatus
    from bench.record.inbox import KnownBy
    from bench.run.control import Command
    from bench.run.messages.outbox import Delivery

_ANSWERS = {"yes": "continue", "no": "abort"}
_VALUES = {"skip": "the number of a pose", "add": "the file of a job", "withdraw": "the name of a job"}
"""What stands behind a word; it may be left out for ``skip``."""
_OF_BATCH = ("add", "withdraw")
FOLLOW_S = 0.5  # A person sees a change at once, and a disk is hardly read
_READING_SHARE = 4.0
"""A follower waits at least this many times as long as it read the journal, so that it takes little of a computer."""

_INTERRUPTED = 130  # 128 + SIGINT, as shells have it
_NOT_READ = 128 + 13
"""Exit status of `status --follow` whose output nobody reads any more: that of SIGPIPE."""
_ENDED = {"finished": 0, "aborted": STOPPED}


class _Told(ExistingFolder):
    """The folder of a run or of a batch."""

    def check(self, path: Path) -> None:
        """Nothing: what the folder must be is known when the word is."""


@command(
    "starbench tell runs/cam7 hold",
    "starbench tell runs/cam7 release --take-over",
    "starbench tell runs/cam7 skip 4",
    "starbench tell runs/cam7 yes",
    "starbench tell runs/night add job.yaml",
    status=status_text("0 accepted, 1 refused{invalid}{ctrl_c}"),
)
@click.argument("folder", metavar="FOLDER", type=_Told())
@click.argument("word", type=click.Choice(["hold", "release", "skip", "abort", "yes", "no", *_OF_BATCH]))
@click.argument("value", required=False)
@OPERATOR
@click.option("--take-over", is_flag=True, help="Do it even if another person holds the run.")
@JSON
def tell(folder: Path, word: str, value: str | None, by: str | None, take_over: bool) -> int:
    """Tell the run or the batch in FOLDER what to do; also possible while it works.

    \b
    A run:
      hold           hold at the next safe point, with the light off; you hold it until the release
      release        let a held run continue
      skip [POSE]    skip a pose, the current one if no number is given; its recordings are kept
      abort          end the run now, safely; anyone may do this, and the run can be resumed
      yes, no        answer the question that the run asks: continue, or abort
    A batch:
      add JOB        add the job in the file JOB
      withdraw NAME  begin no further run of the job NAME
    """  # noqa: D301 - click keeps the lines of a paragraph that begins with this character
    needs = _VALUES.get(word)
    if needs and value is None and word != "skip":
        raise click.UsageError(f"`{word}` needs {needs}.")
    if value is not None and not needs:
        raise click.UsageError(f"`{word}` takes no value, and {value!r} is given.")
    if word in _OF_BATCH:
        assert value is not None
        return _tell_batch(folder, word, value, by)
    RunFolder().check(folder)
    pose = None if value is None else WholeNumber(1)(value)
    return _tell_run(
        folder,
        {
            "word": "answer" if word in _ANSWERS else word,
            "answer": _ANSWERS.get(word),
            "pose": pose,
            "take_over": take_over,
        },
        by,
    )


def _tell_run(folder: Path, words: Mapping[str, Any], by: str | None) -> int:
    from pydantic import ValidationError

    from bench.run.control import Command, command_text, operator_at_terminal, send

    try:
        command: Command = Command.model_validate(
            {"by": by or operator_at_terminal(), "known_by": "typed" if by else "file mode", **words}
        )
    except ValidationError as error:
        raise UsageError(
            f"--operator: {error.errors()[0]['msg']}.",
            remedy="Give a name of one line and at most 200 characters.",
        ) from error
    answer = send(folder, command)
    return _show_answer(answer, command_text(answer, folder))


def _tell_batch(folder: Path, word: str, value: str, by: str | None) -> int:
    from bench.batch.batch_plan import read_job
    from bench.batch.batch_requests import Request, answer_text, send_request
    from bench.run.control import operator_at_terminal

    who = by or operator_at_terminal()
    known_by: KnownBy = "typed" if by else "file mode"
    request: Request
    if word == "add":
        ExistingFile().check(Path(value))
        request = Request(word="add", by=who, known_by=known_by, job=read_job(Path(value)))
    else:
        request = Request(word="withdraw", by=who, known_by=known_by, name=value)
    answer = send_request(folder, request)
    return _show_answer(answer or {"taken": None, "why": "not answered yet"}, answer_text(answer))


def _show_answer(answer: Mapping[str, Any], text: str) -> int:
    """Print an answer, on standard error where the word was refused; return 1 then."""
    refused = answer["taken"] is False
    show({"schema": "starbench/answer/1", **answer}, text, err=refused)
    return int(refused)


@command(
    "starbench messages",
    "starbench messages --send",
    status=status_text("0 messages shown, 1 a message is not sent after --send{invalid}{ctrl_c}"),
)
@click.option("--send", "send_now", is_flag=True, help="Try now to send all that was not sent.")
@JSON
def messages(send_now: bool) -> int:
    """List the messages of this bench: those that were sent, that wait, and that were given up."""
    from bench.run.messages.channels import send
    from bench.run.messages.outbox import Outbox

    outbox = Outbox(home_folder())
    if send_now:
        outbox.deliver(send, BenchClock().utc_now, by_hand=True)
    deliveries = outbox.deliveries()
    show(
        {
            "schema": "starbench/messages/1",
            "messages": [{**delivery.to_dict(), "state": state} for state, delivery in deliveries],
        },
        _lines(deliveries),
    )
    return 1 if send_now and outbox.unsent() else 0


def _lines(deliveries: Sequence[tuple[str, Delivery]]) -> Iterator[str]:
    for state, delivery in deliveries:
        marks = f", {delivery.tries} tries" if delivery.tries > 1 else ""
        marks += ", perhaps sent twice" if delivery.perhaps_twice else ""
        marks += f"; {delivery.last_error}" if delivery.last_error else ""
        written, subject = delivery.message.utc[:16].replace("T", " "), delivery.message.subject
        yield f"{written}  {delivery.channel.kind:<7} {state:<7}  {subject}{marks}"
    if not deliveries:
        yield "No messages."


def follow(
    folder: Path,
    sleep: Callable[[float], None] = time.sleep,
    *,
    ticks: bool = False,
    monotonic: Callable[[], float] = time.monotonic,
) -> Iterator[tuple[Status, Sequence[str]]]:
    """Yield the status of a run, and the new lines of its journal as text, after every change.

    With ``ticks`` it also yields the status without a change. The first lines are the last ones of the status. It ends
    when no process works on the run any more.
    """
    seen, shown, pause_s = -1, -1, FOLLOW_S
    while True:
        with storage_errors(folder):
            size = (folder / JOURNAL).stat().st_size
        if size != seen or not is_locked(folder):
            began_s = monotonic()
            (status, entries), seen = read_with_entries(folder, datetime.now(UTC)), size
            read_s = monotonic()
            pause_s = max(FOLLOW_S, _READING_SHARE * (read_s - began_s))
            yield (
                status,
                status.last if shown < 0 else [text for text in map(line_text, entries[shown:]) if text],
            )
            shown = len(entries)
            if not status.running:
                return
        elif ticks:
            yield _counted_down(status, monotonic() - read_s), ()
        sleep(pause_s)


def _counted_down(status: Status, since_s: float) -> Status:
    """Return a status with the time counted down that has passed since it was read; a held run has no such time."""
    if status.left_s is None or status.held_by or status.question:
        return status
    return replace(status, left_s=max(0.0, status.left_s - since_s))


@command(
    "starbench status runs/cam7 --follow",
    "starbench status runs/night",
    status=status_text(
        "0 status shown{invalid}{ctrl_c} With --follow that of the run: 0 done, 1 failed, 3 stopped."
    ),
)
@click.argument("run_folder", metavar="RUN", type=RunFolder(batch=True))
@click.option("--follow", is_flag=True, help="Follow the run until it ends, and return its exit status.")
@click.option("--summary", is_flag=True, help="Of a batch: write its summary page now, and show it.")
@JSON
def status(run_folder: Path, follow: bool, summary: bool) -> int:
    """Show the status of a RUN or a batch. Can be used at any time, also during the run, and changes nothing in it."""
    from bench.record.run_index import is_batch

    of_batch = is_batch(run_folder)
    if summary:
        return _summarise(run_folder)
    if not follow:
        return _show_batch(run_folder) if of_batch else _show_run(run_folder)
    try:
        ended = _follow(run_folder, of_batch=of_batch)
    except KeyboardInterrupt:
        noun = "batch" if of_batch else "run"
        click.echo(f"\nNo longer following. The {noun} is not affected.", err=True)
        return _INTERRUPTED
    return _NOT_READ if output_is_lost() else _ENDED.get(ended, 1)


def _summarise(folder: Path) -> int:
    """Write and print the current summary of a batch."""
    from bench.batch.batch_summary import read_batch, write_summary
    from bench.commands.batch import show_summary

    return show_summary(folder, write_summary(folder, read_batch(folder)))


def _show_run(folder: Path) -> int:
    from bench.run.status import status_text as text_of

    status = read_status(folder)
    show(status.to_dict, text_of(status))
    return 0


def _show_batch(folder: Path) -> int:
    from bench.batch.batch_status import batch_status_text, read_batch_status

    batch_status = read_batch_status(folder)
    show(batch_status.to_dict, batch_status_text(batch_status))
    return 0


class _Shown(NamedTuple):
    """A status that is followed."""

    status: Status | BatchStatus
    block: tuple[Sequence[str], Sequence[str], Sequence[str]]  # As `Block.draw` takes it
    new: Sequence[str]  # Lines that the status before did not have


def _follow(folder: Path, *, of_batch: bool) -> str:
    """Follow a run or a batch; return how it ended, empty if it was interrupted."""
    from bench.base.text_block import Block

    block, as_json = Block(), wants_json()
    redraws = block.can_redraw and not as_json
    for shown in (_batch_shown if of_batch else _run_shown)(folder, ticks=redraws):
        if as_json:
            click.echo(json.dumps(shown.status.to_dict(), allow_nan=False))
        elif redraws:
            block.draw(*shown.block)
        elif shown.new:
            click.echo("\n".join(shown.new))
        if output_is_lost():
            break
    return shown.status.ended


def _run_shown(folder: Path, *, ticks: bool) -> Iterator[_Shown]:
    """Yield a run's status; its head is new at the begin and at the end."""
    advice = ""
    for now, lines in follow(folder, ticks=ticks):
        head, tail = head_lines(now), [now.advice]
        new = [*(head if not advice or not now.running else ()), *(f"  {line}" for line in lines)]
        yield _Shown(
            now,
            (head, [f"  {line}" for line in now.last], tail),
            new if now.advice == advice else [*new, *tail],
        )
        advice = now.advice


def _batch_shown(folder: Path, *, ticks: bool) -> Iterator[_Shown]:
    """Yield a batch's status."""
    from bench.batch.batch_status import batch_status_text, follow_batch

    before: list[str] = []
    for now in follow_batch(folder, ticks=ticks):
        lines = batch_status_text(now).splitlines()
        yield _Shown(now, (lines[:1], [], lines[1:]), [line for line in lines if line not in before])
        before = lines
