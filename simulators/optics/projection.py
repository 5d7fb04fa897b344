"""Projection of a plane in the scene to the image: where its points appear, and which pixels its outlines cover.

A point goes through the collimator, which may bend its light, and through the lens. This module uses neither the print
nor its illumination.

Frames: the plane is Z = 0, mm; X_cam = R (P - c), c the camera's centre in the plane's frame. A screen at finite
distance has no collimator; its `Projection` holds ``NO_ABERRATIONS``.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.optics.collimator_errors import Aberrations, displacement, is_ideal, reticle_point
from simulators.optics.coverage import add_edge
from simulators.optics.lens import Lens, image_point

FloatArray = NDArray[np.float64]

CHORD_PX: Final = 1e-3
"""Largest distance of an edge, curved by the lens, from the chords that replace it."""


class Projection(NamedTuple):
    """Projection by a camera in one pose, as the compiled functions take it."""

    lens: Lens
    rotation: FloatArray  # (3, 3) float64, rotation R
    centre: FloatArray  # (3,) float64, camera centre c, mm
    aberrations: Aberrations


class Cells(NamedTuple):
    """Resolution of a drawing."""

    per_px: int  # Cells along a pixel's side
    margin_px: int


@njit(cache=True, nogil=True)
def plane_to_image(x_mm: float, y_mm: float, projection: Projection) -> tuple[float, float]:
    """Return the image point of a point of the plane.

    X_cam = R (P + displacement - c): spherical motion of arXiv:2512.16092, eq. 2, if c is the collimator's centre.
    Projection: Hartley and Zisserman (2004), section 6.1.

    Returns: u and v, px; NaN if the point does not lie in front of the camera.
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


@njit(cache=True, nogil=True)
def image_points(points_mm: FloatArray, projection: Projection) -> FloatArray:
    """Return the image points of points of the plane.

    points_mm: (N, 2) float64, points of the plane.
    Returns: Image points, px; NaN behind the camera.
    """
    out = np.empty((points_mm.shape[0], 2))
    for i in range(points_mm.shape[0]):
        out[i, 0], out[i, 1] = plane_to_image(points_mm[i, 0], points_mm[i, 1], projection)
    return out


@njit(cache=True, nogil=True)
def plane_points(rays: FloatArray, projection: Projection) -> FloatArray:
    """Return the points of the plane that rays meet.

    Own derivation: a ray d = [x y 1] meets the plane at c + s R^T d, with s such that Z = 0.

    rays: (rows, columns, 2) undistorted normalised coordinates.
    Returns: Points of the plane, mm; NaN for a ray that leads away from it.
    """
    out = np.empty_like(rays)
    r, c = projection.rotation, projection.centre
    ideal = is_ideal(projection.aberrations)
    for i in range(rays.shape[0]):
        for j in range(rays.shape[1]):
            xn, yn = rays[i, j]
            dz = r[0, 2] * xn + r[1, 2] * yn + r[2, 2]
            scale = -c[2] / dz if dz > 1e-6 else math.nan
            x = c[0] + scale * (r[0, 0] * xn + r[1, 0] * yn + r[2, 0])
            y = c[1] + scale * (r[0, 1] * xn + r[1, 1] * yn + r[2, 1])
            if not ideal:
                x, y = reticle_point(x, y, projection.aberrations)
            out[i, j, 0], out[i, j, 1] = x, y
    return out


def draw(
    polygons_mm: FloatArray,
    projection: Projection,
    rays: FloatArray,
    cells: Cells,
    steps: NDArray[np.float32],
) -> None:
    """Add the areas of polygons to a picture.

    polygons_mm: (N, corners, 2), clockwise as seen; corners may repeat. Each is smaller than the image.
    rays: (rows, columns, 2), from ``lens.ray_grid``. A polygon is left out if none of its corners lies within
      the angle of these rays from the optical axis: the lens polynomial is not valid there.
    steps: (rows of cells, columns of cells + 1) float32, changed in place as by ``coverage.add_edge``.
    """
    reach = float(np.linalg.norm(rays, axis=-1).max())
    _draw(np.ascontiguousarray(polygons_mm, np.float64), projection, reach, cells, steps)


@njit(cache=True, nogil=True)
def _draw(
    polygons: FloatArray, projection: Projection, reach: float, cells: Cells, steps: NDArray[np.float32]
) -> None:
    """Loop of ``draw``."""
    corners = polygons.shape[1]
    for n in range(polygons.shape[0]):
        shown = False
        for k in range(corners):
            shown = shown or _within(polygons[n, k, 0], polygons[n, k, 1], projection, reach)
        if not shown:
            continue
        for k in range(corners):
            a, b = polygons[n, k], polygons[n, (k + 1) % corners]
            if a[0] != b[0] or a[1] != b[1]:
                _draw_edge(a, b, projection, cells, steps)


@njit(cache=True, nogil=True)
def _within(x_mm: float, y_mm: float, projection: Projection, reach: float) -> bool:
    """Return whether a point lies in front of the camera and at most at that tangent from the optical axis."""
    x, y, z = x_mm - projection.centre[0], y_mm - projection.centre[1], -projection.centre[2]
    r = projection.rotation
    depth = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z
    return depth > 0.0 and x * x + y * y + z * z < (1.0 + reach * reach) * depth * depth


@njit(cache=True, nogil=True)
def _draw_edge(
    a: FloatArray, b: FloatArray, projection: Projection, cells: Cells, steps: NDArray[np.float32]
) -> None:
    """Add an edge from a to b, as chords of its curve in the image.

    Own rule: n chords of a curve lie about 1 / n^2 of the distance of a single chord from it.
    """
    u0, v0 = plane_to_image(a[0], a[1], projection)
    u1, v1 = plane_to_image(b[0], b[1], projection)
    um, vm = plane_to_image(0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), projection)
    chords = 1 + int(math.sqrt(math.hypot(um - 0.5 * (u0 + u1), vm - 0.5 * (v0 + v1)) / CHORD_PX))
    scale, shift = cells.per_px, (cells.margin_px + 0.5) * cells.per_px
    for k in range(1, chords + 1):
        u, v = u1, v1
        if k < chords:
            s = k / chords
            u, v = plane_to_image((1 - s) * a[0] + s * b[0], (1 - s) * a[1] + s * b[1], projection)
        add_edge(steps, u0 * scale + shift, v0 * scale + shift, u * scale + shift, v * scale + shift, 1.0)
        u0, v0 = u, v
