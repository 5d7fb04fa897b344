"""Axes of the control charts as SVG text: lines, bars and dots of many runs. Pure; no library draws.

Positions are rounded to half a unit of the picture, and what falls on the same place is drawn once. So the size of a
picture is bounded, also with thousands of runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape

from bench.report.drawing import INK, LINE, MUTED, POSE_COLOURS
from bench.report.scales import tick_label, ticks
from bench.report.svg_plot import painted

WIDTH, HEIGHT = 460.0, 190.0
LEFT, RIGHT, TOP, BOTTOM = 58.0, 62.0, 20.0, 24.0
BLUE, RED = POSE_COLOURS[0], "#c0271d"
_MOST_DOTS_WITH_TEXT = 150
MANY = 200
"""With more runs, bars are paler and the dots are not joined."""
_BAND, _BAR, _PALE_BAR = 0.09, 0.44, 0.18
"""Opacities of the band between the limits, of bars, and of bars of many runs."""


@dataclass
class ChartAxes:
    """A picture in work."""

    title: str
    x_low: float
    x_high: float
    y_low: float
    y_high: float
    parts: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        if not self.x_high > self.x_low:
            self.x_low, self.x_high = self.x_low - 0.5, self.x_high + 0.5
        if not self.y_high > self.y_low:
            slack = abs(self.y_low) * 1e-6 or 1.0
            self.y_low, self.y_high = self.y_low - slack, self.y_high + slack

    def x(self, value: float) -> float:
        """Return the column of a value."""
        share = (value - self.x_low) / (self.x_high - self.x_low)
        return round(2 * (LEFT + share * (WIDTH - LEFT - RIGHT))) / 2

    def y(self, value: float) -> float:
        """Return the row of a value."""
        share = (value - self.y_low) / (self.y_high - self.y_low)
        return round(2 * (HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM))) / 2

    def band(self, low: Sequence[float], high: Sequence[float], xs: Sequence[float]) -> None:
        """Fill the area between two lines."""
        there = _thinned([(self.x(x), self.y(v)) for x, v in zip(xs, high, strict=True)])
        back = _thinned([(self.x(x), self.y(v)) for x, v in zip(xs, low, strict=True)])
        outline = "L".join(f"{x:g} {y:g}" for x, y in [*there, *reversed(back)])
        self.parts.append(f'<path d="M{outline}Z" fill="{BLUE}" fill-opacity="{_BAND:g}"/>')

    def line(
        self,
        xs: Sequence[float],
        values: Sequence[float],
        colour: str,
        *,
        width: float = 1.0,
        dashed: bool = False,
    ) -> None:
        """Draw a line.

        dashed: Whether it is dashed.
        """
        points = _thinned([(self.x(x), self.y(v)) for x, v in zip(xs, values, strict=True)])
        dash = ' stroke-dasharray="5 3"' if dashed else ""
        outline = "L".join(f"{x:g} {y:g}" for x, y in points)
        self.parts.append(
            f'<path d="M{outline}" fill="none" {painted("stroke", colour)} stroke-width="{width:g}"{dash}/>'
        )

    def bars(self, xs: Iterable[float], low: Iterable[float], high: Iterable[float]) -> None:
        """Draw vertical bars, such as uncertainties; bars in one column become one."""
        columns: dict[float, tuple[float, float]] = {}
        for x, a, b in zip(xs, low, high, strict=True):
            column, bottom, top = self.x(x), self.y(a), self.y(b)
            known = columns.get(column, (bottom, top))
            columns[column] = (max(known[0], bottom), min(known[1], top))
        outline = "".join(f"M{x:g} {a:g}V{b:g}" for x, (a, b) in columns.items())
        opacity = _BAR if len(columns) <= MANY else _PALE_BAR
        self.parts.append(
            f'<path class="bars" d="{outline}" fill="none" stroke="{BLUE}" stroke-opacity="{opacity:g}"'
            ' stroke-width="1.1"/>'
        )

    def dots(
        self, xs: Sequence[float], values: Sequence[float], texts: Sequence[str], beyond: Iterable[int]
    ) -> None:
        """Draw dots; those beyond the limits are red and larger.

        beyond: Places of the dots beyond the limits.
        """
        red = set(beyond)
        points = [(self.x(x), self.y(v)) for x, v in zip(xs, values, strict=True)]
        plain = [place for place in range(len(points)) if place not in red]
        if len(points) <= _MOST_DOTS_WITH_TEXT:
            self.parts += [_dot(points[p], texts[p], BLUE, 2.6) for p in plain]
        else:
            spots = dict.fromkeys(points[p] for p in plain)
            outline = "".join(f"M{x:g} {y:g}h0" for x, y in spots)
            self.parts.append(
                f'<path d="{outline}" fill="none" stroke="{BLUE}" stroke-width="3" stroke-linecap="round"/>'
            )
        self.parts += [_dot(points[p], texts[p], RED, 4.0) for p in sorted(red)]

    def rule(self, value: float, name: str, *, dashed: bool = True) -> None:
        """Draw a horizontal line over the whole width, with its name at the right.

        dashed: Whether it is dashed.
        """
        self.line(
            [self.x_low, self.x_high], [value, value], MUTED if not dashed else INK, width=0.9, dashed=dashed
        )
        self.name_at_right(value, name)

    def name_at_right(self, value: float, name: str) -> None:
        """Write a name to the right of the axes."""
        self.parts.append(
            f'<text x="{WIDTH - RIGHT + 4:g}" y="{self.y(value) + 4:g}" font-size="11" {painted("fill", MUTED)}>'
            f"{escape(name)}</text>"
        )

    def upright(self, value: float, name: str) -> None:
        """Draw a vertical line with a name, such as the end of the baseline."""
        x = self.x(value)
        self.parts.append(
            f'<path d="M{x:g} {TOP:g}V{HEIGHT - BOTTOM:g}" {painted("stroke", MUTED)} stroke-dasharray="2 3"/>'
            f'<text x="{x - 4:g}" y="{TOP + 9:g}" font-size="10" text-anchor="end"'
            f" {painted('fill', MUTED)}>{escape(name)}</text>"
        )

    def svg(self, x_ticks: Sequence[tuple[float, str]]) -> str:
        """Return the picture.

        Returns: The ``<svg>`` element.
        """
        frame = [
            f'<text x="0" y="11" font-size="12" font-weight="650" {painted("fill", INK)}>{escape(self.title)}</text>'
        ]
        for value in ticks(self.y_low, self.y_high, 4):
            y = self.y(value)
            frame.append(
                f'<path d="M{LEFT:g} {y:g}H{WIDTH - RIGHT:g}" {painted("stroke", LINE)} stroke-width="0.6"/>'
                f'<text x="{LEFT - 5:g}" y="{y + 4:g}" font-size="11" text-anchor="end" {painted("fill", MUTED)}>'
                f"{tick_label(value, self.y_high - self.y_low)}</text>"
            )
        foot = HEIGHT - BOTTOM
        frame.append(
            f'<path d="M{LEFT:g} {foot:g}H{WIDTH - RIGHT:g}" {painted("stroke", MUTED)} stroke-width="0.8"/>'
        )
        for value, label in x_ticks:
            x = self.x(value)
            frame.append(
                f'<path d="M{x:g} {foot:g}v3" {painted("stroke", MUTED)}/>'
                f'<text x="{x:g}" y="{foot + 15:g}" font-size="11"'
                f' text-anchor="middle" {painted("fill", MUTED)}>{escape(label)}</text>'
            )
        return (
            f'<svg class="plot" role="img" aria-label="{escape(self.title)}" viewBox="0 0 {WIDTH:g} {HEIGHT:g}"'
            f' xmlns="http://www.w3.org/2000/svg">{"".join(frame)}{"".join(self.parts)}</svg>'
        )


def _dot(point: tuple[float, float], text: str, colour: str, radius: float) -> str:
    x, y = point
    return (
        f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="{colour}"><title>{escape(text)}</title></circle>'
    )


def _thinned(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Keep the first, the last, the highest and the lowest point of each column."""
    columns: dict[float, list[tuple[float, float]]] = {}
    for point in points:
        columns.setdefault(point[0], []).append(point)
    kept: list[tuple[float, float]] = []
    for column in columns.values():
        if len(column) <= 4:
            kept += column
        else:
            kept += [column[0], min(column, key=lambda p: p[1]), max(column, key=lambda p: p[1]), column[-1]]
    return kept
