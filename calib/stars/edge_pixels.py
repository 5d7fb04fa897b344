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
    """All pixels near an edge of N stars with E edges each: star by star, and in each star edge by edge.

    Attributes
    ----------
    first
        (N E + 1,) int64: edge e of star k has the pixels from first[k E + e] to first[k E + e + 1].
    tau
        (M,) float32, px, signed distance from the nearest edge, computed from the first centres.
    along_x, along_y
        (M,) float32, dimensionless, derivatives of tau with respect to the centre of the star.
    u, v
        (M,) float32, pitches, place in the star: derivatives of tau with respect to the slope of the threshold.
    level
        (M,) uint8, level of brightness.
    """

    first: NDArray[np.int64]
    tau: NDArray[np.float32]
    along_x: NDArray[np.float32]
    along_y: NDArray[np.float32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
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
    sample = np.sort(image.ravel()[:: max(1, image.size // 200_000)])
    values = sample[np.concatenate([[True], sample[1:] != sample[:-1]])]
    if values.size > LEVELS:
        # NumPy's quantiles would sort again: linear interpolation between the values next to each place.
        place = np.linspace(0.0, 1.0, LEVELS + 1)[1:-1] * (sample.size - 1)
        borders = np.unique(np.interp(place, np.arange(sample.size), sample))
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
    edges = int(edge_map.edge.max()) + 1
    first, level = np.zeros(len(centres) * edges + 1, np.int64), np.empty(m, np.uint8)
    # One block, since the system gives a large one in few pages.
    tau, along_x, along_y, u, v = np.empty((5, m), np.float32)
    found = EdgePixels(first, tau, along_x, along_y, u, v, level)
    reach = SYMMETRY_REACH * np.abs(linear).sum(axis=2)
    strip = edge_map.limit_px * OVERSAMPLING / edge_map.samples_per_pitch
    none = np.zeros((len(centres), 2), np.bool_)
    used_to = cell_reach(none if is_open is None else is_open, SYMMETRY_REACH, strip)
    most = int(room.max(initial=0.0)) + 1
    spaces = np.empty((5, most), np.float32), np.empty((2, most), np.uint8)
    inverse = np.linalg.inv(linear)
    _gather(levels, centres, inverse, local_map.quadratic, edge_map, edges, (reach, used_to), spaces, found)
    used = slice(int(first[-1]))
    return EdgePixels(first, tau[used], along_x[used], along_y[used], u[used], v[used], level[used])


@njit(cache=True, error_model="numpy")
def _gather(
    levels: Any,
    centres: Any,
    inverse: Any,
    quadratic: Any,
    edge_map: EdgeMap,
    edges: int,
    reaches: Any,
    spaces: Any,
    found: EdgePixels,
) -> None:
    """Interpolate tau and its derivatives at each pixel of each star's cell, and store those near an edge.

    ``inverse`` is (N, 2, 2), pitches per px. ``reaches`` are half the sides of the cells' bounding boxes, (N, 2), px,
    and of the part of each cell that is used, (N, 2), pitches. ``spaces`` hold the pixels of one star, (5, K) float64
    and (2, K) uint8, until they are sorted by their edges. The interpolation is bilinear (Abramowitz and Stegun, 1972,
    section 25.2). Own derivatives: tau changes by -grad tau A^-1 with the centre, by 1 with the threshold, and by s
    with its slope.
    """
    scale, half, limit = edge_map.samples_per_pitch, edge_map.half, edge_map.limit_px
    taus, nearest = edge_map.tau, edge_map.edge
    end = len(taus) - 1.000001
    reach, used_to = reaches
    values, kinds = spaces
    counts = np.empty(edges, np.int64)
    for k in range(len(centres)):
        x, y, to, bend = centres[k, 0], centres[k, 1], inverse[k], quadratic[k]
        low, high = int(max(0.0, y - reach[k, 1])), int(min(levels.shape[0] - 1.0, y + reach[k, 1] + 1.0))
        left, right = int(max(0.0, x - reach[k, 0])), int(min(levels.shape[1] - 1.0, x + reach[k, 0] + 1.0))
        used_u, used_v = used_to[k]
        # In variables of their own: the arrays could share memory with what is stored.
        u_x, u_y, v_x, v_y = to[0, 0], to[0, 1], to[1, 0], to[1, 1]
        x_uu, x_uv, x_vv = bend[0, 0], bend[0, 1], bend[0, 2]
        y_uu, y_uv, y_vv = bend[1, 0], bend[1, 1], bend[1, 2]
        # A cell reaches half a pitch, and a little more where the map bends; its bend is at most a quarter of the sum.
        bend_x, bend_y = abs(x_uu) + abs(x_uv) + abs(x_vv), abs(y_uu) + abs(y_uv) + abs(y_vv)
        limits = (
            used_u + abs(u_x) * bend_x + abs(u_y) * bend_y,
            used_v + abs(v_x) * bend_x + abs(v_y) * bend_y,
        )
        counts[:] = 0
        n = 0
        for r in range(low, high + 1):
            first, last = _columns(r - y, to, limits, left - x, right - x)
            for c in range(int(np.floor(x + first)), min(int(np.ceil(x + last)), right) + 1):
                if c < left:
                    continue
                dx, dy = c - x, r - y
                u, v = u_x * dx + u_y * dy, v_x * dx + v_y * dy
                dx -= x_uu * u * u + x_uv * u * v + x_vv * v * v
                dy -= y_uu * u * u + y_uv * u * v + y_vv * v * v
                u, v = u_x * dx + u_y * dy, v_x * dx + v_y * dy
                at_u, at_v = min(max(u * scale + half, 0.0), end), min(max(v * scale + half, 0.0), end)
                i, j = np.uint64(np.int64(at_v)), np.uint64(np.int64(at_u))
                a, b = at_u - j, at_v - i
                nw, ne = taus[i, j], taus[i, j + np.uint64(1)]
                sw, se = taus[i + np.uint64(1), j], taus[i + np.uint64(1), j + np.uint64(1)]
                tau = (1.0 - b) * ((1.0 - a) * nw + a * ne) + b * ((1.0 - a) * sw + a * se)
                along_u = ((1.0 - b) * (ne - nw) + b * (se - sw)) * scale
                along_v = ((1.0 - a) * (sw - nw) + a * (se - ne)) * scale
                e = nearest[i, j]
                values[0, n], values[3, n], values[4, n] = tau, u, v
                values[1, n] = -(u_x * along_u + v_x * along_v)
                values[2, n] = -(u_y * along_u + v_y * along_v)
                kinds[0, n], kinds[1, n] = levels[np.uint64(r), np.uint64(c)], e
                # Added as 0 or 1: a branch would be foreseen wrongly too often.
                near = int((abs(tau) < limit) & (abs(u) <= used_u) & (abs(v) <= used_v))
                counts[e] += near
                n += near
        _store_by_edge(values, kinds, n, counts, k * edges, found)


@njit(cache=True, error_model="numpy")
def _columns(dy: float, to: Any, limits: Any, left: float, right: float) -> tuple[float, float]:
    """Return the first and the last place in a row, px from the centre, at which the linear map is within limits.

    ``dy`` is the distance of the row, px; ``limits`` are along the columns and along the rows, pitches. Own rule.
    """
    for k in range(2):
        if abs(to[k, 0]) > 1e-9:
            one, other = (-limits[k] - to[k, 1] * dy) / to[k, 0], (limits[k] - to[k, 1] * dy) / to[k, 0]
            left, right = max(left, min(one, other)), min(right, max(one, other))
    return left, right


@njit(cache=True, error_model="numpy")
def _store_by_edge(values: Any, kinds: Any, n: int, counts: Any, group: int, found: EdgePixels) -> None:
    """Store the first ``n`` pixels of a star, sorted by their edges: a counting sort (Knuth, 1998)."""
    first, tau, along_x, along_y, u, v, level = found
    at = first[group]
    for e in range(len(counts)):
        counts[e], at = at, at + counts[e]
        first[group + e + 1] = at
    for i in range(n):
        edge = np.uint64(kinds[1, i])
        m = np.uint64(counts[edge])
        counts[edge] += 1
        tau[m], along_x[m], along_y[m] = values[0, i], values[1, i], values[2, i]
        u[m], v[m], level[m] = values[3, i], values[4, i], kinds[0, i]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def count_levels(pixels: EdgePixels, unknowns: Any, limit_px: float) -> Any:
    """Count the levels of all pixels over tau. Each pixel is shared between the two nearest bins.

    This is linear binning (Wand, 1994). Own linearisation of tau: tau + slope . unknowns.

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
    first, taus, along_x, along_y, us, vs, levels = pixels
    bins = int(2.0 * limit_px / TAU_BIN_PX)
    counts = np.zeros((LEVELS, bins))
    edges = (len(first) - 1) // max(len(unknowns), 1)
    for k in range(len(unknowns)):
        x, y, shift, slope_u, slope_v = unknowns[k]
        for m in range(first[k * edges], first[(k + 1) * edges]):
            tau = taus[m] + along_x[m] * x + along_y[m] * y + shift + us[m] * slope_u + vs[m] * slope_v
            at = (tau + limit_px) * _BINS_PER_PX
            if 0.0 <= at < bins - 1:
                i = np.uint64(at)
                counts[levels[m], i] += 1.0 - (at - i)
                counts[levels[m], i + np.uint64(1)] += at - i
    return counts


@njit(cache=True, error_model="numpy")
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
    scores = tables.score.ravel()
    for k in range(n):
        for e in range(edges):
            group = k * edges + e
            _add_edge(
                pixels,
                pixels.first[group],
                pixels.first[group + 1],
                unknowns[k],
                scores,
                tables.fisher,
                limit_px,
                score[k, e],
                fisher[k, e],
            )
    return score, fisher


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz", "nnan", "ninf"})
def _add_edge(
    pixels: EdgePixels,
    begin: int,
    end: int,
    unknowns: Any,
    scores: Any,
    fishers: Any,
    limit_px: float,
    score: Any,
    fisher: Any,
) -> None:
    """Sum score, (5,), and Fisher information, (5, 5), over the pixels of one edge of one star.

    ``scores`` are the rows of `ScoreTables.score`, one after the other. Fisher scoring: Osborne (1992). Every sum is a
    variable of its own, and there is no branch and no store in the loop, so that it runs over several pixels at once.
    """
    _, taus, along_x, along_y, us, vs, levels = pixels
    x, y, shift, slope_u, slope_v = unknowns[0], unknowns[1], unknowns[2], unknowns[3], unknowns[4]
    s0 = s1 = s2 = s3 = s4 = f00 = f10 = f11 = f20 = f21 = f22 = 0.0
    f30 = f31 = f32 = f33 = f40 = f41 = f42 = f43 = f44 = 0.0
    bins = fishers.size
    for m in range(begin, end):
        d0, d1, u, v = along_x[m], along_y[m], us[m], vs[m]
        at = (taus[m] + d0 * x + d1 * y + shift + u * slope_u + v * slope_v + limit_px) * _BINS_PER_PX
        known = 1.0 if at >= 0.0 and at < bins - 1 else 0.0
        at *= known
        i = np.int32(at)
        b, row = at - i, np.int32(levels[m]) * np.int32(bins) + i
        a = (1.0 - b) * known
        b *= known
        gradient = a * scores[np.uint64(row)] + b * scores[np.uint64(row + 1)]
        weight = a * fishers[np.uint64(i)] + b * fishers[np.uint64(i + 1)]
        w0, w1, w3, w4 = weight * d0, weight * d1, weight * u, weight * v
        s0, s1, s2, s3, s4 = (
            s0 + gradient * d0,
            s1 + gradient * d1,
            s2 + gradient,
            s3 + gradient * u,
            s4 + gradient * v,
        )
        f00, f10, f11 = f00 + w0 * d0, f10 + w1 * d0, f11 + w1 * d1
        f20, f21, f22 = f20 + w0, f21 + w1, f22 + weight
        f30, f31, f32, f33 = f30 + w3 * d0, f31 + w3 * d1, f32 + w3, f33 + w3 * u
        f40, f41, f42, f43, f44 = f40 + w4 * d0, f41 + w4 * d1, f42 + w4, f43 + w4 * u, f44 + w4 * v
    score[0], score[1], score[2], score[3], score[4] = s0, s1, s2, s3, s4
    fisher[0, 0], fisher[1, 0], fisher[1, 1] = f00, f10, f11
    fisher[2, 0], fisher[2, 1], fisher[2, 2] = f20, f21, f22
    fisher[3, 0], fisher[3, 1], fisher[3, 2], fisher[3, 3] = f30, f31, f32, f33
    fisher[4, 0], fisher[4, 1], fisher[4, 2], fisher[4, 3], fisher[4, 4] = f40, f41, f42, f43, f44
    for p in range(EDGE_UNKNOWNS):
        for q in range(p):
            fisher[q, p] = fisher[p, q]
