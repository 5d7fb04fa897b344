"""Plots as SVG text: axes with ticks and labels, and what is drawn in them. Pure; no library draws.

Text stays text: a reader can select and search it. It takes the typeface of the page, and the colours of its scheme
where it stands on the page's ground (class ``ink``, ``muted`` or ``faint``; `report.css` sets them). The attributes
alone suffice where there is no page, as in a certificate. The same data give the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.report.drawing import INK, LINE, MUTED
from bench.report.scales import Scale

Array = NDArray[np.float64]

FONT, TITLE = 9.0, 9.5
"""Sizes of type: labels, and titles."""
_FAMILY = "DejaVu Sans, Verdana, sans-serif"
_CLASSES = {INK: "ink", MUTED: "muted", LINE: "faint"}


class Picture:
    """An SVG in work; its unit is the point.

    identifier: Prefix of all ids; different for each picture of a page.
    label: Short description for readers who do not see it.
    about: What it shows, in one or two sentences; empty to say nothing.
    """

    def __init__(self, width: float, height: float, identifier: str, label: str, about: str = "") -> None:
        self.width, self.height, self.identifier = width, height, identifier
        self.label, self.about = label, about
        self.parts: list[str] = []
        self._clipped = 0

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
        more: str = "",
    ) -> None:
        """Write a text on the ground of the page.

        x, y: Where its baseline begins, ends or has its middle.
        anchor: ``start``, ``middle`` or ``end``.
        """
        self.add(_text(x, y, text, painted("fill", colour), anchor, size, more))

    def clip(self, left: float, top: float, width: float, height: float) -> str:
        """Define a rectangle outside of which nothing is drawn."""
        self._clipped += 1
        name = f"{self.identifier}-area{self._clipped}"
        shape = f'<rect x="{left:g}" y="{top:g}" width="{width:g}" height="{height:g}"/>'
        self.add(f'<clipPath id="{name}">{shape}</clipPath>')
        return f'clip-path="url(#{name})"'

    def svg(self) -> str:
        """Return the picture.

        Returns: The ``<svg>`` element.
        """
        about = f"<desc>{escape(self.about)}</desc>" if self.about else ""
        box = f"0 0 {self.width:g} {self.height:g}"
        return (
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
        """Return where points lie in the picture.

        points: (N, 2), in the units of the scales.
        Returns: (N, 2) float64, rounded to hundredths.
        """
        given = np.asarray(points, float).reshape(-1, 2)
        across = self.left + self.width * self.x.share(given[:, 0])
        up = self.top + self.height * (1 - self.y.share(given[:, 1]))
        return np.asarray(np.round(np.column_stack([across, up]), 2) + 0.0)  # no negative zero

    def strokes(
        self, begins: ArrayLike, ends: ArrayLike, colour: str, width: float, opacity: float = 1.0
    ) -> None:
        """Draw many straight lines as one path, which keeps the file small.

        begins, ends: (N, 2), in the units of the scales: the ends of the lines.
        """
        both = np.hstack([self.at(begins), self.at(ends)])
        shape = "M%g %gL%g %g" * len(both) % tuple(both.ravel().tolist())
        self._path(shape, _stroke(colour, width, opacity) + ' stroke-linecap="round"')

    def dots(self, points: ArrayLike, colour: str, width: float, opacity: float = 1.0) -> None:
        """Draw dots as one path of lines without length.

        points: (N, 2), in the units of the scales.
        """
        places = self.at(points)
        shape = "M%g %gh0" * len(places) % tuple(places.ravel().tolist())
        self._path(shape, _stroke(colour, width, opacity) + ' stroke-linecap="round"')

    def line(
        self, points: ArrayLike, colour: str, width: float = 1.0, *, dash: str = "", opacity: float = 1.0
    ) -> None:
        """Draw a line through points.

        points: (N, 2), in the units of the scales.
        dash: Lengths of dashes and gaps; empty for a full line.
        """
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        self._path(shape_of(self.at(points)), _stroke(colour, width, opacity) + dashed)

    def shapes(
        self,
        outlines: Iterable[ArrayLike],
        fill: str,
        opacity: float = 1.0,
        edge: str = "",
        width: float = 1.0,
        dash: str = "",
    ) -> None:
        """Fill closed shapes together, by the even-odd rule.

        outlines: (N, 2) each, in the units of the scales.
        edge, width: Colour and width of the outline; no colour for none.
        dash: Lengths of dashes and gaps of the outline; empty for a full line.
        """
        shape = "".join(shape_of(self.at(one), closed=True) for one in outlines)
        clear = f' fill-opacity="{opacity:g}"' if opacity < 1 else ""
        stroke = f' stroke="{edge}" stroke-width="{width:g}"' if edge else ""
        stroke += f' stroke-dasharray="{dash}"' if dash else ""
        self._path(shape, f'fill="{fill}" fill-rule="evenodd"{clear}{stroke}')

    def upright(self, value: float, colour: str, width: float = 0.8, dash: str = "") -> None:
        """Draw a line from the bottom to the top.

        colour, width, dash: As for `line`.
        """
        self.line([(value, self.y.low), (value, self.y.high)], colour, width, dash=dash)

    def level(self, value: float, colour: str, width: float = 0.8, dash: str = "") -> None:
        """Draw a line from the left to the right.

        colour, width, dash: As for `line`.
        """
        self.line([(self.x.low, value), (self.x.high, value)], colour, width, dash=dash)

    def text(
        self,
        at: tuple[float, float],
        text: str,
        *,
        by: tuple[float, float] = (0.0, 0.0),
        colour: str = INK,
        anchor: str = "start",
        size: float = 8.0,
        themed: bool = True,
        more: str = "",
    ) -> None:
        """Write a text beside a point.

        colour, anchor, size, more: As for `Picture.text`.
        themed: Whether the colour is that of the page; False on a ground that is light in every scheme.
        """
        x, y = self.at([at])[0].tolist()
        paint = painted("fill", colour) if themed else f'fill="{colour}"'
        self.picture.add(_text(x + by[0], y + by[1], text, paint, anchor, size, more))

    def clipped(self) -> None:
        """Draw nothing outside of the axes from now on; text is not concerned."""
        self._clip = " " + self.picture.clip(self.left, self.top, self.width, self.height)

    def _path(self, shape: str, look: str) -> None:
        if shape:
            self.picture.add(f'<path d="{shape}" {look}{self._clip}/>')


def shape_of(places: Array, *, closed: bool = False) -> str:
    """Return a line through places of a picture as the data of a path.

    places: (N, 2) float64, points of the picture.
    closed: Whether the last place joins the first one.
    Returns: Empty without places.
    """
    if not len(places):
        return ""
    text = ("M%g %g" + "L%g %g" * (len(places) - 1)) % tuple(places.ravel().tolist())
    return text + "Z" if closed else text


def painted(what: str, colour: str) -> str:
    """Return the attributes that paint something; a page may replace the colours of its own scheme.

    what: ``fill`` or ``stroke``.
    """
    known = _CLASSES.get(colour)
    line = "-line" if what == "stroke" else ""
    return f'class="{known}{line}" {what}="{colour}"' if known else f'{what}="{colour}"'


def _stroke(colour: str, width: float, opacity: float) -> str:
    clear = f' stroke-opacity="{opacity:g}"' if opacity < 1 else ""
    return f'fill="none" {painted("stroke", colour)} stroke-width="{width:g}"{clear}'


def _text(x: float, y: float, text: str, paint: str, anchor: str, size: float, more: str) -> str:
    place = f'x="{round(x, 2):g}" y="{round(y, 2):g}"'
    middle = f' text-anchor="{anchor}"' if anchor != "start" else ""
    larger = f' font-size="{size:g}"' if size != FONT else ""
    return f"<text {place} {paint}{middle}{larger}{more and ' ' + more}>{escape(text)}</text>"
