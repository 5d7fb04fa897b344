"""Pixels near the edges of stars: collected star by star, their levels of brightness, and the scores of the unknowns.

How many rounds are made, and how much weight an edge has, is decided in `calib.stars.likelihood`. All compiled
functions of the likelihood are here, next to those that they call.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.compiled import INNER, KERNEL
from calib.stars.centring import SYMMETRY_REACH
from calib.stars.grid_map import LocalMap
from calib.stars.printed_star import OVERSAMPLING, EdgeMap, cell_reach

# Pixels near the edges of stars, collected from a quantised image star by star, and in each star edge by edge.

#: Products may be added without rounding in between; for loops that meet no nan.
_WITHOUT_NAN = {"contract", "nsz", "nnan", "ninf"}


class EdgePixels(NamedTuple):
    """All pixels near an edge of N stars with E edges each: star by star, and in each star edge by edge."""

    # (N E + 1,) int64: edge e of star k has the pixels from first[k E + e] to first[k E + e + 1].
    first: NDArray[np.int64]
    # (M,) float32, px, signed distance from the nearest edge, computed from the first centres.
    tau: NDArray[np.float32]
    # along_x, along_y: (M,) float32, dimensionless, derivatives of tau with respect to the centre of the
    # star.
    along_x: NDArray[np.float32]
    along_y: NDArray[np.float32]
    # u, v: (M,) float32, pitches, place in the star: derivatives of tau with respect to the slope of the
    # threshold.
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    level: NDArray[np.uint8]  # (M,) uint8, level of brightness


def gather_edge_pixels(
    levels: NDArray[np.uint8],
    centres: NDArray[np.float64],
    local_map: LocalMap,
    edge_map: EdgeMap,
    is_open: NDArray[np.bool_] | None = None,
) -> EdgePixels:
    """Collect the pixels near edges of all stars.

    Own derivation: a pixel at q belongs to the place s in the star with q = c + A s + B(s, s). It is found by s0 = A^-1
    (q - c) and then s = A^-1 (q - c - B(s0, s0)). Pixels as close to an open side (`calib.stars.printed_star`) as the
    limit of the edge map are left out. The levels are from `quantise`, the (N, 2) centres in px.
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
    most = int((2.0 * reach + 4.0).prod(axis=1).max(initial=1.0))  # pixels in the bounding box of a cell
    space = _Space._make(
        [*np.empty((10, most), np.float32), *np.empty((3, most), np.int32), np.empty(most, np.uint8)]
    )
    # In the order of rows, as the kernel is compiled once.
    inverse, bends = np.ascontiguousarray(np.linalg.inv(linear)), np.ascontiguousarray(local_map.quadratic)
    _gather(
        levels, np.ascontiguousarray(centres), inverse, bends, edge_map, edges, (reach, used_to), space, found
    )
    used = slice(int(first[-1]))
    return EdgePixels(first, tau[used], along_x[used], along_y[used], u[used], v[used], level[used])


