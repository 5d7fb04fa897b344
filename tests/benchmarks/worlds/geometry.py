"""Rotations, lenses and the printed grid, written for the worlds alone; NumPy only."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIZE = (1280, 720)
DEG = np.pi / 180.0
PITCH_MM = 144.5 / 36.0
#: Columns and rows of stars, and the middle node of the tag, about which 5 x 5 stars are missing.
COLUMNS, ROWS, TAG = 49, 71, (24, 35)
BROWN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FISHEYE = ("kb1", "kb2", "kb3", "kb4")


def printed_stars() -> tuple[NDArray[np.int64], Array]:
    """Ids (N,) and nominal positions (N, 2) mm of all stars of the default print."""
    column, row = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
    printed = (abs(column - TAG[0]) > 2) | (abs(row - TAG[1]) > 2)
    nodes = np.stack([column[printed], row[printed]], axis=1)
    return np.arange(len(nodes)), nodes * PITCH_MM


def turn(vector: Array) -> Array:
    """The (3, 3) rotation by a rotation vector, rad (Rodrigues)."""
    v = np.asarray(vector, float)
    angle = float(np.linalg.norm(v))
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = v / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def brown(lens: Mapping[str, float], rays: Array) -> Array:
    """Image points (N, 2) px of rays (N, 3) by a lens with radial, rational and tangential terms (OpenCV's order)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (lens.get(name, 0.0) for name in BROWN)
    x, y = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([lens["fx"] * u + lens["cx"], lens["fy"] * v + lens["cy"]], axis=1)


def fisheye(lens: Mapping[str, float], rays: Array) -> Array:
    """Image points (N, 2) px of rays (N, 3) by a lens whose radius is a polynomial of the angle (Kannala and Brandt)."""
    across = np.hypot(rays[:, 0], rays[:, 1])
    angle = np.arctan2(across, rays[:, 2])
    powers = sum(lens.get(name, 0.0) * angle ** (2 * i + 2) for i, name in enumerate(FISHEYE))
    scale = angle * (1 + powers) / np.maximum(across, 1e-300)
    return np.stack(
        [lens["fx"] * scale * rays[:, 0] + lens["cx"], lens["fy"] * scale * rays[:, 1] + lens["cy"]], axis=1
    )


def by_names(lens: Mapping[str, float], rays: Array) -> Array:
    """Image points (N, 2) px of rays (N, 3), by the lens that the names of the coefficients tell."""
    return fisheye(lens, rays) if "kb1" in lens else brown(lens, rays)
