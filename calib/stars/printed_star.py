"""A printed star, finely sampled: the distance of each place around it from the nearest edge, and which edge that is.

The module uses the printed target, a pitch and a blur. It uses no image and no detected stars.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from calib.target import StarTarget

#: Samples of the printed star per px.
OVERSAMPLING = 6
#: Half the side of the printed star's image, pitches: the star and the rim of its neighbours.
REACH = 0.62
#: Largest distance from an edge that is used, in units of the blur.
TAU_LIMIT_BLURS = 3.2


class EdgeMap(NamedTuple):
    """Distances from the edges of one printed star, sampled on a square grid around its centre.

    Attributes
    ----------
    tau
        (S, S) float32, px, signed distance from the nearest edge; positive on white.
    edge
        (S, S) uint8, number of the nearest edge, 0 to the number of segments - 1.
    half
        Row and column of the centre.
    samples_per_pitch
        Number of samples per pitch.
    limit_px
        Largest distance that is used, px.
    """

    tau: NDArray[np.float32]
    edge: NDArray[np.uint8]
    half: int
    samples_per_pitch: float
    limit_px: float


def render_star(target: StarTarget, pitch_px: float) -> NDArray[np.float64]:
    """Draw the print around a star that has all eight neighbours, on the grid of an `EdgeMap`.

    The print is that of `calib.target.StarTarget.reflectance`.

    Parameters
    ----------
    target
        Printed target.
    pitch_px
        Distance of neighbouring stars in the image, px.

    Returns
    -------
    array
        (S, S) float64, brightness, 0 to 1, point symmetric about the centre.
    """
    columns, rows = np.meshgrid(np.arange(1, target.columns - 1), np.arange(1, target.rows - 1))
    surrounded = np.ones(columns.shape, bool)
    for dc in (-1, 0, 1):
        for dr in (-1, 0, 1):
            surrounded &= target.id_at(columns + dc, rows + dr) >= 0
    at = int(np.argmax(surrounded))
    u, v = _grid(pitch_px)
    x, y = (columns.ravel()[at] + u) * target.pitch_mm, (rows.ravel()[at] + v) * target.pitch_mm
    drawn = target.reflectance(x, y)
    # By rounding, samples on an edge fall to either side of it. The mean with half a turn makes the star symmetric.
    return (drawn + drawn[::-1, ::-1]) / 2.0


def _grid(pitch_px: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the places of the samples of an `EdgeMap`, pitches from the star, two (S, S) arrays."""
    half = int(np.ceil(REACH * pitch_px * OVERSAMPLING))
    steps = np.arange(-half, half + 1) / (pitch_px * OVERSAMPLING)
    u, v = np.meshgrid(steps, steps)
    return u, v


def blurred_edge_map(sharp: NDArray[np.float64], segments: int, pitch_px: float, blur_px: float) -> EdgeMap:
    """Blur a printed star, and compute the distances from its edges from the blurred brightness.

    A straight edge blurred by a Gaussian of standard deviation sigma has the brightness Phi(tau / sigma) at distance
    tau, so tau = sigma Phi^-1(brightness). Own derivation: the Gaussian is integrated over the white side of the edge.

    Parameters
    ----------
    sharp
        (S, S) float64, brightness, from `render_star` with the same pitch.
    segments
        Number of segments of a star.
    pitch_px
        Distance of neighbouring stars in the image, px.
    blur_px
        Standard deviation of the blur, px.

    Returns
    -------
    EdgeMap
        Point symmetric about the centre, as the print is.
    """
    # Half of the star is blurred and computed; the other half is the same, turned.
    half, sigma = len(sharp) // 2, blur_px * OVERSAMPLING
    reach = 2 * round(4.0 * sigma) + 1
    blurred = cv2.GaussianBlur(sharp[: half + 1 + reach], (2 * round(4.0 * sigma) + 1,) * 2, sigma)[
        : half + 1
    ]
    tau = blur_px * ndtri(np.clip(blurred, 1e-4, 1.0 - 1e-4))
    tau = np.concatenate([tau, tau[half - 1 :: -1, ::-1]])
    scale, limit_px = pitch_px * OVERSAMPLING, TAU_LIMIT_BLURS * blur_px
    edge = _nearest_edges(pitch_px, segments)
    return EdgeMap(tau.astype(np.float32), edge, len(sharp) // 2, scale, limit_px)


@lru_cache(maxsize=2)
def _nearest_edges(pitch_px: float, segments: int) -> NDArray[np.uint8]:
    """Return the number of the nearest edge at each sample; maps of one pitch share it, and only read it.

    Own definition: the edge at the nearest multiple of the angle between edges.
    """
    u, v = _grid(pitch_px)
    edge = np.round(np.arctan2(v, u) / (2.0 * np.pi) * segments) % segments
    return np.asarray(edge, np.uint8)
