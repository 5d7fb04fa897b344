"""The black areas of the printed target as polygons, from which its image is drawn.

This module works on the print only. It describes the same print as `calib.target.StarTarget.reflectance`, which
answers for single points. Millimetres of the target plane, X right, Y down.
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
    """Return the outlines of everything that is printed black.

    Returns: Convex polygons that do not overlap, mm, each clockwise as seen (from +X to +Y). The first corner
      of a star's segment is the star's centre.
    """
    nodes = target.positions_mm(target.ids)
    stars = nodes[:, None, None, :] + target.pitch_mm * _black_segments(target.segments)[None]
    return np.concatenate([stars.reshape(-1, CORNERS, 2), _black_modules(target)])


def _black_segments(segments: int) -> FloatArray:
    """Return the black segments of a star, (segments / 2, 4, 2), in squares from its centre, cut to a cell of side 1.

    The star's first segment, counted from +Y towards -X, is white.
    """
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
    rows, columns = np.nonzero(target.layout.tag_modules == 0)
    corner = target.tag_corners_mm[0] + side * np.column_stack([columns, rows])
    ring = side * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return np.asarray(corner[:, None] + ring[None])
