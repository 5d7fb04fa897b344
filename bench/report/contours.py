"""Contours of a map on a grid: closed outlines of the part that reaches a level, by marching squares. Pure.

The outlines are interpolated linearly between grid points and follow the edge of the grid where the map
reaches the level there. Where the map is not known, nothing is inside.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array

_NOWHERE = -1e30
"""Value around the map and where it is not known: an outline beside it lies at the last known point."""
_TOP, _RIGHT, _BOTTOM, _LEFT = range(4)
# Sides of a cell between which an outline runs, with the inside on its left hand. The key states which corners are
# inside: 8 upper left, 4 upper right, 2 lower right, 1 lower left.
_RUNS = {
    8: ((_LEFT, _TOP),), 4: ((_TOP, _RIGHT),), 2: ((_RIGHT, _BOTTOM),), 1: ((_BOTTOM, _LEFT),),
    12: ((_LEFT, _RIGHT),), 6: ((_TOP, _BOTTOM),), 3: ((_RIGHT, _LEFT),), 9: ((_BOTTOM, _TOP),),
    7: ((_TOP, _LEFT),), 11: ((_RIGHT, _TOP),), 13: ((_BOTTOM, _RIGHT),), 14: ((_LEFT, _BOTTOM),),
}  # fmt: skip
_SADDLES = {
    10: (((_LEFT, _TOP), (_RIGHT, _BOTTOM)), ((_RIGHT, _TOP), (_LEFT, _BOTTOM))),
    5: (((_TOP, _RIGHT), (_BOTTOM, _LEFT)), ((_TOP, _LEFT), (_BOTTOM, _RIGHT))),
}
"""Runs if the middle of the cell is outside, and if it is inside."""


@dataclass(frozen=True)
class Outline:
    """A closed outline."""

    points: Array  # (N, 2) float64, in the units of the grid; the last point joins the first one
    at_edge: NDArray[np.bool_]  # (N,) bool: whether the point lies at the edge of the known map

    def lines(self) -> list[Array]:
        """Return the contours, (N, 2) each, without the map's edge; a closed one repeats its first point."""
        if not self.at_edge.any():
            return [np.vstack([self.points, self.points[:1]])]
        first = int(np.argmax(self.at_edge))
        points, at_edge = np.roll(self.points, -first, axis=0), np.roll(self.at_edge, -first)
        points, at_edge = np.vstack([points, points[:1]]), np.append(at_edge, at_edge[0])
        ends = np.flatnonzero(at_edge)
        return [points[a + 1 : b] for a, b in pairwise(ends.tolist()) if b > a + 2]


def outlines(x: Array, y: Array, values: Array, level: float) -> list[Outline]:
    """Return the outlines of where a map, (H, W), NaN if unknown, reaches a level; holes are outlines of their own.

    Lorensen and Cline, Marching cubes, SIGGRAPH 1987, in two dimensions; columns x are (W,), rows y (H,).
    """
    shown = np.pad(np.where(np.isfinite(values), values, _NOWHERE), 1, constant_values=_NOWHERE)
    begins, ends = _runs(shown, level)
    places, at_edge = _crossings(np.pad(x, 1, "edge"), np.pad(y, 1, "edge"), shown, level, begins)
    place_of = dict(zip(begins.tolist(), range(len(begins)), strict=True))
    after = dict(zip(begins.tolist(), ends.tolist(), strict=True))
    shapes = []
    while after:
        side, chain = next(iter(after)), []
        while side in after:
            chain.append(place_of[side])
            side = after.pop(side)
        shapes.append(Outline(places[chain], at_edge[chain]))
    return shapes


def _runs(shown: Array, level: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the sides of the grid where each run through a cell begins and ends; each side begins at most one run."""
    inside = shown >= level
    codes = 8 * inside[:-1, :-1] + 4 * inside[:-1, 1:] + 2 * inside[1:, 1:] + inside[1:, :-1]
    width, count = shown.shape[1], shown.size
    steps = (0, count + 1, width, count)  # from a cell's number to its upper, right, lower and left side
    begins, ends = [], []

    def add(cells: NDArray[np.bool_], runs: tuple[tuple[int, int], ...]) -> None:
        row, column = np.nonzero(cells)
        number = row * width + column
        for begin, end in runs:
            begins.append(number + steps[begin])
            ends.append(number + steps[end])

    for code, runs in _RUNS.items():
        add(codes == code, runs)
    middle = (shown[:-1, :-1] + shown[:-1, 1:] + shown[1:, 1:] + shown[1:, :-1]) / 4 >= level
    for code, (outer, inner) in _SADDLES.items():
        add((codes == code) & ~middle, outer)
        add((codes == code) & middle, inner)
    return np.concatenate(begins), np.concatenate(ends)


def _crossings(
    x: Array, y: Array, shown: Array, level: float, sides: NDArray[np.int64]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return where the level crosses sides of the grid, and whether the map ends there."""
    width, count = shown.shape[1], shown.size
    upright = sides >= count
    row, column = np.divmod(sides % count, width)
    other_row, other_column = row + upright, column + ~upright
    here, there = shown[row, column], shown[other_row, other_column]
    share = (level - here) / (there - here)
    places = np.column_stack(
        [x[column] + share * (x[other_column] - x[column]), y[row] + share * (y[other_row] - y[row])]
    )
    return places, (here == _NOWHERE) | (there == _NOWHERE)
