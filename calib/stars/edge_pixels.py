"""Pixels near the edges of stars: gathered, counted by level of brightness, and what they say of a star's centre.

Knows a quantised image, a drawn star and places of stars; nothing of how many rounds are made of it or of how much
an edge is trusted. The kernels stand together here, as each is compiled with those it calls.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.stars.centring import SYMMETRY_REACH
from calib.stars.printed_star import EdgeMap

#: Bins of tau, px.
TAU_BIN_PX = 0.03
#: Levels of brightness told apart.
LEVELS = 64
#: Centre x, y; shift of the threshold; its slopes.
UNKNOWNS = 5


class EdgePixels(NamedTuple):
    """All pixels near an edge of all stars, one after the other; star k has those from first[k] to first[k + 1].

    Attributes
    ----------
    first
        (N + 1,) int64.
    tau
        (M,) px, by the centres first given.
    slope
        (M, 5) float32, how tau changes with each of the star's unknowns.
    edge, level
        (M,) uint8, number of the nearest edge, level of brightness.
    """

    first: NDArray[np.int64]
    tau: NDArray[np.float32]
    slope: NDArray[np.float32]
    edge: NDArray[np.uint8]
    level: NDArray[np.uint8]


class ScoreTables(NamedTuple):
    """Of the levels' probabilities over tau: d log P / d tau (levels, bins), and Fisher's information (bins,)."""

    score: NDArray[np.float64]
    fisher: NDArray[np.float64]


def quantise(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return an image as at most `LEVELS` levels, (H, W): its own values where they are few, else equal shares.

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
    return np.searchsorted(borders, image, side="right").astype(np.uint8)


def gather_edge_pixels(
    levels: NDArray[np.uint8],
    centres: NDArray[np.float64],
    linear: NDArray[np.float64],
    curved: NDArray[np.float64],
    drawn: EdgeMap,
) -> EdgePixels:
    """Gather the pixels near edges of all stars.

    Parameters
    ----------
    levels
        (H, W) from `quantise`.
    centres
        (N, 2) px.
    linear, curved
        (N, 2, 2) and (N, 2, 3), the map around each star, as in `calib.stars.centring.LocalMap`.
    drawn
        The star they are held against.
    """
    sides = 2.0 * SYMMETRY_REACH * np.abs(linear).sum(axis=(1, 2))
    room = np.abs(np.linalg.det(linear)) * (2.0 * SYMMETRY_REACH) ** 2 + 2.0 * sides + 16.0
    m = int(room.sum())
    found = EdgePixels(
        np.zeros(len(centres) + 1, np.int64),
        np.empty(m, np.float32),
        np.empty((m, UNKNOWNS), np.float32),
        np.empty(m, np.uint8),
        np.empty(m, np.uint8),
    )
    _gather(
        levels,
        centres,
        np.linalg.inv(linear),
        curved,
        drawn,
        SYMMETRY_REACH * np.abs(linear).sum(axis=2),
        found,
    )
    used = int(found.first[-1])
    return EdgePixels(
        found.first, found.tau[:used], found.slope[:used], found.edge[:used], found.level[:used]
    )


@njit(cache=True, error_model="numpy")
def _gather(
    levels: Any, centres: Any, inverse: Any, curved: Any, drawn: EdgeMap, reach: Any, found: EdgePixels
) -> None:
    """Read tau of each pixel of each star's cell off the drawn star."""
    m = 0
    scale = drawn.samples_per_pitch
    for k in range(len(centres)):
        x, y, to, bend = centres[k, 0], centres[k, 1], inverse[k], curved[k]
        low, high = int(max(0.0, y - reach[k, 1])), int(min(levels.shape[0] - 1.0, y + reach[k, 1] + 1.0))
        left, right = int(max(0.0, x - reach[k, 0])), int(min(levels.shape[1] - 1.0, x + reach[k, 0] + 1.0))
        for r in range(low, high + 1):
            for c in range(left, right + 1):
                dx, dy = c - x, r - y
                u, v = to[0, 0] * dx + to[0, 1] * dy, to[1, 0] * dx + to[1, 1] * dy
                dx -= bend[0, 0] * u * u + bend[0, 1] * u * v + bend[0, 2] * v * v
                dy -= bend[1, 0] * u * u + bend[1, 1] * u * v + bend[1, 2] * v * v
                u, v = to[0, 0] * dx + to[0, 1] * dy, to[1, 0] * dx + to[1, 1] * dy
                if abs(u) > SYMMETRY_REACH or abs(v) > SYMMETRY_REACH:
                    continue
                i, j = int(v * scale + drawn.half), int(u * scale + drawn.half)
                a, b = u * scale + drawn.half - j, v * scale + drawn.half - i
                nw, ne = drawn.tau[i, j], drawn.tau[i, j + 1]
                sw, se = drawn.tau[i + 1, j], drawn.tau[i + 1, j + 1]
                tau = (1.0 - b) * ((1.0 - a) * nw + a * ne) + b * ((1.0 - a) * sw + a * se)
                if abs(tau) >= drawn.limit_px:
                    continue
                along_u = ((1.0 - b) * (ne - nw) + b * (se - sw)) * scale
                along_v = ((1.0 - a) * (sw - nw) + a * (se - ne)) * scale
                found.tau[m], found.edge[m], found.level[m] = tau, drawn.edge[i, j], levels[r, c]
                found.slope[m, 0] = -(to[0, 0] * along_u + to[1, 0] * along_v)
                found.slope[m, 1] = -(to[0, 1] * along_u + to[1, 1] * along_v)
                found.slope[m, 2], found.slope[m, 3], found.slope[m, 4] = 1.0, u, v
                m += 1
        found.first[k + 1] = m


