"""Plots as SVG text: axes with ticks and labels, and what is drawn in them. Pure; no library draws.

Text stays text. It takes typeface and colours of the page (class ``ink``, ``muted`` or ``faint``; `report.css` sets
them); attributes alone suffice where there is no page, as in a certificate.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any, Literal, NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from bench.report.svg_scale import Scale, text_width
from calib.arrays import Array

POSE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of the poses, repeated after six: the palette of Okabe and Ito (2008), safe for colour-blind readers."""
INK, MUTED, LINE = "#17212b", "#5c6874", "#d5dbe1"
"""Colours of text, of pale text and of lines on a light page. A dark page replaces them by its style sheet."""
PANEL = (281.0, 191.0)
"""Width and height of one of several plots beside each other, points."""
WIDE = 605.0
"""Width of a plot alone, points."""
FONT, TITLE = 9.0, 9.5
"""Sizes of type: labels, and titles."""
_FAMILY = "DejaVu Sans, Verdana, sans-serif"
_CLASSES = {INK: "ink", MUTED: "muted", LINE: "faint"}
_PALE, _DEEP = (244, 248, 252), (106, 172, 214)  # Ends of one blue, which prints grey and shows black words
_LINE_HEIGHT, _TICK, _SIGN_LENGTH = 12.0, 3.0, 14.0  # px of the drawing, for letters of `FONT`
_BETWEEN_LABELS, _BETWEEN_ROWS = 16.0, 24.0  # px of the drawing: two numbers are read as two
_RIGHT = 7.0  # px of the drawing: half of the last number below the axis

Place = tuple[float, float, float, float]


def shade(share: float) -> str:
    """Return a shade of blue on which dark text can be read, from 0, the palest one, to 1."""
    part = min(max(share, 0.0), 1.0)
    return "#" + "".join(f"{round(a + part * (b - a)):02x}" for a, b in zip(_PALE, _DEEP, strict=True))


@dataclass
class Picture:
    """An SVG in work, in points; ``label`` is a short description for readers who do not see it."""

    width: float
    height: float
    identifier: str
    label: str
    about: str = ""
    parts: list[str] = field(default_factory=list)  # Elements

    def add(self, part: str) -> None:
        """Add an element."""
        self.parts.append(part)

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        colour: str = MUTED,
        anchor: str = "start",
        size: float = FONT,
        themed: bool = True,
        more: str = "",
    ) -> None:
        """Write a text; the baseline's ``start``, ``middle`` or ``end`` is at x, y.

        ``themed``: on the ground of the page, in its colours; else on a ground that is light in every scheme.
        """
        place = f'x="{round(x, 2):g}" y="{round(y, 2):g}"'
        paint = painted("fill", colour) if themed else f'fill="{colour}"'
        middle = f' text-anchor="{anchor}"' if anchor != "start" else ""
        larger = f' font-size="{size:g}"' if size != FONT else ""
        self.add(f"<text {place} {paint}{middle}{larger}{more and ' ' + more}>{escape(text)}</text>")

    def svg(self) -> Markup:
        """Return the picture as an ``<svg>`` element, which a template does not escape again."""
        about = f"<desc>{escape(self.about)}</desc>" if self.about else ""
        box = f"0 0 {self.width:g} {self.height:g}"
        return Markup(  # noqa: S704 - every text in it was escaped when it was drawn
            f'<svg class="plot" role="img" aria-label="{escape(self.label)}" viewBox="{box}"'
            f' xmlns="http://www.w3.org/2000/svg" font-family="{_FAMILY}" font-size="{FONT:g}">'
            f"{about}{''.join(self.parts)}</svg>"
        )


