"""A chart of many runs, of bounded size: what falls on the same place is drawn once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from bench.report.svg_plot import FONT, INK, MUTED, POSE_COLOURS, Picture, Words, axes_in
from bench.report.svg_scale import Scale
from calib.arrays import Array

_WIDTH, _HEIGHT, _NAMES, _DATE = 380.0, 156.0, 46.0, 10.0
"""Width and height of a picture, room for the names of lines at its right, and for half a date at its left, points."""
BLUE, RED = POSE_COLOURS[0], "#c0271d"
_MOST_DOTS_WITH_TEXT = 150  # The page of a long history stays small
MANY = 200
"""With more runs, bars are paler and the dots are not joined."""
_ROUNDING = 1e-12
"""Values that differ by less than this share are equal."""
_BAND, _BAR, _PALE_BAR = 0.09, 0.44, 0.18
"""Opacities of the band between the limits, of bars, and of bars of many runs."""


class Chart:
    """A picture in work: lines, bars and dots in one frame."""

    def __init__(
        self, title: str, xs: Sequence[float], values: Sequence[float], labels: Sequence[tuple[float, str]]
    ) -> None:
        self._picture = Picture(_WIDTH, _HEIGHT, "chart", title)
        x, y = _wider(xs, 0.02, 0.5, labels), _wider(values, 0.05, abs(values[0]) * 1e-6 or 1.0)
        place = (_DATE, 0.0, _WIDTH - _NAMES - _DATE, _HEIGHT)
        self._axes = axes_in(self._picture, x, y, Words((title,)), place=place, grid="y", clip=False)

    def band(self, xs: Sequence[float], low: Sequence[float], high: Sequence[float]) -> None:
        """Fill the area between two lines."""
        there, back = self._thinned(xs, high), self._thinned(xs, low)
        self._axes.shapes([[*there, *reversed(back)]], BLUE, _BAND)

    def line(
        self, xs: Sequence[float], values: Sequence[float], colour: str, width: float = 0.9, dash: str = ""
    ) -> None:
        """Draw a line."""
        self._axes.line(self._thinned(xs, values), colour, width, dash=dash)

    def bars(self, xs: Sequence[float], low: Sequence[float], high: Sequence[float]) -> None:
        """Draw vertical bars, such as uncertainties; bars in one column become one."""
        columns: dict[float, tuple[float, float, float]] = {}
        for column, x, bottom, top in zip(self._columns(xs), xs, low, high, strict=True):
            known = columns.get(column, (x, bottom, top))
            columns[column] = (known[0], min(known[1], bottom), max(known[2], top))
        x, bottoms, tops = np.array(list(columns.values())).T
        opacity = _BAR if len(columns) <= MANY else _PALE_BAR
        self._axes.strokes(np.column_stack([x, bottoms]), np.column_stack([x, tops]), BLUE, 0.9, opacity)

    def dots(
        self, xs: Sequence[float], values: Sequence[float], texts: Sequence[str], beyond: Iterable[int]
    ) -> None:
        """Draw dots; those beyond the limits are red and larger."""
        red, points = set(beyond), np.column_stack([xs, values])
        plain = [place for place in range(len(points)) if place not in red]
        if len(points) <= _MOST_DOTS_WITH_TEXT:
            self._told_dots(points, plain, texts, BLUE, 2.1)
        else:
            _, kept = np.unique(np.round(2 * self._axes.at(points[plain])), axis=0, return_index=True)
            self._axes.dots(points[plain][kept], BLUE, 2.5)
        self._told_dots(points, sorted(red), texts, RED, 3.3)

    def rule(self, value: float, name: str, *, dashed: bool = True) -> None:
        """Draw a horizontal line over the whole width, with its name at the right."""
        self._axes.level(value, INK if dashed else MUTED, 0.8, dash="5 3" if dashed else "")
        self.name_at_right(value, name)

    def name_at_right(self, value: float, name: str) -> None:
        """Write a name to the right of the axes."""
        self._axes.text((self._axes.x.high, value), name, by=(4.0, 3.0), colour=MUTED, size=FONT)

    def upright(self, value: float, name: str) -> None:
        """Draw a vertical line with a name, such as the end of the baseline."""
        self._axes.upright(value, MUTED, dash="2 3")
        at = value, self._axes.y.high
        self._axes.text(at, name, by=(-4.0, 8.0), colour=MUTED, anchor="end")

    def svg(self) -> str:
        """Return the picture."""
        return self._picture.svg()

    def _told_dots(
        self, points: Array, places: Sequence[int], texts: Sequence[str], colour: str, radius: float
    ) -> None:
        """Draw dots that show their text under the pointer."""
        for place, (x, y) in zip(places, self._axes.at(points[places]).tolist(), strict=True):
            title = f"<title>{escape(texts[place])}</title>"
            self._picture.add(
                f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="{colour}">{title}</circle>'
            )

    def _columns(self, xs: Sequence[float]) -> list[float]:
        """Return the column of each point, in half points of the picture."""
        return [round(2 * self._axes.width * share) for share in self._axes.x.share(xs).tolist()]

    def _thinned(self, xs: Sequence[float], values: Sequence[float]) -> list[tuple[float, float]]:
        """Keep the first, the last, the highest and the lowest point of each column."""
        columns: dict[float, list[tuple[float, float]]] = {}
        for column, point in zip(self._columns(xs), zip(xs, values, strict=True), strict=True):
            columns.setdefault(column, []).append(point)
        kept: list[tuple[float, float]] = []
        for dots in columns.values():
            ends = (min(dots, key=lambda dot: dot[1]), max(dots, key=lambda dot: dot[1]))
            kept += dots if len(dots) <= 4 else [dots[0], *ends, dots[-1]]
        return kept


def _wider(
    values: Sequence[float], share: float, least: float, ticks: Sequence[tuple[float, str]] | None = None
) -> Scale:
    """Return a scale that is wider than values by a share of their range; by the least if they are equal."""
    low, high = min(values), max(values)
    equal = high - low <= _ROUNDING * max(abs(low), abs(high))
    margin = least if equal else share * (high - low)
    return Scale(low - margin, high + margin, ticks=ticks)
