"""Drawing of a plane in the scene: where its points appear, and the exact area of each pixel that it covers.

A point goes through the collimator, which may bend its light, and through the lens. This module uses neither the print
nor its illumination. Frames: the plane is Z = 0, mm; X_cam = R (P - c), c the camera's centre in the plane's frame.

A polygon is a closed ring of edges. An edge adds, to every cell to its right, the signed height that it spans in that
cell's row; the sum over a ring is the area inside. Only the differences between neighbouring cells of a row are
stored, so the cost of an edge is proportional to its length. A running sum along a row turns differences into areas.
Font rasterisers use the same accumulation buffer (font-rs; Levien 2016).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.compiled import INNER, LOOP
from simulators.optics.collimator_errors import Aberrations, displacement, reticle_point
from simulators.optics.lens import image_point
from simulators.world.truth import CameraTruth

FloatArray = NDArray[np.float64]

REACH_SIGMAS: Final = 3.6
"""Standard deviations beyond which the point spread is cut off: 0.03 % of the light would fall there."""
CHORD_PX: Final = 1e-3
"""Largest distance of an edge, curved by the lens, from the chords that replace it: a thirtieth of the noise of a
centre."""


def empty_picture(width: int, height: int, cells: int, margin: int) -> NDArray[np.float32]:
    """Return an empty picture."""
    return np.zeros(((height + 2 * margin) * cells, (width + 2 * margin) * cells + 1), np.float32)


@njit(**INNER)
def add_edge(steps: NDArray[np.float32], x0: float, y0: float, x1: float, y1: float, weight: float) -> None:
    """Add an edge from (x0, y0) to (x1, y1), in cells from the upper left corner of the grid.

    Source: the accumulation buffer of Levien (2016). ``steps``, (rows, columns + 1) float32, are differences along a
    row, changed in place; parts of the edge outside are cut off. A cell gains ``weight`` if it lies wholly inside a
    ring that runs from +x to +y (clockwise as seen).
    """
    rows, columns = steps.shape[0], steps.shape[1] - 1
    if y0 == y1 or (x0 >= columns and x1 >= columns):
        return
    if y0 > y1:
        x0, y0, x1, y1, weight = x1, y1, x0, y0, -weight
    slope = (x1 - x0) / (y1 - y0)
    first, last = max(y0, 0.0), min(y1, float(rows))
    row = int(first)
    while row < last:
        top, bottom = max(first, float(row)), min(last, row + 1.0)
        a, b = x0 + (top - y0) * slope, x0 + (bottom - y0) * slope
        _add_span(steps[row], min(a, b), max(a, b), -weight * (bottom - top))
        row += 1


@njit(**INNER)
def _add_span(steps: NDArray[np.float32], left: float, right: float, height: float) -> None:
    """Add the part of an edge that lies in one row, between two abscissae (Levien 2016)."""
    last = steps.shape[0] - 1
    cell = int(min(max(left, 0.0), float(last)))
    covered, area = 0.0, _area_left_of(float(cell), left, right)  # of the cell to the left; left of this cell
    while cell < right and cell < last:
        further = _area_left_of(cell + 1.0, left, right)
        steps[cell] += height * (further - area - covered)
        covered, area = further - area, further
        cell += 1
    steps[cell] += height * (1.0 - covered)


@njit(**INNER)
def _area_left_of(x: float, left: float, right: float) -> float:
    """Return the area between an edge of unit height, which runs from ``left`` to ``right``, and x to its right."""
    if x <= left:
        return 0.0
    if x >= right:
        return x - 0.5 * (left + right)
    return 0.5 * (x - left) ** 2 / (right - left)


def spread_kernel(sigma_px: float, cells: int) -> FloatArray:
    """Return the weights that join cells to a pixel: the pixel's own area convolved with a Gaussian point spread.

    The weights of the pixel's cells and of n cells to either side sum to 1; the width of a cell counts as part of the
    point spread. Own derivation: a cell at x has the weight Phi((x + 1/2) / s) - Phi((x - 1/2) / s), in pixels, where
    s^2 is sigma^2 minus 1/12 of the cell's squared width.
    """
    sigma = math.sqrt(max(sigma_px**2 - 1.0 / (12.0 * cells**2), 1e-12))
    margin = math.ceil(REACH_SIGMAS * sigma_px * cells)
    at = (np.arange(cells + 2 * margin) - margin + 0.5) / cells - 0.5
    weights = np.array([_normal((x + 0.5) / sigma) - _normal((x - 0.5) / sigma) for x in at])
    return np.asarray(weights / weights.sum())


def _normal(z: float) -> float:
    """Return the cumulative standard normal distribution at z."""
    return 0.5 * (1.0 + math.erf(z / math.sqrt(2.0)))


@njit(**LOOP, fastmath={"contract"})
def join_cells(
    steps: NDArray[np.float32],
    light: NDArray[np.float32],
    shades: tuple[float, float],
    kernel: FloatArray,
    cells: int,
    margin: int,
) -> NDArray[np.float32]:
    """Join cells to pixels: light times covered area, after the point spread.

    Own model: light times (shade 0 + shade 1 times covered area), summed with the kernel's weights along rows and
    columns. ``steps``, (rows, columns + 1) float32, come from ``add_edge`` for a picture with ``margin`` pixels all
    around. ``light``, (height + 2 margin + 1, width + 2 margin + 1) float32, is the brightness at the corners of
    pixels; linear between. ``kernel``: (cells + 2 n,) float64, weights of ``spread_kernel``.
    """
    height, width = steps.shape[0] // cells - 2 * margin, (steps.shape[1] - 1) // cells - 2 * margin
    before = margin * cells - (kernel.size - cells) // 2  # cells of the margin beyond the kernel's reach
    out = np.zeros((height, width), np.float32)
    row, joined = np.empty((cells, (steps.shape[1] - 1) // cells), np.float32), np.empty(width, np.float32)
    for n in range(before, steps.shape[0] - before):
        _lit_row(steps[n], light[n // cells], light[n // cells + 1], (n % cells + 0.5) / cells, shades, row)
        joined[:] = 0.0
        for k in range(kernel.size):
            weight = np.float32(kernel[k])
            place, first_px = (before + k) % cells, (before + k) // cells
            for j in range(width):
                joined[j] += weight * row[place, first_px + j]
        first = n - before
        for i in range(max(0, (first - kernel.size) // cells + 1), min(height - 1, first // cells) + 1):
            weight = np.float32(kernel[first - i * cells])
            for j in range(width):
                out[i, j] += weight * joined[j]
    return out


@njit(**INNER)
def _lit_row(
    steps: NDArray[np.float32],
    above: NDArray[np.float32],
    below: NDArray[np.float32],
    v: float,
    shades: tuple[float, float],
    row: NDArray[np.float32],
) -> None:
    """Compute the brightness of a row's cells, (cells of a pixel, pixels), at fraction v between rows of corners."""
    cells, pixels = row.shape
    covered = 0.0
    right = (1.0 - v) * above[0] + v * below[0]
    for j in range(pixels):
        left, right = right, (1.0 - v) * above[j + 1] + v * below[j + 1]
        for c in range(cells):
            covered += steps[j * cells + c]
            u = (c + 0.5) / cells
            share = min(max(covered, 0.0), 1.0)  # a running sum of single precision may miss by 1e-6
            row[c, j] = (shades[0] + shades[1] * share) * ((1.0 - u) * left + u * right)


