"""A printed star drawn finely: how far each place around it lies from the nearest edge, and which edge that is.

Knows the printed target, a pitch and a blur; no image and no stars found in one.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from calib.target import StarTarget

#: Samples of the print a px.
OVERSAMPLING = 6
#: Half the side of the print drawn, in pitches: a star and the rim of its neighbours.
PRINT_REACH = 0.62
#: Furthest distance looked at, in blurs.
TAU_LIMIT_BLURS = 3.2


class EdgeMap(NamedTuple):
    """One star, drawn finely: tau, px, and the number of the nearest edge, on a grid around its centre."""

    tau: NDArray[np.float32]
    edge: NDArray[np.uint8]
    half: int
    samples_per_pitch: float
    limit_px: float


def draw_edge_map(target: StarTarget, pitch_px: float, blur_px: float) -> EdgeMap:
    """Draw a star among its neighbours, blurred (sigma, px), as finely as refinement asks for at that pitch."""
    return blurred_edge_map(render_star(target, pitch_px), target.segments, pitch_px, blur_px)


def render_star(target: StarTarget, pitch_px: float) -> NDArray[np.float64]:
    """Brightness (0 to 1) around a star that has all its neighbours, square, on the grid of a `EdgeMap`."""
    columns, rows = np.meshgrid(np.arange(1, target.columns - 1), np.arange(1, target.rows - 1))
    whole = np.ones(columns.shape, bool)
    for dc in (-1, 0, 1):
        for dr in (-1, 0, 1):
            whole &= target.id_at(columns + dc, rows + dr) >= 0
    at = int(np.argmax(whole))
    u, v = _grid(pitch_px)
    x, y = (columns.ravel()[at] + u) * target.pitch_mm, (rows.ravel()[at] + v) * target.pitch_mm
    return target.reflectance(x, y)


def _grid(pitch_px: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places of a print's samples, in pitches from the star."""
    half = int(np.ceil(PRINT_REACH * pitch_px * OVERSAMPLING))
    steps = np.arange(-half, half + 1) / (pitch_px * OVERSAMPLING)
    u, v = np.meshgrid(steps, steps)
    return u, v


def blurred_edge_map(sharp: NDArray[np.float64], segments: int, pitch_px: float, blur_px: float) -> EdgeMap:
    """Blur a print from `render_star` of the same pitch, and read tau and the nearest of the edges off it."""
    blurred = cv2.GaussianBlur(sharp, (0, 0), blur_px * OVERSAMPLING)
    # Samples on an edge fall to either side by rounding; half a turn more makes the drawing even again.
    blurred = (blurred + blurred[::-1, ::-1]) / 2.0
    tau = blur_px * ndtri(np.clip(blurred, 1e-4, 1.0 - 1e-4))
    u, v = _grid(pitch_px)
    edge = np.round(np.arctan2(v, u) / (2.0 * np.pi) * segments) % segments
    scale, limit_px = pitch_px * OVERSAMPLING, TAU_LIMIT_BLURS * blur_px
    return EdgeMap(tau.astype(np.float32), edge.astype(np.uint8), len(sharp) // 2, scale, limit_px)
