"""The printed brightness of the star target, compiled by numba.

The kernels stand apart from `calib.target`, so that a plan or a station file, which need the stars' positions only,
load no compiler.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from calib.compiled import INNER, KERNEL


@njit(**INNER)
def reflectance_at(x_mm: float, y_mm: float, layout: Any) -> float:
    """Return the printed brightness at one point, for code that numba compiles.

    Own definition of the pattern: see `calib.target`. Tag: Olson (2011).

    x_mm, y_mm: X and Y of the point on the target plane, mm.
    layout: Pattern, from `StarTarget.layout`.
    Returns: 0 (black) or 1 (white).
    """
    column, row = x_mm / layout.pitch_mm, y_mm / layout.pitch_mm
    tag_x, tag_y = column - layout.tag_column, row - layout.tag_row
    side = layout.tag_squares
    if -0.5 <= tag_x < side + 0.5 and -0.5 <= tag_y < side + 0.5:
        if not (0.0 <= tag_x < side and 0.0 <= tag_y < side):
            return 1.0
        modules = layout.tag_modules.shape[0]
        module_x, module_y = int(tag_x * modules / side), int(tag_y * modules / side)
        return float(layout.tag_modules[module_y, module_x])
    node_x, node_y = math.floor(column + 0.5), math.floor(row + 0.5)
    if not (0 <= node_x < layout.columns and 0 <= node_y < layout.rows):
        return 1.0
    # Segments are counted from +Y. The first one is white.
    turns = math.atan2(row - node_y, column - node_x) / (2.0 * math.pi) - 0.25
    segment = math.floor(layout.segments * (turns - math.floor(turns)))
    return 1.0 if segment % 2 == 0 else 0.0


@njit(**KERNEL)
def reflectances_at(x_mm: Any, y_mm: Any, layout: Any) -> Any:
    """Return the printed brightness at several points.

    x_mm, y_mm: (N,) float64, X and Y of the points on the target plane, mm.
    layout: Pattern, from `StarTarget.layout`.
    Returns: (N,) float64, 0 (black) or 1 (white).
    """
    values = np.empty(x_mm.size)
    for i in range(x_mm.size):
        values[i] = reflectance_at(x_mm[i], y_mm[i], layout)
    return values
