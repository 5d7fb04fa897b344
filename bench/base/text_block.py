"""A block of text on a terminal that is drawn again in its place.

The cursor always stands below the block and is never hidden, so a process that is killed leaves a usable
terminal.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TextIO

from rich.cells import cell_len, set_cell_size
from rich.console import Console
from rich.control import Control
from rich.segment import ControlType
from rich.text import Text

from bench.base.lost_output import Steering

_SMALLEST_WIDTH, _SMALLEST_HEIGHT = 20, 4  # Columns and lines; a terminal that claims less has no size


class Block:
    """Draws a block of text again and again in the same place of a terminal, by default standard output.

    At another size the visible part is cleared first: terminals differ in how they wrap lines that are there.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._console = Console(
            file=Steering.of(stream or sys.stdout), highlight=False, markup=False, emoji=False
        )
        self._rows = 0
        self._size = self._console.size

    @property
    def can_redraw(self) -> bool:
        """Whether the stream is a terminal that can overwrite lines."""
        return self._console.is_terminal and not self._console.is_dumb_terminal

    def draw(self, head: Sequence[str], log: Sequence[str], tail: Sequence[str]) -> None:
        """Draw the block in place of the one before; the second line of the head is bold.

        Head and tail are wrapped, lines of the log cut off; where the terminal is too low, the oldest of the log go
        first.
        """
        size = self._console.size
        changed, self._size = size != self._size, size
        rows = self._fitted(head, log, tail)
        with self._console:  # one write, so that no half-drawn block is seen
            if changed and self._rows:
                self._console.control(Control.clear(), Control.home())
            elif self._rows:
                self._console.control(_above(self._rows))
            for row in rows:
                self._console.print(row, no_wrap=True, crop=True, overflow="crop")
        self._rows = len(rows)

    def _fitted(self, head: Sequence[str], log: Sequence[str], tail: Sequence[str]) -> list[Text]:
        """Return the rows of the block: at most the height of the terminal less the line of the cursor."""
        width = max(_SMALLEST_WIDTH, self._size.width - 1)
        height = max(_SMALLEST_HEIGHT, self._size.height - 1)
        first = [row for line in head[:1] for row in self._wrapped(line, width)]
        state = [row for line in head[1:2] for row in self._wrapped(line, width, "bold")]
        upper = first + state + [row for line in head[2:] for row in self._wrapped(line, width)]
        lower = [row for line in tail for row in self._wrapped(line, width)]
        upper, lower = upper[: max(2, height - len(lower))], lower[: height - 2]
        room = height - len(upper) - len(lower)
        cut = [Text(self._cut(_printable(line), width)) for line in log[max(0, len(log) - room) :]]
        return [*upper, *(cut if room > 0 else []), *lower]

    def _wrapped(self, line: str, width: int, style: str = "") -> list[Text]:
        return list(Text(_printable(line), style).wrap(self._console, width, overflow="fold"))

    def _cut(self, line: str, width: int) -> str:
        if cell_len(line) <= width:
            return line
        mark = "\N{HORIZONTAL ELLIPSIS}" if self._console.encoding.startswith("utf") else "..."
        return set_cell_size(line, width - len(mark)) + mark


def _above(rows: int) -> Control:
    """Move the cursor up by a number of rows and erase them."""
    codes: list[tuple[ControlType, int]] = [(ControlType.CURSOR_UP, 1), (ControlType.ERASE_IN_LINE, 2)]
    return Control(ControlType.CARRIAGE_RETURN, *codes * rows)


def _printable(line: str) -> str:
    """Replace what would move the cursor: a name in a journal could hold anything."""
    return "".join(c if c.isprintable() else " " for c in line)
