"""The pictures of docs/comparison.md: every repetition of every column, and errors by the number of images."""

from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .columns import Column
from .methods import Row

_ROW_IN, _WIDTH_IN = 0.22, 9.0
#: The same numbers give the same file.
_STYLE = {"svg.hashsalt": "starbench", "svg.fonttype": "none", "font.size": 8.0}
_OF_REPETITION = "#9aa7b5"
_OF_ALL = "#b3261e"
_STATED = "#1b4f8a"


def draw_errors(columns: Sequence[Column], rows: Sequence[Sequence[Row]], origin: str, folder: Path) -> None:
    """Write comparison-direction.svg and comparison-focal.svg."""

    def direction(row: Row) -> float:
        return float(row["direction_rms_urad"])

    def focal(row: Row) -> float:
        return abs(float(row["errors"]["fx"]))

    with mpl.rc_context(_STYLE):
        figure, axes = _strips(columns, rows, direction)
        axes.set_xlabel("error of direction, µrad: grey, each repetition; red, root mean square")
        _save(figure, origin, folder / "comparison-direction.svg")
        figure, axes = _strips(columns, rows, focal)
        for place, of_column in enumerate(rows):
            stated = [row["k"] * row["sigma"]["fx"] for row in of_column if "fx" in row.get("sigma", {})]
            if stated:
                axes.plot(np.median(stated), place, "|", color=_STATED, markersize=11, markeredgewidth=2)
        axes.set_xlabel("error of fx, px: grey, each repetition; red, root mean square; blue, stated U")
        _save(figure, origin, folder / "comparison-focal.svg")


def _strips(
    columns: Sequence[Column], rows: Sequence[Sequence[Row]], number: Callable[[Row], float]
) -> tuple[Figure, Axes]:
    """Draw a line for each column, with a point for each repetition."""
    figure = Figure((_WIDTH_IN, 0.8 + _ROW_IN * len(columns)), layout="constrained")
    axes = figure.subplots()
    for place, of_column in enumerate(rows):
        values = np.array([number(row) for row in of_column if "error" not in row])
        if len(values):
            axes.plot(values, np.full(len(values), place), "o", color=_OF_REPETITION, markersize=3, alpha=0.7)
            axes.plot(np.sqrt(np.mean(values**2)), place, "D", color=_OF_ALL, markersize=4)
    axes.set_xscale("log")
    axes.set_yticks(range(len(columns)), [column.name for column in columns])
    axes.set_ylim(len(columns) - 0.5, -0.5)
    axes.grid(axis="x", color="#dddddd")
    axes.set_axisbelow(True)
    return figure, axes


def draw_image_counts(
    columns: Sequence[Column], rows: Sequence[Sequence[Row]], origin: str, folder: Path
) -> None:
    """Write comparison-images.svg: the error of direction by the number of images, a line for each kind of bench."""
    lines: dict[str, list[tuple[int, float]]] = {}
    for column, of_column in zip(columns, rows, strict=True):
        errors = [row["direction_rms_urad"] for row in of_column if "error" not in row]
        kind = column.name.rsplit(",", 1)[0]
        if errors and column.noise == "typical":
            lines.setdefault(kind, []).append((column.images, float(np.sqrt(np.mean(np.square(errors))))))
    with mpl.rc_context(_STYLE):
        figure = Figure((_WIDTH_IN, 4.5), layout="constrained")
        axes = figure.subplots()
        for kind, points in lines.items():
            if len(points) > 1:
                axes.plot(*zip(*sorted(points), strict=True), "o-", label=kind)
        axes.set(xscale="log", yscale="log", xlabel="images", ylabel="error of direction, µrad, RMS")
        axes.legend(frameon=False)
        axes.grid(color="#dddddd")
        _save(figure, origin, folder / "comparison-images.svg")


def _save(figure: Figure, origin: str, path: Path) -> None:
    figure.supxlabel(origin, fontsize=6, color="#666666")
    figure.savefig(path, format="svg", metadata={"Date": None})
    path.write_text("\n".join(line.rstrip() for line in path.read_text().splitlines()) + "\n")
