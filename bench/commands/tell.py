"""The command `tell`: what an operator tells a run or a batch from another terminal, and its answer."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.base.errors import UsageError
from bench.commands.options import OPERATOR, ExistingFile, ExistingFolder, RunFolder, epilog, status_text
from bench.commands.output import JSON, show

if TYPE_CHECKING:
    from bench.batch.batch_requests import Request
    from bench.records.inbox import KnownBy
    from bench.run.control import Command

_ANSWERS = {"yes": "continue", "no": "abort"}
_VALUES = {"skip": "the number of a pose", "add": "the file of a job", "withdraw": "the name of a job"}
"""What stands behind a word; it may be left out for ``skip``."""
_OF_BATCH = ("add", "withdraw")


class _Told(ExistingFolder):
    """The folder of a run or of a batch."""

    def check(self, path: Path) -> None:
        """Nothing: what the folder must be is known when the word is."""


@click.command(
    epilog=epilog(
        "starbench tell runs/cam7 hold",
        "starbench tell runs/cam7 release --take-over",
        "starbench tell runs/cam7 skip 4",
        "starbench tell runs/cam7 yes",
        "starbench tell runs/night add job.yaml",
        status=status_text("0 accepted, 1 refused{invalid}{ctrl_c}"),
    )
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
    pose = None if value is None else click.IntRange(1)(value)
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
    return _show_answer(answer, command_text(answer))


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