class Axes:
    """What is drawn in a rectangle of a picture, in the units of two scales. `axes_in` makes it with its frame."""

    def __init__(
        self, picture: Picture, x: Scale, y: Scale, left: float, top: float, width: float, height: float
    ) -> None:
        self.picture, self.x, self.y = picture, x, y
        self.left, self.top, self.width, self.height = left, top, width, height
        self._clip = ""

    def at(self, points: ArrayLike) -> Array:
        """Return where (N, 2) points in the scales' units lie in the picture, rounded to hundredths."""
        given = np.asarray(points, float).reshape(-1, 2)
        across = self.left + self.width * self.x.share(given[:, 0])
        up = self.top + self.height * (1 - self.y.share(given[:, 1]))
        return np.asarray(np.round(np.column_stack([across, up]), 2) + 0.0)  # no negative zero

    def strokes(
        self, begins: ArrayLike, ends: ArrayLike, colour: str, width: float, opacity: float = 1.0
    ) -> None:
        """Draw straight lines between (N, 2) begins and ends as one path, which keeps the file small."""
        both = np.hstack([self.at(begins), self.at(ends)])
        shape = "M%g %gL%g %g" * len(both) % tuple(both.ravel().tolist())
        self._path(shape, _stroke(colour, width, opacity) + ' stroke-linecap="round"')

    def dots(self, points: ArrayLike, colour: str, width: float, opacity: float = 1.0) -> None:
        """Draw dots at (N, 2) points as one path of lines without length."""
        places = self.at(points)
        shape = "M%g %gh0" * len(places) % tuple(places.ravel().tolist())
        self._path(shape, _stroke(colour, width, opacity) + ' stroke-linecap="round"')

    def line(self, points: ArrayLike, colour: str, width: float = 1.0, *, dash: str = "") -> None:
        """Draw a line through (N, 2) points; ``dash`` is empty for a full line."""
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        self._path(shape_of(self.at(points)), _stroke(colour, width) + dashed)

    def shapes(
        self,
        outlines: Iterable[ArrayLike],
        fill: str,
        opacity: float = 1.0,
        edge: str = "",
    ) -> None:
        """Fill closed shapes, (N, 2) each in the units of the scales, together, by the even-odd rule."""
        shape = "".join(shape_of(self.at(outline), closed=True) for outline in outlines)
        clear = f' fill-opacity="{opacity:g}"' if opacity < 1 else ""
        stroke = f' stroke="{edge}" stroke-width="1"' if edge else ""
        self._path(shape, f'fill="{fill}" fill-rule="evenodd"{clear}{stroke}')

    def rectangle(self, across: tuple[float, float], up: tuple[float, float], fill: str) -> None:
        """Fill the rectangle between two values of each scale."""
        (left, right), (low, high) = across, up
        self.shapes([[(left, low), (right, low), (right, high), (left, high)]], fill)

    def upright(self, value: float, colour: str, width: float = 0.8, dash: str = "") -> None:
        """Draw a line from the bottom to the top, as `line`."""
        self.line([(value, self.y.low), (value, self.y.high)], colour, width, dash=dash)

    def level(self, value: float, colour: str, width: float = 0.8, dash: str = "") -> None:
        """Draw a line from the left to the right, as `line`."""
        self.line([(self.x.low, value), (self.x.high, value)], colour, width, dash=dash)

    def text(
        self,
        at: tuple[float, float],
        text: str,
        *,
        by: tuple[float, float] = (0.0, 0.0),
        colour: str = INK,
        size: float = 8.0,
        **look: Any,
    ) -> None:
        """Write a text beside a point, as `Picture.text`."""
        x, y = self.at([at])[0].tolist()
        self.picture.text(x + by[0], y + by[1], text, colour=colour, size=size, **look)

    def clipped(self) -> None:
        """Draw nothing outside of the axes from now on; text is not concerned."""
        number = 1 + sum(part.startswith("<clipPath") for part in self.picture.parts)
        name = f"{self.picture.identifier}-area{number}"
        place = f'x="{self.left:g}" y="{self.top:g}" width="{self.width:g}" height="{self.height:g}"'
        self.picture.add(f'<clipPath id="{name}"><rect {place}/></clipPath>')
        self._clip = f' clip-path="url(#{name})"'

    def _path(self, shape: str, look: str) -> None:
        if shape:
            self.picture.add(f'<path d="{shape}" {look}{self._clip}/>')