class Projection(NamedTuple):
    """Projection by a camera in one pose."""

    lens: CameraTruth
    rotation: FloatArray  # (3, 3) float64, rotation R
    centre: FloatArray  # (3,) float64, camera centre c, mm
    aberrations: Aberrations


class Cells(NamedTuple):
    """Resolution of a drawing."""

    per_px: int  # Cells along a pixel's side
    margin_px: int


def plane_to_image(
    x_mm: FloatArray, y_mm: FloatArray, projection: Projection
) -> tuple[FloatArray, FloatArray]:
    """Return the image points u and v, px, of points of the plane, two arrays (...,); NaN for one behind the camera.

    X_cam = R (P + displacement - c): spherical motion of arXiv:2512.16092, eq. 2, if c is the collimator's centre.
    Projection: Hartley and Zisserman (2004), section 6.1.
    """
    dx, dy = displacement(x_mm, y_mm, projection.aberrations)
    x, y, z = x_mm + dx - projection.centre[0], y_mm + dy - projection.centre[1], -projection.centre[2]
    r = projection.rotation
    return image_point(
        r[0, 0] * x + r[0, 1] * y + r[0, 2] * z,
        r[1, 0] * x + r[1, 1] * y + r[1, 2] * z,
        r[2, 0] * x + r[2, 1] * y + r[2, 2] * z,
        projection.lens,
    )


