"""Common style of all plots: fonts, colours, and reproducible SVG.

Depends on Matplotlib only. Text in a plot stays text, so that a reader can search it and it takes the page's typeface.
The output depends neither on the date nor on Matplotlib's global state.
"""

from __future__ import annotations

import io
import re
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

INK, MUTED, LINE = "#17212b", "#5c6874", "#d5dbe1"
STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "starbench",
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.edgecolor": LINE,
    "axes.labelcolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.titlesize": 10,
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