def shape_of(places: Array, *, closed: bool = False) -> str:
    """Return a line through (N, 2) places of a picture as the data of a path; empty without places."""
    if not len(places):
        return ""
    text = ("M%g %g" + "L%g %g" * (len(places) - 1)) % tuple(places.ravel().tolist())
    return text + "Z" if closed else text


def painted(what: str, colour: str) -> str:
    """Return what paints ``fill`` or ``stroke``; a page may replace the colours of its own scheme."""
    known = _CLASSES.get(colour)
    line = "-line" if what == "stroke" else ""
    return f'class="{known}{line}" {what}="{colour}"' if known else f'{what}="{colour}"'


def _stroke(colour: str, width: float, opacity: float = 1.0) -> str:
    clear = f' stroke-opacity="{opacity:g}"' if opacity < 1 else ""
    return f'fill="none" {painted("stroke", colour)} stroke-width="{width:g}"{clear}'


class Key(NamedTuple):
    """An entry of a legend: its text, its colour, and its sign."""

    text: str
    colour: str
    sign: Literal["line", "box"] = "line"


@dataclass(frozen=True)
class Words:
    """The words around a plot."""

    title: Sequence[str] = ()
    x: str = ""
    y: str = ""
    keys: Sequence[Key] = ()


def axes_in(
    picture: Picture,
    x: Scale,
    y: Scale,
    words: Words,
    *,
    place: Place | None = None,
    equal: bool = False,
    whole: bool = False,
    grid: str = "",
    clip: bool = True,
) -> Axes:
    """Draw the frame of a plot, and return its axes.

    ``place`` is left, top, width and height with all words; None for the whole picture. With ``equal`` the plot is made
    smaller, so that both scales have one unit. ``grid`` is ``x``, ``y`` or ``xy``.
    """
    left, top, width, height = place or (0.0, 0.0, picture.width, picture.height)
    above = _heading(picture, words, left, top, width)
    below = (_LINE_HEIGHT if words.x else 0.0) + FONT + _TICK + 4.0
    room = height - above - below
    label_width = _room_beside(y, room, words)
    across = width - label_width - _RIGHT
    if equal:
        wide, high = abs(x.high - x.low), abs(y.high - y.low)
        unit = min(across / wide, room / high)
        across, room = unit * wide, unit * high
    axes = Axes(
        picture, x, y, *(round(length, 2) for length in (left + label_width, top + above, across, room))
    )
    _draw_frame(axes, words, whole=whole, grid=grid)
    if clip:
        axes.clipped()
    return axes


def height_for(image_size: Sequence[int], width: float, words: Words) -> float:
    """Return how high a picture of a sensor is; one higher than wide is drawn narrower than the picture."""
    words_high = _LINE_HEIGHT * len(words.title) + 4.0 + 2 * _LINE_HEIGHT + FONT
    words_wide = 3.0 + _TICK + _LINE_HEIGHT + _widest([str(image_size[1])]) + _RIGHT
    across = width - words_wide
    return round(words_high + min(across * image_size[1] / image_size[0], 0.9 * across), 1)


def _heading(picture: Picture, words: Words, left: float, top: float, width: float) -> float:
    """Write title and legend; return their height."""
    at = top
    for number, line in enumerate(words.title):
        at += _LINE_HEIGHT
        colour, size = (INK, TITLE) if number == 0 else (MUTED, FONT)
        weight = 'font-weight="600"' if number == 0 else ""
        picture.text(left, at - 3.0, line, colour=colour, size=size, more=weight)
    return write_legend(picture, words.keys, left, at, width) - top + 4.0