class _Space(NamedTuple):
    """Pixels of one star until they are sorted by their edges, each (K,)."""

    # tau, along_x, along_y, u, v: float32, as in `EdgePixels`.
    tau: NDArray[np.float32]
    along_x: NDArray[np.float32]
    along_y: NDArray[np.float32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    # right, down, rise, lower, lower_rise: float32: how far the pixel lies to the right of and below a sample
    # of the edge map, samples; and at this sample: how much tau rises to the right, px; tau one row below,
    # px, and how much it rises to the right there.
    right: NDArray[np.float32]
    down: NDArray[np.float32]
    rise: NDArray[np.float32]
    lower: NDArray[np.float32]
    lower_rise: NDArray[np.float32]
    # int32, number of the sample of the edge map above and to the left of the pixel; -1 if the pixel is not
    # used.
    sample: NDArray[np.int32]
    place: NDArray[np.int32]  # int32, number of the pixel in the image
    used: NDArray[np.int32]  # int32, numbers of the pixels that are used
    edge: NDArray[np.uint8]  # uint8, their edges


@njit(**KERNEL)
def _gather(
    levels: Any,
    centres: Any,
    inverse: Any,
    quadratic: Any,
    edge_map: EdgeMap,
    edges: int,
    reaches: Any,
    space: _Space,
    found: EdgePixels,
) -> None:
    """Interpolate tau and its derivatives at each pixel of each star's cell, and store those near an edge.

    ``inverse`` is (N, 2, 2), pitches per px. ``reaches`` are half the sides of the cells' bounding boxes, (N, 2), px,
    and of the part of each cell that is used, (N, 2), pitches.
    """
    taus, nearest, pixels = edge_map.tau.ravel(), edge_map.edge.ravel(), levels.ravel()
    height, width = levels.shape
    reach, used_to = reaches
    counts = np.empty(edges, np.int64)
    for k in range(len(centres)):
        x, y, to, bend = centres[k, 0], centres[k, 1], inverse[k], quadratic[k]
        low, high = int(max(0.0, y - reach[k, 1])), int(min(height - 1.0, y + reach[k, 1] + 1.0))
        left, right = int(max(0.0, x - reach[k, 0])), int(min(width - 1.0, x + reach[k, 0] + 1.0))
        limits = _limits(used_to[k], to, bend)
        n: Any = np.int64(0)  # not a literal, for which everything below would be compiled a second time
        for r in range(low, high + 1):
            first, last = _columns(r - y, to, limits, left - x, right - x)
            begin, end = max(int(np.floor(x + first)), left), min(int(np.ceil(x + last)), right) + 1
            if end > begin:
                _place_row(begin - x, r - y, r * width + begin, to, bend, edge_map, n, end - begin, space)
                n += end - begin
        _read_samples(taus, len(edge_map.tau), n, space)
        _interpolate(to, used_to[k], edge_map, n, space)
        _store_by_edge(space, n, nearest, pixels, counts, k * edges, found)


@njit(**INNER)
def _limits(used_to: Any, to: Any, bend: Any) -> tuple[float, float]:
    """Return how far the used part of a cell reaches by the linear map alone, pitches.

    It is half a pitch, and a little more where the map bends; the bend is at most a quarter of the sum. Own bound.
    """
    bend_x = abs(bend[0, 0]) + abs(bend[0, 1]) + abs(bend[0, 2])
    bend_y = abs(bend[1, 0]) + abs(bend[1, 1]) + abs(bend[1, 2])
    return (
        used_to[0] + abs(to[0, 0]) * bend_x + abs(to[0, 1]) * bend_y,
        used_to[1] + abs(to[1, 0]) * bend_x + abs(to[1, 1]) * bend_y,
    )


@njit(**INNER, fastmath=_WITHOUT_NAN)
def _place_row(
    dx: float,
    dy: float,
    place: int,
    to: Any,
    bend: Any,
    edge_map: EdgeMap,
    start: int,
    count: int,
    space: _Space,
) -> None:
    """Find the place in the star of some pixels of a row; the first one lies at (dx, dy) px from the star's centre.

    Own derivation: see `gather_edge_pixels`. Here and in the next two functions, the work is divided so that no loop
    both looks up values and stores others: such a loop would not run over several pixels at once. For the same reason
    every number is a variable of its own, in single precision.
    """
    single, side, end = np.float32, np.int32(len(edge_map.tau)), start + count
    u_at, v_at, right, down = (
        space.u[start:end],
        space.v[start:end],
        space.right[start:end],
        space.down[start:end],
    )
    sample, places = space.sample[start:end], space.place[start:end]
    scale, half, last = (
        single(edge_map.samples_per_pitch),
        single(edge_map.half),
        single(side) - single(1.001),
    )
    u_x, u_y, v_x, v_y = single(to[0, 0]), single(to[0, 1]), single(to[1, 0]), single(to[1, 1])
    x_uu, x_uv, x_vv = single(bend[0, 0]), single(bend[0, 1]), single(bend[0, 2])
    y_uu, y_uv, y_vv = single(bend[1, 0]), single(bend[1, 1]), single(bend[1, 2])
    x, y, zero, first = single(dx), single(dy), single(0.0), np.int32(place)
    for i in range(count):
        ax = x + single(np.int32(i))
        u, v = u_x * ax + u_y * y, v_x * ax + v_y * y
        bx = ax - (x_uu * u * u + x_uv * u * v + x_vv * v * v)
        by = y - (y_uu * u * u + y_uv * u * v + y_vv * v * v)
        u, v = u_x * bx + u_y * by, v_x * bx + v_y * by
        at_u, at_v = min(max(u * scale + half, zero), last), min(max(v * scale + half, zero), last)
        row, column = np.int32(at_v), np.int32(at_u)
        u_at[i], v_at[i], right[i], down[i] = u, v, at_u - single(column), at_v - single(row)
        sample[i], places[i] = row * side + column, first + np.int32(i)


@njit(**INNER, fastmath=_WITHOUT_NAN)
def _read_samples(taus: Any, side: int, n: int, space: _Space) -> None:
    """Read the four samples of the edge map around each of the first ``n`` pixels; ``taus`` are its rows."""
    tau, rise, lower, lower_rise, sample = space.tau, space.rise, space.lower, space.lower_rise, space.sample
    one, row = np.uint64(1), np.uint64(side)
    for i in range(n):
        m = np.uint64(i)
        k = np.uint64(sample[m])
        tau[m], rise[m] = taus[k], taus[k + one] - taus[k]
        lower[m], lower_rise[m] = taus[k + row], taus[k + row + one] - taus[k + row]


@njit(**INNER, fastmath=_WITHOUT_NAN)
def _interpolate(to: Any, used_to: Any, edge_map: EdgeMap, n: int, space: _Space) -> None:
    """Interpolate tau and its derivatives at the first ``n`` pixels, and mark those that are not used.

    The interpolation is bilinear (Abramowitz and Stegun, 1972, section 25.2). Own derivatives: tau changes by -grad tau
    A^-1 with the centre, by 1 with the threshold, and by s with its slope.
    """
    single = np.float32
    tau, along_x, along_y, u, v, right, down, rise, lower, lower_rise, sample = space[:11]
    scale, limit = single(edge_map.samples_per_pitch), single(edge_map.limit_px)
    u_x, u_y, v_x, v_y = single(to[0, 0]), single(to[0, 1]), single(to[1, 0]), single(to[1, 1])
    used_u, used_v = single(used_to[0]), single(used_to[1])
    for i in range(n):
        a, b = right[i], down[i]
        above, below = tau[i] + a * rise[i], lower[i] + a * lower_rise[i]
        distance = above + b * (below - above)
        along_u, along_v = (rise[i] + b * (lower_rise[i] - rise[i])) * scale, (below - above) * scale
        tau[i] = distance
        along_x[i] = -(u_x * along_u + v_x * along_v)
        along_y[i] = -(u_y * along_u + v_y * along_v)
        near = (abs(distance) < limit) & (abs(u[i]) <= used_u) & (abs(v[i]) <= used_v)
        sample[i] = sample[i] if near else np.int32(-1)


@njit(**INNER)
def _columns(dy: float, to: Any, limits: Any, left: float, right: float) -> tuple[float, float]:
    """Return the first and the last place in a row, px from the centre, at which the linear map is within limits.

    ``dy`` is the distance of the row, px; ``limits`` are along the columns and along the rows, pitches. Own rule.
    """
    for k in range(2):
        if abs(to[k, 0]) > 1e-9:
            one, other = (-limits[k] - to[k, 1] * dy) / to[k, 0], (limits[k] - to[k, 1] * dy) / to[k, 0]
            left, right = max(left, min(one, other)), min(right, max(one, other))
    return left, right


@njit(**INNER)
def _store_by_edge(
    space: _Space, n: int, nearest: Any, pixels: Any, counts: Any, group: int, found: EdgePixels
) -> None:
    """Store those of the first ``n`` pixels of a star that are used, sorted by edges (counting sort: Knuth, 1998).

    ``nearest`` are the edges of the samples of the edge map, ``pixels`` the levels of the image, both row by row.
    """
    sample, used, edge, m = space.sample, space.used, space.edge, np.uint64(0)
    counts[:] = 0
    for i in range(n):
        near = sample[np.uint64(i)] >= 0
        e = nearest[np.uint64(max(sample[np.uint64(i)], 0))]
        used[m], edge[m] = i, e
        # Added as 0 or 1: a branch would be foreseen wrongly too often.
        counts[np.uint64(e)] += near
        m += np.uint64(near)
    first, start = found.first, found.first[group]
    for e in range(len(counts)):
        counts[e], start = start, start + counts[e]
        first[group + e + 1] = start
    for j in range(m):
        _store(space, np.uint64(used[j]), np.uint64(edge[j]), pixels, counts, found)


@njit(**KERNEL, inline="always")
def _store(space: _Space, i: Any, edge: Any, pixels: Any, counts: Any, found: EdgePixels) -> None:
    """Store a pixel behind the others of its edge."""
    at = np.uint64(counts[edge])
    counts[edge] += 1
    found.tau[at], found.along_x[at], found.along_y[at] = space.tau[i], space.along_x[i], space.along_y[i]
    found.u[at], found.v[at], found.level[at] = space.u[i], space.v[i], pixels[np.uint64(space.place[i])]


# Pixels near the edges of stars: their levels of brightness, counted, and the scores of each star's unknowns.

#: Width of the bins of tau, px.
TAU_BIN_PX = 0.03
_BINS_PER_PX = 1.0 / TAU_BIN_PX
#: Largest number of levels of brightness.
LEVELS = 64
#: Number of unknowns of a star: shift of its centre x, y; shift of the threshold; slope of the threshold x, y.
EDGE_UNKNOWNS = 5


class ScoreTables(NamedTuple):
    """Statistics of a level P(level | tau), tabulated over bins of tau."""

    score: NDArray[np.float32]  # (LEVELS, bins) float32, 1/px, d log P / d tau
    fisher: NDArray[np.float32]  # (bins,) float32, 1/px^2, Fisher information of a pixel about tau


#: Length of the table over the values of an image, from the first to the last border of levels.
_TABLE = 4096


def quantise(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Reduce an image without nan to at most `LEVELS` levels of brightness, from 0.

    If the image has no more values than that, each value is a level. Otherwise the levels have equal shares of the
    pixels, as those of histogram equalisation (Gonzalez and Woods, 2018).

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
    if len(borders) == 0:
        return np.zeros(image.shape, np.uint8)
    borders = np.asarray(borders, float)
    steps = (
        np.arange(_TABLE) / (_TABLE / (borders[-1] - borders[0])) if len(borders) > 1 else np.zeros(_TABLE)
    )
    table = np.append(np.searchsorted(borders, borders[0] + steps), len(borders))
    return np.asarray(_levels_of(np.ascontiguousarray(image), borders, table))


@njit(**KERNEL)
def _levels_of(image: Any, borders: Any, table: Any) -> Any:
    """Return for each pixel how many borders are at most its value, (H, W) uint8.

    The search starts from a table over the values, and bisects what the table leaves open. The table says how many
    borders lie below each of `_TABLE` equal steps from the first border to the last one.
    """
    levels = np.zeros(image.shape, np.uint8)
    low, high = borders[0], borders[-1]
    scale = _TABLE / (high - low) if high > low else 0.0
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


@njit(**INNER, fastmath={"reassoc", "contract", "nsz", "nnan", "ninf"})
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
    variable of its own, in single precision, and there is no branch and no store in the loop, so that it runs over
    several pixels at once. An edge of a star has some hundred pixels.
    """
    single, zero, one = np.float32, np.float32(0.0), np.float32(1.0)
    _, taus, along_x, along_y, us, vs, levels = pixels
    x, y, slope_u, slope_v = (
        single(unknowns[0]),
        single(unknowns[1]),
        single(unknowns[3]),
        single(unknowns[4]),
    )
    shift, per_px = single(unknowns[2] + limit_px), single(_BINS_PER_PX)
    bins, last = np.int32(fishers.size), single(fishers.size - 1)
    s0 = s1 = s2 = s3 = s4 = f00 = f10 = f11 = f20 = f21 = f22 = zero
    f30 = f31 = f32 = f33 = f40 = f41 = f42 = f43 = f44 = zero
    for m in range(begin, end):
        d0, d1, u, v = along_x[m], along_y[m], us[m], vs[m]
        at = (taus[m] + d0 * x + d1 * y + shift + u * slope_u + v * slope_v) * per_px
        known = one if at >= zero and at < last else zero
        at *= known
        i = np.int32(at)
        b, row = at - single(i), np.int32(levels[m]) * bins + i
        a = (one - b) * known
        b *= known
        gradient = a * scores[np.uint64(row)] + b * scores[np.uint64(row + np.int32(1))]
        weight = a * fishers[np.uint64(i)] + b * fishers[np.uint64(i + np.int32(1))]
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
