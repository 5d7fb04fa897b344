"""Outlines of the printed target and of boards: their points, and the areas that are black, or from which light comes.

The print is the same as that of `calib.target.StarTarget.reflectance`, which answers for single points. Millimetres of
the plane Z = 0, X right, Y down; origin at the board's first point (of a star target at the corner of its print). An
area is a ring of corners, clockwise as seen; a ring that runs the other way is dark and lies within bright ones.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calib.target import StarTarget
from simulators.world.board import STILL, BoardState, BoardTruth

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


ROUND: Final = 64
"""Corners of a circle's ring."""
_RING: Final = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def points_mm(board: BoardTruth, target: StarTarget) -> FloatArray:
    """Return the points that a detector finds, mm: inner corners, centres of circles or dots by row, stars by id."""
    if board.kind == "stars":
        return np.asarray(target.positions_mm(target.ids), np.float64)
    row, column = np.mgrid[: board.rows, : board.columns].astype(np.float64)
    if board.kind == "asymmetric-circles":
        column = 2.0 * column + row % 2.0
    return np.asarray(board.pitch_mm * np.column_stack([column.ravel(), row.ravel()]))


def middle_mm(board: BoardTruth, target: StarTarget) -> FloatArray:
    """Return the point that a placement puts somewhere, mm: middle of the points, of a star target that of its tag."""
    if board.kind == "stars":
        return np.array([*target.tag_centre_mm, 0.0])
    points = points_mm(board, target)
    return np.array([*(0.5 * (points.min(axis=0) + points.max(axis=0))), 0.0])


def bright_areas(board: BoardTruth, target: StarTarget, *, pixels: bool) -> tuple[FloatArray, ...]:
    """Return the rings, mm, from which the board's light comes, kept: do not change them; ``pixels`` one by one."""
    return _areas(replace(board, state=BoardState(), shake=STILL), target, pixels)


@lru_cache(maxsize=4)
def _areas(board: BoardTruth, target: StarTarget, pixels: bool) -> tuple[FloatArray, ...]:
    """Compute the rings of ``bright_areas``."""
    points, pitch_mm = points_mm(board, target), board.pitch_mm
    if board.kind == "stars":
        size = target.pitch_mm * np.array([target.squares_x, target.squares_y])
        low, high = np.zeros(2), size
        marks: FloatArray = black_polygons(target)
    elif board.kind == "checkerboard":
        low, high = points.min(axis=0) - pitch_mm, points.max(axis=0) + pitch_mm
        marks = _squares(board.columns, board.rows, pitch_mm)
        if pixels and board.pixel_mm > 0.0:
            count = round(pitch_mm / board.pixel_mm)
            marks = _screen_pixels(marks[:, 0], count, board.pixel_mm, board.fill)
    else:
        radius_mm = 0.5 * board.dot_mm
        low, high = points.min(axis=0) - radius_mm, points.max(axis=0) + radius_mm
        marks = points[:, None] + _circle(radius_mm)
    if board.surface != "print":
        return (marks,)
    return _paper(low - board.margin_mm, high + board.margin_mm, pitch_mm or 8.0 * target.pitch_mm), marks[
        :, ::-1
    ]


def _squares(columns: int, rows: int, side_mm: float) -> FloatArray:
    """Return every second square of a checkerboard, with the upper left one."""
    i, j = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1))
    chosen = (i + j) % 2 == 0
    upper_left = np.column_stack([i[chosen], j[chosen]]) - 1.0
    return np.asarray(side_mm * (upper_left[:, None] + _RING))


def _screen_pixels(corners_mm: FloatArray, count: int, pixel_mm: float, fill: float) -> FloatArray:
    """Return the shining squares in the pixels of a screen, for squares of ``count`` pixels a side."""
    side = math.sqrt(fill)
    j, i = np.divmod(np.arange(count * count), count)
    first = np.column_stack([i, j]) + 0.5 * (1.0 - side)
    pixels = pixel_mm * (first[:, None] + side * _RING)
    return np.asarray((corners_mm[:, None, None] + pixels).reshape(-1, 4, 2))


def _circle(radius_mm: float) -> FloatArray:
    """Return a ring of the same area as a circle about the origin."""
    turn = 2.0 * math.pi / ROUND
    radius_mm *= math.sqrt(turn / math.sin(turn))
    angles = turn * np.arange(ROUND)
    return np.asarray(radius_mm * np.column_stack([np.cos(angles), np.sin(angles)]))


def _paper(low: FloatArray, high: FloatArray, tile_mm: float) -> FloatArray:
    """Return white paper as tiles; a single large ring would be left out if all its corners lie out of view."""
    across, down = (
        np.linspace(a, b, 1 + math.ceil((b - a) / tile_mm)) for a, b in zip(low, high, strict=True)
    )
    x, y = np.meshgrid(across, down)
    corners = np.stack([x, y], axis=-1)
    ring = [corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]]
    return np.asarray(np.stack(ring, axis=2).reshape(-1, 4, 2))