def write_legend(picture: Picture, keys: Sequence[Key], left: float, top: float, width: float) -> float:
    """Write a legend in rows of some width, as many as it needs, and return where it ends."""
    x, foot = left, top + (_LINE_HEIGHT if keys else 0.0)
    for key in keys:
        length = _SIGN_LENGTH + 4.0 + text_width(key.text, FONT)
        if x > left and x + length > left + width:
            x, foot = left, foot + _LINE_HEIGHT
        _sign(picture, key, x, foot - 6.0)
        picture.text(x + _SIGN_LENGTH + 4.0, foot - 3.0, key.text)
        x += length + 12.0
    return foot


def _sign(picture: Picture, key: Key, x: float, y: float) -> None:
    """Draw the sign of an entry of the legend."""
    if key.sign == "box":
        picture.add(
            f'<rect x="{x:g}" y="{y - 4:g}" width="{_SIGN_LENGTH:g}" height="8" {painted("fill", key.colour)}/>'
        )
    else:
        picture.add(
            f'<path d="M{x:g} {y:g}h{_SIGN_LENGTH:g}" {painted("stroke", key.colour)} stroke-width="2"/>'
        )


def _room_beside(y: Scale, height: float, words: Words) -> float:
    """Return the room that the labels of the y axis need."""
    labels = [label for _, label in y.chosen_ticks(_most_rows(height))]
    return 4.0 + _TICK + (_LINE_HEIGHT if words.y else 0.0) + _widest(labels)


def _most_rows(height: float) -> int:
    return max(2, int(height / _BETWEEN_ROWS))


def _widest(labels: Sequence[str]) -> float:
    return max((text_width(label, FONT) for label in labels), default=0.0)


def _most_columns(x: Scale, width: float) -> int:
    """Return how many labels fit below the x axis."""
    most = max(2, int(width / 30.0))
    while most > 2:
        labels = [label for _, label in x.chosen_ticks(most)]
        if len(labels) < 2 or (_widest(labels) + _BETWEEN_LABELS) * (len(labels) - 1) <= width:
            break
        most -= 1
    return most


def _draw_frame(axes: Axes, words: Words, *, whole: bool, grid: str) -> None:
    """Draw the sides, the ticks and the labels."""
    picture, foot, right = axes.picture, axes.top + axes.height, axes.left + axes.width
    columns = axes.x.chosen_ticks(_most_columns(axes.x, axes.width))
    rows = axes.y.chosen_ticks(_most_rows(axes.height))
    across = [axes.left + axes.width * float(axes.x.share(value)) for value, _ in columns]
    up = [axes.top + axes.height * (1 - float(axes.y.share(value))) for value, _ in rows]
    lines = "".join(f"M{x:.2f} {axes.top:g}V{foot:g}" for x in across if "x" in grid)
    lines += "".join(f"M{axes.left:g} {y:.2f}H{right:g}" for y in up if "y" in grid)
    if lines:
        picture.add(f'<path d="{lines}" fill="none" {painted("stroke", LINE)} stroke-width="0.5"/>')
    sides = f"M{axes.left:g} {axes.top:g}V{foot:g}H{right:g}" + (f"V{axes.top:g}Z" if whole else "")
    marks = "".join(f"M{x:.2f} {foot:g}v{_TICK:g}" for x in across)
    marks += "".join(f"M{axes.left:g} {y:.2f}h-{_TICK:g}" for y in up)
    picture.add(f'<path d="{sides}{marks}" fill="none" {painted("stroke", LINE)} stroke-width="0.8"/>')
    for x, (_, label) in zip(across, columns, strict=True):
        picture.text(x, foot + _TICK + FONT, label, anchor="middle")
    for y, (_, label) in zip(up, rows, strict=True):
        picture.text(axes.left - _TICK - 2.0, y + 3.2, label, anchor="end")
    if words.x:
        picture.text(axes.left + axes.width / 2, foot + _TICK + FONT + _LINE_HEIGHT, words.x, anchor="middle")
    if words.y:
        x, y = axes.left - _TICK - 7.0 - _widest([label for _, label in rows]), axes.top + axes.height / 2
        picture.text(x, y, words.y, anchor="middle", more=f'transform="rotate(-90 {x:g} {y:g})"')
