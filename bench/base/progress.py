"""The progress of a run for the operator: state, pose n of m, time left. Written to standard error."""

from __future__ import annotations

import os
import queue
import select
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self, TextIO

from rich.console import Console
from rich.live import Live
from rich.text import Text

from bench.base.clock import BenchClock
from bench.base.encoding import clock_text
from bench.base.lost_output import Steering
from bench.base.pasteable import pasteable

_BAR_WIDTH, _LEAST_BAR = 24, 8  # Columns, and the fewest of a bar
_WITHOUT_TIME_LEFT = frozenset({"aborting", "aborted", "failed", "finished"})
"""In these states no step of the plan follows, so no time left is shown."""
_POLL_S = 0.2  # A line that changes more often flickers
_YES = {"c", "continue", "y", "yes"}
_NO = {"a", "abort", "n", "no"}

_readers: dict[TextIO, queue.SimpleQueue[str]] = {}
"""One reader for each terminal. A reader that waits for a line cannot be stopped, so the next question uses it."""


class Progress:
    """Shows a run's progress, ``total_s`` expected: a live line on a terminal; elsewhere a line for each state.

    ``poses`` is how many poses the run has, as text, and ``left_s`` tells the time left, s; both may be set anew.
    """

    def __init__(self, total_s: float, poses: str = "", stream: TextIO | None = None) -> None:
        self._total_s = total_s
        self.left_s: Callable[[], float] = lambda: total_s
        self.poses = poses
        self._console = Console(
            file=Steering.of(stream or sys.stderr), stderr=stream is None, highlight=False
        )
        # A terminal that cannot overwrite a line gets one line for each change, as a file does.
        self._can_overwrite = self._console.is_terminal and not self._console.is_dumb_terminal
        self._state, self._detail, self._pose = "idle", "", 0
        self._live = Live(
            console=self._console, transient=True, get_renderable=self._line, refresh_per_second=8
        )

    def __enter__(self) -> Self:
        if self._can_overwrite:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def show(self, state: str, *, pose: int | None = None, detail: str = "") -> None:
        """Show the present state, pose (from 1; None: unchanged), and in brackets further words."""
        self._state, self._detail = state, detail
        self._pose = pose or self._pose
        if not self._can_overwrite:
            self.say(self._plain())

    def say(self, message: str) -> None:
        """Print a line that remains on the terminal."""
        self._console.print(Text(message), soft_wrap=True)

    def _where(self) -> str:
        if not self._pose:
            return ""
        return f"pose {self._pose} of {self.poses}" + (f" ({self._detail})" if self._detail else "")

    def _plain(self) -> str:
        left = self._left()
        return f"{self._state:<11}  {self._where():<28}  {left:>11}".rstrip()

    def _left(self) -> str:
        return "" if self._state in _WITHOUT_TIME_LEFT else f"{clock_text(self.left_s())} left"

    def _line(self) -> Text:
        """Return one line that fits the terminal. On a narrow one the bar is left out, then the end of the text."""
        parts = "  ".join(filter(None, (self._left(), self._where())))
        text = Text.assemble((f"{self._state:<11}", "bold"), f"  {parts}".rstrip())
        width = min(_BAR_WIDTH, self._console.width - text.cell_len - 2)
        if width < _LEAST_BAR:
            text.truncate(self._console.width, overflow="ellipsis")
            return text
        share = 1.0 if self._total_s <= 0 else min(1.0, 1.0 - self.left_s() / self._total_s)
        full = round(share * width)
        # Two characters, so that the bar is readable without colour; plain ones without line-drawing characters.
        done, rest = "━─" if self._console.encoding.startswith("utf") else "#-"
        return Text.assemble(
            (done * full, "bold green"), (rest * (width - full), "bright_black"), "  ", text, no_wrap=True
        )


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
    folder: Path,
    terminal: TextIO | None = None,
    elsewhere: Callable[[], Reply | None] = lambda: None,
) -> Reply:
    """Ask the operator, and wait for an answer, or for the default, ``continue`` or ``abort``, at the deadline.

    ``terminal`` None means standard input. If that is no terminal, only ``elsewhere`` answers: `starbench tell` with
    the folder of the run.
    """
    tell = f"`{pasteable('tell', folder, 'yes')}` (or no)"
    source = sys.stdin if terminal is None else terminal
    here = source if source is not None and source.isatty() else None  # No standard input is None, too
    typed = None
    how = "[c]ontinue / [a]bort" if here and _in_foreground(here) else tell
    say(f"{text}  {how}, {default} after {timeout_s:g} s:")
    deadline = clock.monotonic() + timeout_s
    while clock.monotonic() < deadline:
        if (reply := elsewhere()) is not None:
            say(f"{reply.by}: {reply.word}")
            return reply
        line = None
        if here and _in_foreground(here):
            typed = typed or _typed(here)
            line = typed()
        if line == "":  # the end of the input, which is not an answer
            say(f"This terminal is closed. Answer with {tell} from another one.")
            here = None
        elif line is not None:
            word = line.strip().lower()
            if word in _YES | _NO | {""}:
                return Reply(default if not word else "abort" if word in _NO else "continue", "operator")
            say("Please answer c (continue) or a (abort).")
        clock.sleep(_POLL_S)
    return Reply(default, "time-out")


def _in_foreground(source: TextIO) -> bool:
    """Whether this process may read the terminal. The system suspends a background job that reads it (SIGTTIN).

    True also where the system has no jobs, and at a terminal of another session.
    """
    try:
        return os.tcgetpgrp(source.fileno()) == os.getpgrp()
    except (AttributeError, OSError, ValueError):
        return True


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