def image_points(points_mm: FloatArray, projection: Projection) -> FloatArray:
    """Return the image points of points of the plane, (N, 2) mm."""
    return np.stack(plane_to_image(points_mm[:, 0], points_mm[:, 1], projection), axis=1)


def plane_points(rays: FloatArray, projection: Projection) -> FloatArray:
    """Return the plane's points on rays d = [x y 1], (rows, columns, 2): c + s R^T d, with s such that Z = 0."""
    r, c = projection.rotation, projection.centre
    xn, yn = rays[..., 0], rays[..., 1]
    dz = r[0, 2] * xn + r[1, 2] * yn + r[2, 2]
    scale = -c[2] / np.where(dz > 1e-6, dz, np.nan)
    x = c[0] + scale * (r[0, 0] * xn + r[1, 0] * yn + r[2, 0])
    y = c[1] + scale * (r[0, 1] * xn + r[1, 1] * yn + r[2, 1])
    return np.stack(reticle_point(x, y, projection.aberrations), axis=-1)


def draw(
    polygons_mm: FloatArray,
    projection: Projection,
    rays: FloatArray,
    cells: Cells,
    steps: NDArray[np.float32],
) -> None:
    """Add the areas of polygons, (N, corners, 2) mm, clockwise as seen, to a picture; corners may repeat.

    Each polygon is smaller than the image, and left out if none of its corners lies within the angle of the rays,
    (rows, columns, 2) from ``ray_grid``, from the optical axis: the lens polynomial is not valid there. ``steps``:
    (rows of cells, columns of cells + 1) float32, changed in place as by ``add_edge``.
    """
    reach = float(np.linalg.norm(rays, axis=-1).max())
    shown = polygons_mm[_within(polygons_mm, projection, reach).any(axis=1)]
    a, b = shown.reshape(-1, 2), np.roll(shown, -1, axis=1).reshape(-1, 2)
    edges = (a != b).any(axis=1)
    _add_edges(steps, *_chords(a[edges], b[edges], projection, cells))


def _within(points_mm: FloatArray, projection: Projection, reach: float) -> NDArray[np.bool_]:
    """Return which points, (..., 2) mm, lie before the camera and at most at that tangent from its optical axis."""
    seen = np.concatenate([points_mm, np.zeros((*points_mm.shape[:-1], 1))], axis=-1) - projection.centre
    depth = seen @ projection.rotation[2]
    return np.asarray((depth > 0.0) & ((seen * seen).sum(axis=-1) < (1.0 + reach * reach) * depth * depth))


def _chords(
    a: FloatArray, b: FloatArray, projection: Projection, cells: Cells
) -> tuple[FloatArray, FloatArray]:
    """Return begin and end, (M, 2) cells, of the chords that replace edges from a to b, (N, 2) mm.

    The distance of n chords from a smooth curve is 1 / n^2 of that of one chord.
    """
    first, last, middle = (image_points(points, projection) for points in (a, b, 0.5 * (a + b)))
    off = np.hypot(*(middle - 0.5 * (first + last)).T)
    count = np.where(np.isfinite(off), 1 + np.sqrt(off / CHORD_PX), 0).astype(np.int64)
    edge = np.repeat(np.arange(len(a)), count)
    step = 1 + np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    share = (step / count[edge])[:, None]
    ends = image_points((1 - share) * a[edge] + share * b[edge], projection)
    whole = step == count[edge]
    ends[whole] = last[edge[whole]]
    begins = np.roll(ends, 1, axis=0)
    begins[step == 1] = first[edge[step == 1]]
    shift = (cells.margin_px + 0.5) * cells.per_px
    return begins * cells.per_px + shift, ends * cells.per_px + shift


@njit(**LOOP)
def _add_edges(steps: NDArray[np.float32], begins: FloatArray, ends: FloatArray) -> None:
    """Add edges to a picture; see `add_edge`."""
    for n in range(begins.shape[0]):
        add_edge(steps, begins[n, 0], begins[n, 1], ends[n, 0], ends[n, 1], 1.0)
