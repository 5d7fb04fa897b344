"""Pixels near the edges of stars: collected star by star, their levels of brightness, and the scores of the unknowns.

How many rounds are made, and how much weight an edge has, is decided in `calib.stars.likelihood`. All compiled
functions of the likelihood are here, next to those that they call.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.arrays import Array, Array32, Bools, Bytes, Ints
from calib.compiled import INNER, KERNEL
from calib.stars.centring import SYMMETRY_REACH
from calib.stars.grid_map import LocalMap
from calib.stars.printed_star import OVERSAMPLING, EdgeMap, cell_reach

#: Width of the bins of tau, px: finer than the narrowest smoothing (`calib.stars.likelihood.BANDWIDTHS_PX`).
TAU_BIN_PX = 0.03
_BINS_PER_PX = 1.0 / TAU_BIN_PX
#: Largest number of levels of brightness: six steps of bisection (`_levels_of`). More need more pixels for each level.
LEVELS = 64
#: Number of unknowns of a star: shift of its centre x, y; shift of the threshold; slope of the threshold x, y.
EDGE_UNKNOWNS = 5


class EdgePixels(NamedTuple):
    """All pixels near an edge of N stars with E edges each: star by star, and in each star edge by edge."""

    # (N E + 1,) int64: edge e of star k has the pixels from first[k E + e] to first[k E + e + 1].
    first: Ints
    # (M,) float32, px, signed distance from the nearest edge, computed from the first centres.
    tau: Array32
    along_x: Array32  # (M,) float32, derivative of tau with respect to the x of the star's centre
    along_y: Array32  # (M,) float32, derivative of tau with respect to the y of the star's centre
    u: Array32  # (M,) float32, pitches, place in the star: derivative of tau by the threshold's slope
    v: Array32  # (M,) float32, pitches, the same along the other axis
    level: Bytes  # (M,) uint8, level of brightness


def gather_edge_pixels(
    levels: Bytes, centres: Array, local_map: LocalMap, edge_map: EdgeMap, is_open: Bools | None = None
) -> EdgePixels:
    """Collect the pixels near edges of all stars.

    Own derivation: a pixel at q belongs to the place s in the star with q = c + A s + B(s, s). It is found by s0 = A^-1
    (q - c) and then s = A^-1 (q - c - B(s0, s0)). Pixels as close to an open side (`calib.stars.printed_star`) as the
    limit of the edge map are left out. The levels are from `quantise`, the (N, 2) centres in px.
    """
    edges = int(edge_map.edge.max()) + 1
    strip = edge_map.limit_px * OVERSAMPLING / edge_map.samples_per_pitch
    none = np.zeros((len(centres), 2), np.bool_)
    used_to = cell_reach(none if is_open is None else is_open, SYMMETRY_REACH, strip)
    linear = local_map.linear
    reach = SYMMETRY_REACH * np.abs(linear).sum(axis=2)  # half the sides of the cells' bounding boxes, px
    # One block, since the system gives a large one in few pages.
    room = int((2.0 * reach + 4.0).prod(axis=1).sum())
    first, level = np.zeros(len(centres) * edges + 1, np.int64), np.empty(room, np.uint8)
    tau, along_x, along_y, u, v = np.empty((5, room), np.float32)
    pixels = EdgePixels(first, tau, along_x, along_y, u, v, level)
    # In the order of rows, as the kernel is compiled once.
    inverse = np.ascontiguousarray(np.linalg.inv(linear), np.float64)
    back = LocalMap(inverse, np.ascontiguousarray(local_map.quadratic))
    _gather(levels, np.ascontiguousarray(centres), reach, used_to, back, edge_map, pixels)
    used = slice(int(first[-1]))
    return EdgePixels(first, tau[used], along_x[used], along_y[used], u[used], v[used], level[used])


@njit(**KERNEL)
def _gather(
    levels: Any, centres: Any, reach: Any, used_to: Any, back: LocalMap, edge_map: EdgeMap, pixels: EdgePixels
) -> None:
    """Store the pixels near an edge of each star's cell, sorted by edges (counting sort: Knuth, 1998).

    The interpolation is bilinear (Abramowitz and Stegun, 1972, section 25.2). Own derivatives: tau changes by -grad tau
    A^-1 with the centre, by 1 with the threshold, and by s with its slope.
    reach: (N, 2) px. used_to: (N, 2) pitches. back: the local maps, with the inverses of their linear parts.
    """
    height, width = levels.shape
    edges, most = (len(pixels.first) - 1) // max(len(centres), 1), 0.0
    for k in range(len(centres)):
        most = max(most, (2.0 * reach[k, 0] + 4.0) * (2.0 * reach[k, 1] + 4.0))
    # Space for the pixels of one star: tau to v, and their levels and edges.
    space, small = np.empty((5, int(most)), np.float32), np.empty((2, int(most)), np.uint8)
    taus, nearest, step = edge_map.tau, edge_map.edge, np.uint64(1)
    scale, half, limit_px = edge_map.samples_per_pitch, edge_map.half, edge_map.limit_px
    counts = np.empty(edges, np.int64)
    us, vs = np.empty(width), np.empty(width)
    for k in range(len(centres)):
        # Every number is a variable of its own: arrays could share memory, and would be read again for each pixel.
        x, y, u_to, v_to = centres[k, 0], centres[k, 1], used_to[k, 0], used_to[k, 1]
        inverse, bend = back.linear[k], back.quadratic[k]
        u_x, u_y, v_x, v_y = inverse[0, 0], inverse[0, 1], inverse[1, 0], inverse[1, 1]
        x_uu, x_uv, x_vv = bend[0, 0], bend[0, 1], bend[0, 2]
        y_uu, y_uv, y_vv = bend[1, 0], bend[1, 1], bend[1, 2]
        left, right = int(max(0.0, x - reach[k, 0])), int(min(width - 1.0, x + reach[k, 0] + 1.0))
        n: Any = np.uint64(0)
        counts[:] = 0
        for r in range(int(max(0.0, y - reach[k, 1])), int(min(height - 1.0, y + reach[k, 1] + 1.0)) + 1):
            # A loop without branches runs over several pixels at once.
            for i in range(right - left + 1):
                dx = np.int32(left + i) - x
                u, v = u_x * dx + u_y * (r - y), v_x * dx + v_y * (r - y)
                ax = dx - x_uu * u * u - x_uv * u * v - x_vv * v * v
                ay = r - y - y_uu * u * u - y_uv * u * v - y_vv * v * v
                us[i], vs[i] = u_x * ax + u_y * ay, v_x * ax + v_y * ay
            for c in range(left, right + 1):
                u, v = us[c - left], vs[c - left]
                if abs(u) > u_to or abs(v) > v_to:
                    continue
                at_u, at_v = u * scale + half, v * scale + half
                row, column = int(at_v), int(at_u)
                a, b, p, q = at_u - column, at_v - row, np.uint64(row), np.uint64(column)
                upper = taus[p, q + step] - taus[p, q]
                lower = taus[p + step, q + step] - taus[p + step, q]
                above, below = taus[p, q] + a * upper, taus[p + step, q] + a * lower
                tau, edge = above + b * (below - above), nearest[p, q]
                along_u, along_v = (upper + b * (lower - upper)) * scale, (below - above) * scale
                space[0, n], space[3, n], space[4, n] = tau, u, v
                space[1, n] = -(u_x * along_u + v_x * along_v)
                space[2, n] = -(u_y * along_u + v_y * along_v)
                small[0, n], small[1, n] = levels[np.uint64(r), np.uint64(c)], edge
                # Added as 0 or 1: a branch would be foreseen wrongly too often.
                near = np.uint64(abs(tau) < limit_px)
                counts[np.uint64(edge)] += near
                n += near
        _store_by_edge(space, small, n, counts, k * edges, pixels)


@njit(**INNER)
def _store_by_edge(space: Any, small: Any, n: Any, counts: Any, group: int, pixels: EdgePixels) -> None:
    """Store the first ``n`` pixels of a star sorted by their edges, of which there are ``counts`` (counting sort)."""
    start = pixels.first[group]
    for e in range(len(counts)):
        counts[e], start = start, start + counts[e]
        pixels.first[group + e + 1] = start
    for i in range(n):
        m = np.uint64(i)
        edge = np.uint64(small[1, m])
        at = np.uint64(counts[edge])
        counts[edge] += 1
        pixels.tau[at], pixels.along_x[at], pixels.along_y[at] = space[0, m], space[1, m], space[2, m]
        pixels.u[at], pixels.v[at], pixels.level[at] = space[3, m], space[4, m], small[0, m]


class ScoreTables(NamedTuple):
    """Statistics of a level P(level | tau), tabulated over bins of tau."""

    score: Array32  # (LEVELS, bins) float32, 1/px, d log P / d tau
    fisher: Array32  # (bins,) float32, 1/px^2, Fisher information of a pixel about tau


def quantise(image: NDArray[Any]) -> Bytes:
    """Reduce an image without nan to at most `LEVELS` levels of brightness, from 0.

    If the image has no more values than that, each value is a level. Otherwise the levels have equal shares of the
    pixels, as those of histogram equalisation (Gonzalez and Woods, 2018).

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
    pixels = np.ravel(image if image.dtype == np.float32 else image.astype(np.float64))
    padded = np.append(borders, np.full(LEVELS - 1 - len(borders), np.inf))
    return np.asarray(np.minimum(_levels_of(pixels, padded), len(borders)).reshape(image.shape), np.uint8)


