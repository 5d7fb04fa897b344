"""Questions to the operator: answered at this terminal or from another, or by their default once their time is up."""

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
    """``word`` is ``continue`` or ``abort``; ``by`` says who gave it: operator, a name, or time-out."""

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
    elsewhere: Callable[[], Reply | None] = lambda: None,
) -> Reply:
    """Ask and wait.

    Parameters
    ----------
    text
        The question.
    default
        The answer that counts when nobody answers in time.
    timeout_s
        How long to wait.
    clock
        Waits go through it, so a stop ends the question.
    say
        Shows a line to the operator.
    terminal
        Where answers come from; standard input by default. Where it is no terminal, they only come from elsewhere.
    elsewhere
        Gives the answer from another terminal (`starbench answer`), once there is one.
    """
    source = sys.stdin if terminal is None else terminal
    here = source.isatty()
    how = "[c]ontinue / [a]bort" if here else "`starbench answer`"
    say(f"{text}  {how}, {default} after {timeout_s:g} s:")
    deadline = clock.monotonic() + timeout_s
    while clock.monotonic() < deadline:
        if (reply := elsewhere()) is not None:
            say(f"{reply.by}: {reply.word}")
            return reply
        if here and select.select([source], [], [], 0)[0]:
            word = source.readline().strip().lower()
            if word in _YES | _NO:
                return Reply("abort" if word in _NO else "continue", "operator")
            say("Please answer c or a.")
        clock.sleep(_POLL_S)
    return Reply(default, "time-out")
