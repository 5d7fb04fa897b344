"""Pixels near the edges of stars, collected from a quantised image star by star, and in each star edge by edge.

What the pixels tell about the centres is calculated in `calib.stars.edge_pixels`. All compiled functions of the
collection are here, next to those that they call.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.compiled import INNER, KERNEL
from calib.stars.centring import SYMMETRY_REACH
from calib.stars.grid_map import LocalMap
from calib.stars.open_sides import cell_reach
from calib.stars.printed_star import OVERSAMPLING, EdgeMap

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
    (q - c) and then s = A^-1 (q - c - B(s0, s0)). Pixels as close to an open side (`calib.stars.open_sides`) as the
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
