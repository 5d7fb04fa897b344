"""The course of the focus: edge widths of the last minute, and the best one at this light and pose."""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

KEPT_S: Final = 60.0
"""Time over which the curve is kept, s: a person turns the ring to and fro in some seconds."""
_AGREEING: Final = 3  # The best is a median of so many neighbours, which one stray value does not move


class FocusCurve:
    """Edge widths over time, and the best."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, float]] = deque()
        self._newest_px: deque[float] = deque(maxlen=_AGREEING)
        self.best_px: float | None = None
        """Smallest edge width seen, px: the median of `_AGREEING` neighbours. None before there are so many."""

    def add(self, time_s: float, edge_width_px: float) -> None:
        """Add the edge width of a picture, px, later than the one before."""
        self._points.append((time_s, edge_width_px))
        while self._points[0][0] < time_s - KEPT_S:
            self._points.popleft()
        self._newest_px.append(edge_width_px)
        if len(self._newest_px) == _AGREEING:
            self.best_px = min(float(np.median(self._newest_px)), self.best_px or np.inf)

    def begin_best(self) -> None:
        """Begin the best anew: light and place in the field change the edge width without a turn of the ring."""
        self._newest_px.clear()
        self.best_px = None

    def points(self) -> list[tuple[float, float]]:
        """Return time, s, and edge width, px, of each picture in which it was measured."""
        return list(self._points)
