"""Pixels near the edges of stars: collected, counted by brightness, and the scores of each star's unknowns.

The module uses a quantised image, an `EdgeMap` and the places of stars. How many rounds are made, and how much weight
an edge has, is decided in `calib.stars.likelihood`. All compiled functions of the likelihood are here, next to those
that they call.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.stars.centring import SYMMETRY_REACH
from calib.stars.local_map import LocalMap
from calib.stars.open_sides import cell_reach
from calib.stars.printed_star import OVERSAMPLING, EdgeMap

#: Width of the bins of tau, px.
TAU_BIN_PX = 0.03
_BINS_PER_PX = 1.0 / TAU_BIN_PX
#: Largest number of levels of brightness.
LEVELS = 64
#: Number of unknowns of a star: shift of its centre x, y; shift of the threshold; slope of the threshold x, y.
EDGE_UNKNOWNS = 5


class EdgePixels(NamedTuple):
    """All pixels near an edge of N stars, one star after the other: star k has those from first[k] to first[k + 1].

    Attributes
    ----------
    first
        (N + 1,) int64, number of the first pixel of each star.
    tau
        (M,) float32, px, signed distance from the nearest edge, computed from the first centres.
    slope
        (M, 5) float32, derivatives of tau with respect to the unknowns of the star: dimensionless for centre and
        threshold, pitches for the slopes.
    edge
        (M,) uint8, number of the nearest edge.
    level
        (M,) uint8, level of brightness.
    """

    first: NDArray[np.int64]
    tau: NDArray[np.float32]
    slope: NDArray[np.float32]
    edge: NDArray[np.uint8]
    level: NDArray[np.uint8]


class ScoreTables(NamedTuple):
    """Statistics of a level P(level | tau), tabulated over bins of tau.

    Attributes
    ----------
    score
        (LEVELS, bins) float64, 1/px, d log P / d tau.
    fisher
        (bins,) float64, 1/px^2, Fisher information of a pixel about tau.
    """

    score: NDArray[np.float64]
    fisher: NDArray[np.float64]


#: Length of the table over the values of an image, from the first to the last border of levels.
_TABLE = 4096


def quantise(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Reduce an image to at most `LEVELS` levels of brightness.

    If the image has no more values than that, each value is a level. Otherwise the levels have equal shares of the
    pixels. Levels of equal shares are those of histogram equalisation (Gonzalez and Woods, 2018).

    Parameters
    ----------
    image
        (H, W) of any integer or floating type, without nan.

    Returns
    -------
    array
        (H, W) uint8, levels from 0, in the order of brightness.

    Examples
    --------
    >>> quantise(np.array([[0.0, 0.5], [1.0, 0.5]])).tolist()
    [[0, 1], [2, 1]]
    """
    sample = image.ravel()[:: max(1, image.size // 200_000)]
    values = np.unique(sample)
    if values.size > LEVELS:
        borders = np.unique(np.quantile(sample, np.linspace(0.0, 1.0, LEVELS + 1)[1:-1]))
    else:
        borders = (values[1:].astype(float) + values[:-1].astype(float)) / 2.0
    if image.dtype.kind == "u" and image.dtype.itemsize <= 2:
        every = np.arange(int(image.max()) + 1)
        return np.searchsorted(borders, every, side="right").astype(np.uint8)[image]
    return _levels_of(np.ascontiguousarray(image), np.asarray(borders, float))


@njit(cache=True, error_model="numpy")
def _levels_of(image: Any, borders: Any) -> Any:
    """Return for each pixel how many borders are at most its value, (H, W) uint8.

    The search starts from a table over the values, and bisects what the table leaves open.
    """
    levels = np.zeros(image.shape, np.uint8)
    if len(borders) == 0:
        return levels
    low, high = borders[0], borders[-1]
    scale = _TABLE / (high - low) if high > low else 0.0
    table = np.empty(_TABLE + 1, np.int64)
    for i in range(_TABLE):
        table[i] = np.searchsorted(borders, low + i / scale if scale > 0.0 else low)
    table[_TABLE] = len(borders)
    for r in range(image.shape[0]):
        for c in range(image.shape[1]):
            value = float(image[r, c])
            if value < low:
                continue
            if value >= high:
                levels[r, c] = len(borders)
                continue
            i = min(int((value - low) * scale), _TABLE - 1)
            # One place more on both sides: the table is rounded.
            first, end = max(table[i] - 1, 0), min(table[i + 1] + 1, len(borders))
            while first < end:
                middle = (first + end) // 2
                if borders[middle] <= value:
                    first = middle + 1
                else:
                    end = middle
            levels[r, c] = first
    return levels


def gather_edge_pixels(
    levels: NDArray[np.uint8],
    centres: NDArray[np.float64],
    local_map: LocalMap,
    edge_map: EdgeMap,
    is_open: NDArray[np.bool_] | None = None,
) -> EdgePixels:
    """Collect the pixels near edges of all stars.

    Own derivation: a pixel at q belongs to the place s in the star with q = c + A s + B(s, s). It is found by s0 = A^-1
    (q - c) and then s = A^-1 (q - c - B(s0, s0)).

    Parameters
    ----------
    levels
        (H, W) uint8, from `quantise`.
    centres
        (N, 2) float64, px.
    local_map
        Map around each star, from the target plane to the image.
    edge_map
        Printed star with which the pixels are compared.
    is_open
        (N, 2) bool, from `calib.stars.open_sides.open_sides`; None if all stars lie between stars. Pixels as close to
        an open side as the limit of the edge map are left out.

    Returns
    -------
    EdgePixels
        Those whose distance from an edge is below the limit of the edge map.
    """
    linear = local_map.linear
    sides = 2.0 * SYMMETRY_REACH * np.abs(linear).sum(axis=(1, 2))
    room = np.abs(np.linalg.det(linear)) * (2.0 * SYMMETRY_REACH) ** 2 + 2.0 * sides + 16.0
    m = int(room.sum())
    found = EdgePixels(
        np.zeros(len(centres) + 1, np.int64),
        np.empty(m, np.float32),
        np.empty((m, EDGE_UNKNOWNS), np.float32),
        np.empty(m, np.uint8),
        np.empty(m, np.uint8),
    )
    reach = SYMMETRY_REACH * np.abs(linear).sum(axis=2)
    strip = edge_map.limit_px * OVERSAMPLING / edge_map.samples_per_pitch
    none = np.zeros((len(centres), 2), np.bool_)
    used_to = cell_reach(none if is_open is None else is_open, SYMMETRY_REACH, strip)
    _gather(levels, centres, np.linalg.inv(linear), local_map.quadratic, edge_map, (reach, used_to), found)
    used = int(found.first[-1])
    return EdgePixels(
        found.first, found.tau[:used], found.slope[:used], found.edge[:used], found.level[:used]
    )


@njit(cache=True, error_model="numpy")
def _gather(
    levels: Any,
    centres: Any,
    inverse: Any,
    quadratic: Any,
    edge_map: EdgeMap,
    reaches: Any,
    found: EdgePixels,
) -> None:
    """Interpolate tau and its derivatives at each pixel of each star's cell, and store those near an edge.

    ``inverse`` is (N, 2, 2), pitches per px. ``reaches`` are half the sides of the cells' bounding boxes, (N, 2), px,
    and of the part of each cell that is used, (N, 2), pitches. The interpolation is bilinear (Abramowitz and Stegun,
    1972, section 25.2). Own derivatives: tau changes by -grad tau A^-1 with the centre, by 1 with the threshold, and by
    s with its slope.
    """
    m = 0
    scale = edge_map.samples_per_pitch
    reach, used_to = reaches
    for k in range(len(centres)):
        x, y, to, bend = centres[k, 0], centres[k, 1], inverse[k], quadratic[k]
        low, high = int(max(0.0, y - reach[k, 1])), int(min(levels.shape[0] - 1.0, y + reach[k, 1] + 1.0))
        left, right = int(max(0.0, x - reach[k, 0])), int(min(levels.shape[1] - 1.0, x + reach[k, 0] + 1.0))
        for r in range(low, high + 1):
            for c in range(left, right + 1):
                dx, dy = c - x, r - y
                u, v = to[0, 0] * dx + to[0, 1] * dy, to[1, 0] * dx + to[1, 1] * dy
                dx -= bend[0, 0] * u * u + bend[0, 1] * u * v + bend[0, 2] * v * v
                dy -= bend[1, 0] * u * u + bend[1, 1] * u * v + bend[1, 2] * v * v
                u, v = to[0, 0] * dx + to[0, 1] * dy, to[1, 0] * dx + to[1, 1] * dy
                if abs(u) > used_to[k, 0] or abs(v) > used_to[k, 1]:
                    continue
                i, j = int(v * scale + edge_map.half), int(u * scale + edge_map.half)
                a, b = u * scale + edge_map.half - j, v * scale + edge_map.half - i
                nw, ne = edge_map.tau[i, j], edge_map.tau[i, j + 1]
                sw, se = edge_map.tau[i + 1, j], edge_map.tau[i + 1, j + 1]
                tau = (1.0 - b) * ((1.0 - a) * nw + a * ne) + b * ((1.0 - a) * sw + a * se)
                if abs(tau) >= edge_map.limit_px:
                    continue
                along_u = ((1.0 - b) * (ne - nw) + b * (se - sw)) * scale
                along_v = ((1.0 - a) * (sw - nw) + a * (se - ne)) * scale
                found.tau[m], found.edge[m], found.level[m] = tau, edge_map.edge[i, j], levels[r, c]
                found.slope[m, 0] = -(to[0, 0] * along_u + to[1, 0] * along_v)
                found.slope[m, 1] = -(to[0, 1] * along_u + to[1, 1] * along_v)
                found.slope[m, 2], found.slope[m, 3], found.slope[m, 4] = 1.0, u, v
                m += 1
        found.first[k + 1] = m


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _tau_bin(pixels: EdgePixels, m: int, unknowns: Any, limit_px: float) -> float:
    """Return the bin of tau of a pixel, with its fraction, for the current unknowns of its star.

    Own linearisation: tau + slope . unknowns.
    """
    tau = pixels.tau[m]
    for p in range(EDGE_UNKNOWNS):
        tau += pixels.slope[m, p] * unknowns[p]
    return (tau + limit_px) * _BINS_PER_PX


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def count_levels(pixels: EdgePixels, unknowns: Any, limit_px: float) -> Any:
    """Count the levels of all pixels over tau. Each pixel is shared between the two nearest bins.

    This is linear binning (Wand, 1994).

    Parameters
    ----------
    pixels
        Pixels near edges.
    unknowns
        (N, 5) float64, px and px per pitch, current unknowns of the stars.
    limit_px
        Largest distance from an edge, `EdgeMap.limit_px`.

    Returns
    -------
    array
        (LEVELS, bins) float64, numbers of pixels.
    """
    bins = int(2.0 * limit_px / TAU_BIN_PX)
    counts = np.zeros((LEVELS, bins))
    for k in range(len(unknowns)):
        for m in range(pixels.first[k], pixels.first[k + 1]):
            at = _tau_bin(pixels, m, unknowns[k], limit_px)
            if 0.0 <= at < bins - 1:
                i = int(at)
                counts[pixels.level[m], i] += 1.0 - (at - i)
                counts[pixels.level[m], i + 1] += at - i
    return counts


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def edge_scores(
    pixels: EdgePixels, unknowns: Any, tables: ScoreTables, limit_px: float, edges: int
) -> tuple[Any, Any]:
    """Sum the scores and the Fisher information of the unknowns over the pixels of each edge of each star.

    Scores and information are those of Fisher scoring (Osborne, 1992), each times the derivatives of tau.

    Parameters
    ----------
    pixels
        Pixels near edges.
    unknowns
        (N, 5) float64, px and px per pitch, current unknowns of the stars.
    tables
        Score and information of one pixel, over level and tau.
    limit_px
        Largest distance from an edge, `EdgeMap.limit_px`.
    edges
        Number of edges of a star.

    Returns
    -------
    score : array
        (N, edges, 5) float64, derivatives of log L with respect to the unknowns.
    fisher : array
        (N, edges, 5, 5) float64, Fisher information of the unknowns.
    """
    n = len(unknowns)
    score, fisher = np.zeros((n, edges, EDGE_UNKNOWNS)), np.zeros((n, edges, EDGE_UNKNOWNS, EDGE_UNKNOWNS))
    for k in range(n):
        for m in range(pixels.first[k], pixels.first[k + 1]):
            at = _tau_bin(pixels, m, unknowns[k], limit_px)
            if not 0.0 <= at < tables.fisher.size - 1:
                continue
            i = int(at)
            a, level, e = at - i, pixels.level[m], pixels.edge[m]
            gradient = (1.0 - a) * tables.score[level, i] + a * tables.score[level, i + 1]
            information = (1.0 - a) * tables.fisher[i] + a * tables.fisher[i + 1]
            # Written out: the unknowns of a star are few, and the loop over them takes longer than the sums.
            row, s, f = pixels.slope[m], score[k, e], fisher[k, e]
            d0, d1, d2, d3, d4 = row[0], row[1], row[2], row[3], row[4]
            s[0] += gradient * d0
            s[1] += gradient * d1
            s[2] += gradient * d2
            s[3] += gradient * d3
            s[4] += gradient * d4
            w0, w1, w2 = information * d0, information * d1, information * d2
            w3, w4 = information * d3, information * d4
            f[0, 0] += w0 * d0
            f[1, 0] += w1 * d0
            f[1, 1] += w1 * d1
            f[2, 0] += w2 * d0
            f[2, 1] += w2 * d1
            f[2, 2] += w2 * d2
            f[3, 0] += w3 * d0
            f[3, 1] += w3 * d1
            f[3, 2] += w3 * d2
            f[3, 3] += w3 * d3
            f[4, 0] += w4 * d0
            f[4, 1] += w4 * d1
            f[4, 2] += w4 * d2
            f[4, 3] += w4 * d3
            f[4, 4] += w4 * d4
        for e in range(edges):
            for p in range(EDGE_UNKNOWNS):
                for q in range(p):
                    fisher[k, e, q, p] = fisher[k, e, p, q]
    return score, fisher
