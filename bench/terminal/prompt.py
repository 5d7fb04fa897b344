"""Questions to the operator: answered at this terminal or from another, or by their default once their time is up.

Knows terminals, and how to see without waiting whether a line was typed: by select where it takes terminals, else (on
Windows) by a thread that reads.
"""

from __future__ import annotations

import queue
import select
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TextIO

from bench.base.clock import BenchClock

_POLL_S = 0.2
_YES = {"c", "continue", "y", "yes"}
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
        Where answers come from; standard input by default. Where it is no terminal, or has been closed, they only
        come from elsewhere. A line typed counts, an empty one as the default.
    elsewhere
        Gives the answer from another terminal (`starbench answer`), once there is one.
    """
    source = sys.stdin if terminal is None else terminal
    here = source is not None and source.isatty()  # none: a process begun without standard input
    typed = _typed(source) if here else None
    how = "[c]ontinue / [a]bort" if here else "`starbench answer`"
    say(f"{text}  {how}, {default} after {timeout_s:g} s:")
    deadline = clock.monotonic() + timeout_s
    while clock.monotonic() < deadline:
        if (reply := elsewhere()) is not None:
            say(f"{reply.by}: {reply.word}")
            return reply
        line = typed() if typed is not None else None
        if line == "":  # its end, which is nobody's answer
            say("This terminal is closed: `starbench answer` counts.")
            typed = None
        elif line is not None:
            word = line.strip().lower()
            if word in _YES | _NO | {""}:
                return Reply(default if not word else "abort" if word in _NO else "continue", "operator")
            say("Please answer c or a.")
        clock.sleep(_POLL_S)
    return Reply(default, "time-out")


def _typed(source: TextIO) -> Callable[[], str | None]:
    """Give a function that returns the next line typed: None while there is none, ``""`` at the terminal's end."""
    try:
        select.select([source], [], [], 0)
    except (OSError, ValueError):  # no terminals here, sockets alone
        return _lines_of(source)
    _forget_what_was_typed(source)
    return lambda: source.readline() if select.select([source], [], [], 0)[0] else None


def _forget_what_was_typed(source: TextIO) -> None:
    """What was typed before the question counts for nothing: a key pressed an hour ago must not confirm it."""
    with suppress(ImportError, OSError, ValueError):  # no terminal after all
        import termios

        with suppress(termios.error):
            termios.tcflush(source.fileno(), termios.TCIFLUSH)


_readers: dict[TextIO, queue.SimpleQueue[str]] = {}
"""One reader a terminal: one that waits for a line cannot be stopped, so the next question takes it over."""


def _lines_of(source: TextIO) -> Callable[[], str | None]:
    """Read a terminal in a thread of its own; what was typed before the question counts for nothing."""
    lines = _readers.get(source)
    if lines is None:
        lines = _readers[source] = queue.SimpleQueue()
        threading.Thread(target=_read, args=(source, lines), daemon=True, name="terminal").start()
    else:
        while not lines.empty():
            lines.get_nowait()

    def typed() -> str | None:
        return None if lines.empty() else lines.get_nowait()

    return typed


def _read(source: TextIO, lines: queue.SimpleQueue[str]) -> None:
    """Pass lines on until the terminal ends."""
    while True:
        try:
            line = source.readline()
        except (OSError, ValueError):
            line = ""
        lines.put(line)
        if not line:
            return
