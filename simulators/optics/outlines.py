"""Outlines of the printed target: the areas that are black.

The print is the same as that of `calib.target.StarTarget.reflectance`, which answers for single points. Millimetres of
the plane Z = 0, X right, Y down; origin at the board's first point (of a star target at the corner of its print). An
area is a ring of corners, clockwise as seen; a ring that runs the other way is dark and lies within bright ones.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from calib.target import StarTarget

FloatArray = NDArray[np.float64]

CORNERS = 4
"""Corners of a polygon; a polygon with fewer corners repeats its last one."""


def black_polygons(target: StarTarget) -> FloatArray:
    """Return the outlines of what is printed black, mm: convex, clockwise as seen; a star's centre comes first."""
    nodes = target.positions_mm(target.ids)
    stars = nodes[:, None, None, :] + target.pitch_mm * _black_segments(target.segments)[None]
    return np.concatenate([stars.reshape(-1, CORNERS, 2), _black_modules(target)])


def _black_segments(segments: int) -> FloatArray:
    """Return a star's black segments, (segments / 2, 4, 2), in squares; the first, from +Y towards -X, is white."""
    polygons = []
    for number in range(1, segments, 2):
        start, end = (2.0 * math.pi * (n / segments + 0.25) for n in (number, number + 1))
        corner = (
            math.floor((start - 0.25 * math.pi) / (0.5 * math.pi) + 1e-9) + 1.0
        ) * 0.5 * math.pi + 0.25 * math.pi
        ring = [np.zeros(2), _on_cell(start)]
        if corner < end - 1e-9:
            ring.append(_on_cell(corner))
        ring.append(_on_cell(end))
        polygons.append((ring + ring[-1:])[:CORNERS])
    return np.asarray(polygons)


def _on_cell(angle: float) -> FloatArray:
    """Return the point where a ray from the star's centre leaves its cell, the square of side 1."""
    direction = np.array([math.cos(angle), math.sin(angle)])
    return np.asarray(0.5 * direction / np.abs(direction).max())


def _black_modules(target: StarTarget) -> FloatArray:
    """Return the black modules of the tag, (N, 4, 2), mm."""
    side = target.pitch_mm * target.tag_squares / target.tag_modules
    rows, columns = np.nonzero(target.tag_print == 0)
    corner = target.tag_corners_mm[0] + side * np.column_stack([columns, rows])
    ring = side * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return np.asarray(corner[:, None] + ring[None])