@njit(**KERNEL)
def _levels_of(values: Any, borders: Any) -> Any:
    """Return for each of (N,) values how many of `LEVELS` - 1 ascending borders are not above it, (N,) uint8.

    Bisection in as many steps for each value, without a branch: with branches, it takes five times as long.
    """
    levels = np.empty(values.size, np.uint8)
    for i in range(values.size):
        n: Any = np.uint64(0)
        for step in (32, 16, 8, 4, 2, 1):
            n += np.uint64(step) * np.uint64(not values[i] < borders[n + np.uint64(step - 1)])
        levels[i] = n
    return levels


@njit(**KERNEL, fastmath={"contract"})
def count_levels(pixels: EdgePixels, unknowns: Any, limit_px: float) -> Any:
    """Count the levels of all pixels over tau, (LEVELS, bins); each pixel is shared between the two nearest bins.

    Linear binning (Wand, 1994). Own linearisation of tau: tau + slope . unknowns, (N, 5), px and px per pitch.
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


@njit(**KERNEL)
def edge_scores(
    pixels: EdgePixels, unknowns: Any, tables: ScoreTables, limit_px: float, edges: int
) -> tuple[Any, Any]:
    """Sum scores, (N, edges, 5), and Fisher information, (N, edges, 5, 5), over the pixels of each edge of each star.

    Fisher scoring (Osborne, 1992), each times the derivatives of tau; unknowns as in `count_levels`.
    """
    n = len(unknowns)
    score, fisher = np.zeros((n, edges, EDGE_UNKNOWNS)), np.zeros((n, edges, EDGE_UNKNOWNS, EDGE_UNKNOWNS))
    scores = tables.score.ravel()
    for k in range(n):
        for e in range(edges):
            sums = score[k, e], fisher[k, e]
            _add_edge(pixels, k * edges + e, unknowns[k], scores, tables.fisher, limit_px, sums)
    return score, fisher


@njit(**INNER, fastmath={"reassoc", "contract", "nsz", "nnan", "ninf"}, forceinline=True)
def _add_edge(
    pixels: EdgePixels, group: int, unknowns: Any, scores: Any, fishers: Any, limit_px: float, sums: Any
) -> None:
    """Sum score, (5,), and Fisher information, (5, 5), over the pixels of edge number ``group``.

    ``scores`` are the rows of `ScoreTables.score`, one after the other. Fisher scoring: Osborne (1992). Every sum is a
    variable of its own, in single precision, and there is no branch and no store in the loop, so that it runs over
    several pixels at once. An edge of a star has some hundred pixels.
    """
    single, zero, full = np.float32, np.float32(0.0), np.float32(1.0)
    _, taus, along_x, along_y, us, vs, levels = pixels
    x, y = single(unknowns[0]), single(unknowns[1])
    slope_u, slope_v = single(unknowns[3]), single(unknowns[4])
    shift, per_px = single(unknowns[2] + limit_px), single(_BINS_PER_PX)
    bins, last = np.int32(fishers.size), single(fishers.size - 1)
    s0 = s1 = s2 = s3 = s4 = f00 = f10 = f11 = f20 = f21 = f22 = zero
    f30 = f31 = f32 = f33 = f40 = f41 = f42 = f43 = f44 = zero
    for m in range(pixels.first[group], pixels.first[group + 1]):
        d0, d1, u, v = along_x[m], along_y[m], us[m], vs[m]
        at = (taus[m] + d0 * x + d1 * y + shift + u * slope_u + v * slope_v) * per_px
        known = full if at >= zero and at < last else zero
        at *= known
        i = np.int32(at)
        b, row = at - single(i), np.int32(levels[m]) * bins + i
        a = (full - b) * known
        b *= known
        gradient = a * scores[np.uint64(row)] + b * scores[np.uint64(row + np.int32(1))]
        weight = a * fishers[np.uint64(i)] + b * fishers[np.uint64(i + np.int32(1))]
        w0, w1, w3, w4 = weight * d0, weight * d1, weight * u, weight * v
        s0, s1, s2 = s0 + gradient * d0, s1 + gradient * d1, s2 + gradient
        s3, s4 = s3 + gradient * u, s4 + gradient * v
        f00, f10, f11 = f00 + w0 * d0, f10 + w1 * d0, f11 + w1 * d1
        f20, f21, f22 = f20 + w0, f21 + w1, f22 + weight
        f30, f31, f32, f33 = f30 + w3 * d0, f31 + w3 * d1, f32 + w3, f33 + w3 * u
        f40, f41, f42, f43, f44 = f40 + w4 * d0, f41 + w4 * d1, f42 + w4, f43 + w4 * u, f44 + w4 * v
    score, fisher = sums
    score[0], score[1], score[2], score[3], score[4] = s0, s1, s2, s3, s4
    fisher[0, 0], fisher[1, 0], fisher[1, 1] = f00, f10, f11
    fisher[2, 0], fisher[2, 1], fisher[2, 2] = f20, f21, f22
    fisher[3, 0], fisher[3, 1], fisher[3, 2], fisher[3, 3] = f30, f31, f32, f33
    fisher[4, 0], fisher[4, 1], fisher[4, 2], fisher[4, 3], fisher[4, 4] = f40, f41, f42, f43, f44
    for p in range(EDGE_UNKNOWNS):
        for q in range(p):
            fisher[q, p] = fisher[p, q]
