"""One line that shows how far many pieces of work are: live on a terminal; elsewhere a line every half minute."""

from __future__ import annotations

import sys
import time

import click

from bench.cluster.work import TimeLeft
from bench.terminal.duration import clock_text

_EVERY_S = 30.0
_EVERY_ON_A_TERMINAL_S = 0.25


class LiveLine:
    """A line on standard error.

    quiet: Whether nothing is shown.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self.quiet = quiet
        self._live = sys.stderr.isatty()
        self._next_s = time.monotonic() + (0.0 if self._live else _EVERY_S)
        self._width = 0

    def due(self) -> bool:
        """Return whether it is time to show the line again.

        Returns: True at most four times a second; without a terminal every half minute.
        """
        now = time.monotonic()
        if self.quiet or now < self._next_s:
            return False
        self._next_s = now + (_EVERY_ON_A_TERMINAL_S if self._live else _EVERY_S)
        return True

    def show(self, text: str) -> None:
        """Show a text in place of the one before."""
        if self._live:
            click.echo(f"\r{text:<{self._width}}", nl=False, err=True)
            self._width = len(text)
        else:
            click.echo(text, err=True)

    def clear(self) -> None:
        """Remove the live line, so that another line can be printed."""
        if self._live and self._width:
            click.echo(f"\r{'':<{self._width}}\r", nl=False, err=True)
            self._width = 0


class CountLine(LiveLine):
    """Shows how many things of one kind are done, and the time left.

    things: What they are called, such as ``files``.
    before: How many were done before the command began.
    quiet: Whether nothing is shown.
    """

    def __init__(self, total: int, things: str, *, before: int = 0, quiet: bool = False) -> None:
        super().__init__(quiet=quiet)
        self.done, self._before, self._total, self._things = before, before, total, things
        self._time = TimeLeft()

    def count(self, more: int = 1) -> None:
        """Count what has been done, and show the line if it is time."""
        self.done += more
        if self.done < self._total and self.due():
            left = self._time.left_s(self.done - self._before, self._total - self._before)
            self.show(f"{self.text()}{'' if left is None else f', {clock_text(left)} left'}")

    def text(self) -> str:
        """Return the count in words.

        Returns: As ``3 of 10 files``.
        """
        return f"{self.done} of {self._total} {self._things}"
