"""Common style of all plots: fonts, colours, sizes, strokes on the sensor, and reproducible SVG.

Depends on Matplotlib and arrays. Text in a plot stays text, so that a reader can search it and it takes the page's
typeface. The output depends neither on the date nor on Matplotlib's global state.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from bench.report.support import reach_px, star_distance

Array = NDArray[np.float64]

POSE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Colours of the poses, repeated after six: the palette of Okabe and Ito (2008), safe for colour-blind readers."""
PANEL, SENSOR_PANEL, WIDE = (3.9, 2.65), (3.9, 2.65), 8.4
"""Sizes of plots, inches: one of several beside each other; one that shows the sensor; the width of a plot alone."""
_COARSE = 8
"""The part that stars support is drawn from every n-th pixel."""
INK, MUTED, LINE = "#17212b", "#5c6874", "#d5dbe1"
STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "starbench",
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.edgecolor": LINE,
    "axes.labelcolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "path.simplify": False,  # dots are lines without length
    "text.color": INK,
    "text.parse_math": False,  # a pose may be called $x$
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
}
_SVG, _XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"


def hide_frame(axes: Axes) -> None:
    """Hide the upper and the right side of the frame.

    Parameters
    ----------
    axes
        Axes of a plot.
    """
    axes.spines[["top", "right"]].set_visible(False)


def strokes(axes: Axes, begins: Array, ends: Array, colour: str, width: float, alpha: float = 1.0) -> None:
    """Draw many lines as one path, which keeps the file small; a line without length is a dot.

    Parameters
    ----------
    axes
        Axes of the plot.
    begins, ends
        (N, 2) float64, in the units of the axes: the ends of the lines.
    colour
        Colour of the lines.
    width
        Width of the lines, points.
    alpha
        Opacity, 0 to 1.
    """
    if not len(begins):
        return
    vertices = np.stack([begins, ends], axis=1).reshape(-1, 2)
    codes = np.tile([Outline.MOVETO, Outline.LINETO], len(begins))
    axes.add_patch(
        PathPatch(
            Outline(vertices, codes),
            fill=False,
            edgecolor=colour,
            linewidth=width,
            capstyle="round",
            alpha=alpha,
        )
    )


def sensor(axes: Axes, image_size: tuple[int, int]) -> None:
    """Make the axes those of the sensor.

    Parameters
    ----------
    axes
        Axes of the plot.
    image_size
        Width and height, px.
    """
    axes.set(xlim=(-0.5, image_size[0] - 0.5), ylim=(image_size[1] - 0.5, -0.5), aspect="equal")
    axes.set_xlabel("column, px")
    axes.set_ylabel("row, px")


def shade_unsupported(axes: Axes, points: Array, image_size: Sequence[int]) -> float:
    """Shade the part of the sensor that no star supports, with a dashed line around it.

    Parameters
    ----------
    axes
        Axes of the sensor.
    points
        (N, 2) float64, px: stars of all poses, N > 0.
    image_size
        Width and height, px.

    Returns
    -------
    float
        Share of the sensor that stars support, 0 to 1.
    """
    distance, reach = star_distance(points, image_size), reach_px(image_size)
    height, width = distance.shape
    rows, columns = (np.unique([*range(0, n, _COARSE), n - 1]) for n in (height, width))
    shown = distance[np.ix_(rows, columns)]
    if shown.max() > reach > shown.min():
        edges = [reach, float(shown.max()) + 1.0]
        axes.contourf(columns, rows, shown, levels=edges, colors="#f2dcc9", alpha=0.75)
        axes.contour(columns, rows, shown, levels=[reach], colors="#9a5b00", linewidths=0.9, linestyles="--")
    return float(np.mean(distance <= reach))


def to_svg(figure: Figure, identifier: str, label: str) -> str:
    """Render a figure as SVG without a date, with short coordinates and with ids that are unique on the page.

    Parameters
    ----------
    figure
        The figure.
    identifier
        Prefix of all ids in the SVG; different for each plot of a page.
    label
        Description for screen readers.

    Returns
    -------
    str
        The ``<svg>`` element.
    """
    FigureCanvasSVG(figure)
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'( id="|url\(#|href="#)', rf"\g<1>{identifier}-", text)
    text = re.sub(r'(?<= d=)"[^"]*"', lambda found: _shortened(found[0]), text)
    head = rf'<svg class="plot" role="img" aria-label="{label}" viewBox="\1" xmlns="{_SVG}" xmlns:xlink="{_XLINK}">'
    text = re.sub(r'<svg [^>]*viewBox="([^"]*)"[^>]*>', head, text, count=1)
    return text.strip()


def _shortened(outline: str) -> str:
    """Shorten a path: keep two decimals of a point, and only one point of a line without length."""
    outline = re.sub(r"(\.\d\d)\d+", r"\1", outline)
    outline = re.sub(r"\s*([MLCQz\"])\s*", r"\1", outline)
    return re.sub(r"M([\d.-]+ [\d.-]+)L\1(?=[M\"])", r"M\1h0", outline)
