"""Colours and sizes that all plots share."""

from __future__ import annotations

POSE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of the poses, repeated after six: the palette of Okabe and Ito (2008), safe for colour-blind readers."""
INK, MUTED, LINE = "#17212b", "#5c6874", "#d5dbe1"
"""Colours of text, of pale text and of lines on a light page. A dark page replaces them by its style sheet."""
PANEL = (281.0, 191.0)
"""Width and height of one of several plots beside each other, points."""
WIDE = 605.0
"""Width of a plot alone, points."""
_PALE, _DEEP = (244, 248, 252), (106, 172, 214)


def shade(share: float) -> str:
    """Return a shade of blue on which dark text can be read.

    share: 0 for the palest one, 1 for the deepest one.
    """
    part = min(max(share, 0.0), 1.0)
    return "#" + "".join(f"{round(a + part * (b - a)):02x}" for a, b in zip(_PALE, _DEEP, strict=True))
