"""Questions to the operator: answered at this terminal, from another one, or by the default after a time-out.

A typed line is noticed without waiting: by ``select`` if that accepts terminals, else (on Windows) by a thread that
reads.
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
    """An answer."""

    word: str  # ``continue`` or ``abort``
    by: str  # Who gave it: ``operator`` at this terminal, a name, or ``time-out``


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
    """Ask the operator, and wait for an answer.

    default: The answer if nobody answers in time: ``continue`` or ``abort``.
    terminal: Where answers are typed; None for standard input. If it is not a terminal, or is closed, only
      ``elsewhere`` gives an answer. An empty line is the default.
    elsewhere: Returns the answer given from another terminal (`starbench tell`); None while there is none.
    """
    source = sys.stdin if terminal is None else terminal
    here = source is not None and source.isatty()  # None: the process has no standard input
    typed = _typed(source) if here else None
    how = "[c]ontinue / [a]bort" if here else "`starbench tell FOLDER yes` (or no)"
    say(f"{text}  {how}, {default} after {timeout_s:g} s:")
    deadline = clock.monotonic() + timeout_s
    while clock.monotonic() < deadline:
        if (reply := elsewhere()) is not None:
            say(f"{reply.by}: {reply.word}")
            return reply
        line = typed() if typed is not None else None
        if line == "":  # the end of the input, which is not an answer
            say("This terminal is closed. Answer with `starbench tell FOLDER yes` (or no) from another one.")
            typed = None
        elif line is not None:
            word = line.strip().lower()
            if word in _YES | _NO | {""}:
                return Reply(default if not word else "abort" if word in _NO else "continue", "operator")
            say("Please answer c (continue) or a (abort).")
        clock.sleep(_POLL_S)
    return Reply(default, "time-out")


def _typed(source: TextIO) -> Callable[[], str | None]:
    """Return a function that returns the next line typed: None while there is none, ``""`` at the end of the input."""
    try:
        select.select([source], [], [], 0)
    except (OSError, ValueError):  # on this system select accepts sockets only
        return _lines_of(source)
    _discard_typed(source)
    return lambda: source.readline() if select.select([source], [], [], 0)[0] else None


def _discard_typed(source: TextIO) -> None:
    """Discard what was typed before the question: a key pressed an hour ago must not answer it."""
    with suppress(ImportError, OSError, ValueError):  # it is not a terminal
        import termios

        with suppress(termios.error):
            termios.tcflush(source.fileno(), termios.TCIFLUSH)


_readers: dict[TextIO, queue.SimpleQueue[str]] = {}
"""One reader for each terminal. A reader that waits for a line cannot be stopped, so the next question uses it."""


def _lines_of(source: TextIO) -> Callable[[], str | None]:
    """Read a terminal in a thread of its own. What was typed before the question is discarded."""
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
    """Put the lines of a terminal into a queue until the input ends."""
    while True:
        try:
            line = source.readline()
        except (OSError, ValueError):
            line = ""
        lines.put(line)
        if not line:
            return
