"""Plot of the course of an ``until``: the expanded uncertainty against the number of poses, with its goals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, ScalarFormatter

from bench.report.drawing import INK, MUTED, STYLE, hide_frame, to_svg
from bench.report.until_text import meaning_of_goal

_COLOURS = ("#0072b2", "#d55e00")


def course_plot(decisions: Sequence[Mapping[str, Any]]) -> str:
    """Draw the expanded uncertainties against the number of poses, with their goals.

    Parameters
    ----------
    decisions
        Decisions of one ``until``, in order; at least one has reached an uncertainty.

    Returns
    -------
    str
        SVG with a panel for each goal, on a logarithmic scale.
    """
    wanted = decisions[-1]["wanted"]
    reached = [decided for decided in decisions if decided["now"]]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.2, 2.7), layout="constrained")
        panels = figure.subplots(1, len(wanted), squeeze=False)[0]
        for axes, (name, goal), colour in zip(panels, wanted.items(), _COLOURS, strict=False):
            poses = [decided["poses"] for decided in reached]
            values = [decided["now"][name] for decided in reached]
            axes.plot(poses, values, "o-", color=colour, markersize=4, linewidth=1.2)
            fixed_px = sum(part**2 for part in reached[-1]["fixed"].get(name, {}).values()) ** 0.5
            _line(axes, goal, "goal", INK)
            if fixed_px > 0:
                _line(axes, fixed_px, "does not depend on the poses", MUTED)
            _scale(axes, [*values, goal, *([fixed_px] if fixed_px > 0 else [])])
            axes.set_title(f"{meaning_of_goal(name)}, px")
            axes.set_xlabel("poses")
            hide_frame(axes)
        return to_svg(figure, f"course-{decisions[-1]['until']}", "Expanded uncertainty after each pose")


def _line(axes: Axes, height: float, name: str, colour: str) -> None:
    axes.axhline(height, color=colour, linewidth=0.9, linestyle="--")
    axes.annotate(
        name, (1.0, height), (0, 3), xycoords=("axes fraction", "data"), textcoords="offset points",
        ha="right", color=colour, fontsize=8.5,
    )  # fmt: skip


def _scale(axes: Axes, values: Sequence[float]) -> None:
    axes.set_yscale("log")
    axes.set_ylim(0.7 * min(values), 1.5 * max(values))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