@njit(cache=True, error_model="numpy")
def _tau_bin(pixels: EdgePixels, m: int, unknowns: Any, limit_px: float) -> float:
    """Bin of tau, with its fraction, of a pixel by a star's present unknowns."""
    tau = pixels.tau[m]
    for p in range(UNKNOWNS):
        tau += pixels.slope[m, p] * unknowns[p]
    return (tau + limit_px) / TAU_BIN_PX


@njit(cache=True, error_model="numpy")
def count_levels(pixels: EdgePixels, unknowns: Any, limit_px: float) -> Any:
    """(levels, bins): count the pixels' levels over tau, each shared between the two nearest bins.

    ``unknowns`` is (N, 5), ``limit_px`` the print's.
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


@njit(cache=True, error_model="numpy")
def edge_scores(
    pixels: EdgePixels, unknowns: Any, tables: ScoreTables, limit_px: float, edges: int
) -> tuple[Any, Any]:
    """Derivatives of log L and information of the unknowns: (N, edges, 5) and (N, edges, 5, 5)."""
    n = len(unknowns)
    score, fisher = np.zeros((n, edges, UNKNOWNS)), np.zeros((n, edges, UNKNOWNS, UNKNOWNS))
    for k in range(n):
        for m in range(pixels.first[k], pixels.first[k + 1]):
            at = _tau_bin(pixels, m, unknowns[k], limit_px)
            if not 0.0 <= at < tables.fisher.size - 1:
                continue
            i = int(at)
            a, level, e = at - i, pixels.level[m], pixels.edge[m]
            pull = (1.0 - a) * tables.score[level, i] + a * tables.score[level, i + 1]
            told = (1.0 - a) * tables.fisher[i] + a * tables.fisher[i + 1]
            for p in range(UNKNOWNS):
                d = pixels.slope[m, p]
                score[k, e, p] += pull * d
                for q in range(p + 1):
                    fisher[k, e, p, q] += told * d * pixels.slope[m, q]
        for e in range(edges):
            for p in range(UNKNOWNS):
                for q in range(p):
                    fisher[k, e, q, p] = fisher[k, e, p, q]
    return score, fisher
