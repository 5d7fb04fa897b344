"""Questions to the operator: answered at the terminal, or by their default once their time is up."""

from __future__ import annotations

import select
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import TextIO

from bench.clock import BenchClock

_POLL_S = 0.2
_YES = {"", "c", "continue", "y", "yes"}
_NO = {"a", "abort", "n", "no"}


@dataclass(frozen=True)
class Reply:
    """``word`` is ``continue`` or ``abort``; ``by`` says who gave it: operator, time-out, or nobody there."""

    word: str
    by: str


def ask(
    text: str,
    *,
    default: str,
    timeout_s: float,
    clock: BenchClock,
    say: Callable[[str], None],
    terminal: TextIO | None = None,
) -> Reply:
    """Ask and wait.

    Parameters
    ----------
    text
        The question.
    default
        The answer that counts when nobody answers in time, or nobody is there (standard input is no terminal).
    timeout_s
        How long to wait.
    clock
        Waits go through it, so a stop ends the question.
    say
        Shows a line to the operator.
    terminal
        Where answers come from; standard input by default.
    """
    source = sys.stdin if terminal is None else terminal
    if not source.isatty():
        say(f"{text}  [no terminal: {default}]")
        return Reply(default, "nobody there")
    say(f"{text}  [c]ontinue / [a]bort, {default} after {timeout_s:g} s:")
    deadline = clock.monotonic() + timeout_s
    while clock.monotonic() < deadline:
        if select.select([source], [], [], 0)[0]:
            word = source.readline().strip().lower()
            if word in _YES | _NO:
                return Reply("abort" if word in _NO else "continue", "operator")
            say("Please answer c or a.")
        clock.sleep(_POLL_S)
    return Reply(default, "time-out")
