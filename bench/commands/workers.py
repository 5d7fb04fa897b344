"""Work that many workers share: the option that says who they are, and the line that shows how far they are."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, cast

import click

from bench.base.encoding import clock_text, printable
from bench.base.entry_points import WORKERS as BROUGHT
from bench.base.entry_points import ExtraMissing, load, stale_remark
from bench.base.lost_output import Steering
from bench.work.kept_rows import KeptRows
from bench.work.workers import Serial, Workers, WorkLeft

CONTINUES = "What is done is kept; the same command continues."
_MOST_PROCESSES = 1024  # More is a slip of the keyboard, and would fill the memory
_EVERY_S = 30.0  # A log of a night stays readable
_EVERY_ON_A_TERMINAL_S = 0.25  # More often is not seen


class _Who(click.ParamType):
    """A number of processes, or the address of a Dask scheduler."""

    name = "workers"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int | str:
        """See `click.ParamType.convert`."""
        if "://" in str(value):
            return str(value)
        if not str(value).isdecimal() or not 1 <= int(value) <= _MOST_PROCESSES:
            self.fail(
                f"{value!r} is neither a number of 1 to {_MOST_PROCESSES} nor the address of a Dask scheduler, such as"
                " tls://host:8786.",
                param,
                ctx,
            )
        return int(value)


WORKERS = click.option(
    "--workers",
    type=_Who(),
    metavar="N|ADDRESS",
    help="Number of processes on this computer; or use the workers of a Dask scheduler, tcp://host:8786 or"
    " tls://host:8786 (docs/extras/many/cluster.md).  [default: one process for each processor]",
)


def open_workers(who: int | str | None, *, most: int | None = None) -> Workers:
    """Return who does the work, to be closed: a number of processes (None: as many as suit) or a scheduler's workers.

    ``most`` is the number of pieces, if known. Without an installed package for processes, None is this process alone.
    """
    if isinstance(who, str):
        return cast("Workers", load(BROUGHT, who.partition("://")[0])(who))
    try:
        return cast("Workers", load(BROUGHT, "processes")(who, most))
    except ExtraMissing:
        if who is not None:
            raise
        if remark := stale_remark():
            click.echo(remark, err=True)
        return Serial()


@contextmanager
def kept_work(
    workers: Workers, folder: Path | None, file: str, line: CountLine, done: str
) -> Iterator[KeptRows | None]:
    """Yield what keeps done pieces of work in a folder, None without one; an interruption is told with their number."""
    with ExitStack() as stack:
        stack.callback(workers.close)
        kept = stack.enter_context(KeptRows(folder, file)) if folder is not None else None
        try:
            yield kept
        except BaseException:
            line.clear()
            end = CONTINUES if folder is not None else "Nothing is kept: give -o."
            click.echo(f"{line.text()} {done}. {end}", err=True)
            raise
    line.clear()


class LiveLine:
    """A line on standard error; nothing is shown if ``quiet``."""

    def __init__(self, *, quiet: bool = False) -> None:
        self.quiet = quiet
        self._live = sys.stderr.isatty()
        self._next_s = time.monotonic() + (0.0 if self._live else _EVERY_S)
        self._width = 0

    def due(self) -> bool:
        """Return whether to show the line again: four times a second, without a terminal every half minute."""
        now = time.monotonic()
        if self.quiet or now < self._next_s:
            return False
        self._next_s = now + (_EVERY_ON_A_TERMINAL_S if self._live else _EVERY_S)
        return True

    def show(self, text: str) -> None:
        """Show a text in place of the one before."""
        if self._live:
            self._overwrite(f"\r{printable(text):<{self._width}}")
            self._width = len(text)
        else:
            click.echo(text, err=True)

    def clear(self) -> None:
        """Remove the live line, so that another line can be printed."""
        if self._live and self._width:
            self._overwrite(f"\r{'':<{self._width}}\r")
            self._width = 0

    @staticmethod
    def _overwrite(text: str) -> None:
        Steering(sys.stderr).write(text)
        sys.stderr.flush()


class CountLine(LiveLine):
    """Shows how many things of one kind are done, and the time left."""

    def __init__(self, total: int, things: str, *, quiet: bool = False) -> None:
        super().__init__(quiet=quiet)
        self.done, self._total, self._things = 0, total, things
        self._time = WorkLeft()

    def count(self, more: int = 1) -> None:
        """Count what has been done, and show the line if it is time."""
        self.done += more
        if self.done < self._total and self.due():
            self.show(f"{self.text()}{_left_text(self._time, self.done, self._total)}")

    def show_share(self, share: float) -> None:
        """Count up to a share of all, 0 to 1."""
        self.count(int(share * self._total) - self.done)

    def text(self) -> str:
        """Return the count in words, as ``3 of 10 files``."""
        return f"{self.done} of {self._total} {self._things}"


class PartsLine(LiveLine):
    """Shows how many parts of a work are done, then the one thing that follows the last part, with the time left."""

    def __init__(
        self,
        things: str,
        then: str,
        *,
        quiet: bool = False,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(quiet=quiet)
        self._things, self._then, self._count = things, then, ""
        self._work_left = partial(WorkLeft, monotonic)
        self._time = self._calculation = self._work_left()

    @contextmanager
    def shown(self) -> Iterator[Callable[[int, int], None]]:
        """Yield what shows how far the parts are; the calibrations in the block show how far they are themselves."""
        from calib.progress import shown_by

        try:
            with shown_by(self.calculated):
                yield self.reached
        finally:
            self.clear()

    def reached(self, done: int, total: int) -> None:
        """Show how far the work is: ``done`` parts of ``total``."""
        self._count = f"{total} {self._things}" if done == total else f"{done} of {total} {self._things}"
        if done == total and self._live and not self.quiet:
            self.show(f"{self._count}; {self._then}")
        elif 0 < done < total and self.due():
            self.show(f"{self._count}{_left_text(self._time, done, total)}")

    def calculated(self, done: float, expected: float) -> None:
        """Show how far a calibration is; the ``expected`` work can grow. It begins where nothing is done."""
        if not done:
            self._calculation = self._work_left()
        elif self.due():
            left = _left_text(self._calculation, done, expected, "at least ")
            self.show(f"{self._count}; {self._then}{left}" if self._count else f"{self._then}{left}")


def _left_text(work: WorkLeft, done: float, total: float, bound: str = "") -> str:
    left = work.left_s(done, total)
    return "" if left is None else f", {bound}{clock_text(left)} left"


@contextmanager
def views_line(*, quiet: bool = False) -> Iterator[Callable[[int, int], None]]:
    """Yield what shows how many views are found, then that the camera is calculated, while the block works."""
    with PartsLine("views found", "the camera is calculated", quiet=quiet).shown() as reached:
        yield reached
