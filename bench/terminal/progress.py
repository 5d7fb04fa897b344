"""What the operator sees while a run goes on: state, pose n of m, time left. Always on standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Self, TextIO

from rich.console import Console
from rich.live import Live
from rich.text import Text

from bench.terminal.duration import clock_text

_BAR_WIDTH, _LEAST_BAR = 24, 8


class Progress:
    """Shows a run as it goes: one live line on a terminal, a line a change elsewhere.

    Parameters
    ----------
    monotonic
        The run's clock, s.
    total_s
        Expected duration of the whole run, s.
    poses
        Number of poses.
    stream
        Where to write; standard error by default.
    """

    def __init__(
        self, monotonic: Callable[[], float], total_s: float, poses: int, stream: TextIO | None = None
    ) -> None:
        self._monotonic = monotonic
        self._total_s = total_s
        self._poses = poses
        self._console = Console(file=stream or sys.stderr, stderr=stream is None, highlight=False)
        # A terminal that cannot go back over a line gets lines, as a file does.
        self._goes_back = self._console.is_terminal and not self._console.is_dumb_terminal
        self._state, self._detail, self._pose, self._done_s = "idle", "", 0, 0.0
        self._counted_from_s = monotonic()
        self._live = Live(
            console=self._console, transient=True, get_renderable=self._line, refresh_per_second=8
        )

    def __enter__(self) -> Self:
        if self._goes_back:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # the terminal has gone
            self._live.stop()

    def done(self, seconds: float) -> None:
        """Tell how much of the expected total lies behind, s."""
        self._done_s, self._counted_from_s = seconds, self._monotonic()

    def show(self, state: str, *, pose: int | None = None, detail: str = "") -> None:
        """Tell the present state.

        Parameters
        ----------
        state
            State of the machine.
        pose
            Number of the pose at work, from 1; None: as before.
        detail
            A few words more.
        """
        self._state, self._detail = state, detail
        self._pose = pose or self._pose
        if not self._goes_back:
            self._print(Text(self._plain()))

    def say(self, message: str) -> None:
        """Print a line that stays."""
        self._print(Text(message))

    def _print(self, text: Text) -> None:
        try:
            self._console.print(text, soft_wrap=True)
        except OSError:  # the terminal has gone: the run goes on, or ends, by itself
            self._console = Console(quiet=True)

    def left_s(self) -> float:
        """Expected time to the end, s: the plan's, counted down while the present step lasts."""
        return max(0.0, self._total_s - self._done_s - (self._monotonic() - self._counted_from_s))

    def _where(self) -> str:
        if not self._pose:
            return ""
        return f"pose {self._pose} of {self._poses}" + (f" ({self._detail})" if self._detail else "")

    def _plain(self) -> str:
        return f"{self._state:<11}  {self._where():<28}  {clock_text(self.left_s()):>6} left"

    def _line(self) -> Text:
        """Give one line that fits the terminal: where it is narrow the bar gives way first, then the end is cut."""
        told = Text.assemble(
            (f"{self._state:<11}", "bold"), f"  {clock_text(self.left_s())} left  {self._where()}".rstrip()
        )
        width = min(_BAR_WIDTH, self._console.width - told.cell_len - 2)
        if width < _LEAST_BAR:
            told.truncate(self._console.width, overflow="ellipsis")
            return told
        share = 1.0 if self._total_s <= 0 else min(1.0, 1.0 - self.left_s() / self._total_s)
        full = round(share * width)
        # Told apart without colour too, and where the terminal has no lines to draw.
        done, rest = "━─" if self._console.encoding.startswith("utf") else "#-"
        return Text.assemble(
            (done * full, "bold green"), (rest * (width - full), "bright_black"), "  ", told, no_wrap=True
        )
