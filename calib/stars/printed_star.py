"""A printed star, finely sampled: at each place the nearest edge and its distance; and the open sides of its cell.

Next to the tag, and at the border of the pattern, a star has plain paper on one side. Light from there reaches into its
cell on that side only: in an image that is black and white at a low share of the light, this moves the star by 0.03 px.
So the strip of the cell next to the paper is left out, and the opposite one too, so that what is left is point
symmetric. No image is used.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import ndtri

from calib.arrays import Array, Array32, Bools, Bytes, Ints
from calib.target import StarTarget

#: Samples of the printed star per px.
OVERSAMPLING = 6
#: Half the side of the printed star's image, pitches: the star and the rim of its neighbours.
REACH = 0.62
#: Largest distance from an edge that is used, in units of the blur: farther off, less than 0.1 % of the brightness
#: tells it.
TAU_LIMIT_BLURS = 3.2
#: Number of steps of the brightness for which the distance from an edge is tabulated, right to 1e-5 between them.
_QUANTILES = 1 << 16
#: Least brightness for which a distance is computed, and least darkness: 3.7 blurs off, beyond `TAU_LIMIT_BLURS`.
_LEAST_SHARE = 1e-4
#: Least half side of the part of a cell that is used, pitches, however wide the blur is: about half stays.
MIN_REACH = 0.25


class EdgeMap(NamedTuple):
    """Distances from the edges of one printed star, sampled on a square grid around its centre."""

    tau: Array32  # (S, S) float32, px, signed distance from the nearest edge; positive on white
    edge: Bytes  # (S, S) uint8, number of the nearest edge, 0 to the number of segments - 1
    half: int
    samples_per_pitch: float  # Number of samples per pitch
    limit_px: float  # Largest distance that is used, px


def render_star(target: StarTarget, pitch_px: float) -> Array32:
    """Draw the print around a star with all eight neighbours, (S, S) brightness 0 to 1, on the grid of an `EdgeMap`."""
    x, y = (float(place) for place in next(iter(target.surrounded), (1, 1)))
    steps = _steps(pitch_px)
    v, u = np.meshgrid(steps[: len(steps) // 2 + 1], steps, indexing="ij")
    first = target.reflectance((x + u) * target.pitch_mm, (y + v) * target.pitch_mm)
    other = target.reflectance((x - u) * target.pitch_mm, (y - v) * target.pitch_mm)
    # By rounding, samples on an edge fall to either side of it. The mean with half a turn makes the star symmetric.
    upper = (0.5 * (first + other)).astype(np.float32)
    return np.concatenate([upper, upper[-2::-1, ::-1]])


def _steps(pitch_px: float) -> Array:
    """Return the places of the samples of an `EdgeMap` along an axis, pitches from the star, (S,)."""
    half = int(np.ceil(REACH * pitch_px * OVERSAMPLING))
    return np.asarray(np.arange(-half, half + 1) / (pitch_px * OVERSAMPLING))


def blurred_edge_map(sharp: Array32, segments: int, pitch_px: float, blur_px: float) -> EdgeMap:
    """Blur a printed star, (S, S), and compute the distances from its edges from the blurred brightness.

    A straight edge blurred by a Gaussian of standard deviation sigma has the brightness Phi(tau / sigma) at distance
    tau, so tau = sigma Phi^-1(brightness). Own derivation: the Gaussian is integrated over the white side of the edge.
    """
    # Half of the star is blurred and computed; the other half is the same, turned.
    half, sigma = len(sharp) // 2, blur_px * OVERSAMPLING
    reach = round(4.0 * sigma)
    blurred = cv2.GaussianBlur(sharp[: half + 1 + reach], (2 * reach + 1,) * 2, sigma)[: half + 1]
    places = np.clip(blurred, _LEAST_SHARE, 1.0 - _LEAST_SHARE) * np.float32(_QUANTILES)
    below = places.astype(np.int32)
    quantiles, steps = _normal_quantiles()
    tau = np.float32(blur_px) * (quantiles[below] + (places - below.astype(np.float32)) * steps[below])
    tau = np.concatenate([tau, tau[half - 1 :: -1, ::-1]])
    scale, limit_px = pitch_px * OVERSAMPLING, TAU_LIMIT_BLURS * blur_px
    edge = _nearest_edges(pitch_px, segments)
    return EdgeMap(tau, edge, len(sharp) // 2, scale, limit_px)


@lru_cache(maxsize=1)
def _normal_quantiles() -> tuple[Array32, Array32]:
    """Return Phi^-1 at `_QUANTILES` steps of brightness, and its increases; interpolation is right to 1e-5."""
    shares = np.arange(_QUANTILES + 1) / _QUANTILES
    values = ndtri(np.clip(shares, 0.5 * _LEAST_SHARE, 1.0 - 0.5 * _LEAST_SHARE))
    return np.asarray(values[:-1], np.float32), np.asarray(np.diff(values), np.float32)


@lru_cache(maxsize=2)
def _nearest_edges(pitch_px: float, segments: int) -> Bytes:
    """Return the number of the nearest edge, by angle, at each sample; maps of one pitch share it, read only."""
    u, v = np.meshgrid(_steps(pitch_px), _steps(pitch_px))
    edge = np.round(np.arctan2(v, u) / (2.0 * np.pi) * segments) % segments
    return np.asarray(edge, np.uint8)


def open_sides(target: StarTarget, nodes: Ints) -> Bools:
    """Return (N, 2) whether stars lack a printed neighbour to the left or right, and above or below.

    A star that touches the plain paper with one corner counts as open along the columns: the strips on its left and on
    its right hold all its corners. Own rule. A node without a star counts as not open.
    """
    columns, rows = nodes[:, 0], nodes[:, 1]

    def missing(across: int, down: int) -> Bools:
        return np.asarray(target.id_at(columns + across, rows + down) < 0)

    at_sides, above = missing(-1, 0) | missing(1, 0), missing(0, -1) | missing(0, 1)
    corner = missing(-1, -1) | missing(1, -1) | missing(-1, 1) | missing(1, 1)
    is_open = np.column_stack([at_sides | (corner & ~above), above])
    return is_open & (target.id_at(columns, rows) >= 0)[:, None]


def cell_reach(is_open: Bools, reach: float, strip: float) -> Array:
    """Return (N, 2) how far from its centre a star's cell is used, pitches; ``reach`` is half the side between stars.

    >>> cell_reach(np.array([[False, True]]), 0.49, 0.1).round(2).tolist()
    [[0.49, 0.39]]
    """
    return np.where(is_open, max(reach - strip, MIN_REACH), reach)
