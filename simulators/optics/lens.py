"""Lens of the simulated camera: from rays to pixels and back.

Two models, in OpenCV's conventions with pixel centres at integers: pinhole with Brown's distortion (Brown 1966, 1971),
and the fisheye of Kannala and Brandt (2006). This module works on directions in the camera's frame; it uses no scene.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.errors import ConfigError
from simulators.world.truth import CameraTruth

FloatArray = NDArray[np.float64]

GRID_PX: Final = 8
"""Spacing of the points at which rays are computed; between them rays are interpolated."""


class Lens(NamedTuple):
    """Parameters of a lens, as the compiled functions take them."""

    # fx, fy, cx, cy: Focal lengths and principal point, px.
    fx: float
    fy: float
    cx: float
    cy: float
    # k1, k2, k3, k4: Radial coefficients; k4 of a fisheye only.
    k1: float
    k2: float
    k3: float
    k4: float
    # p1, p2: Tangential coefficients; of a pinhole only.
    p1: float
    p2: float
    fisheye: bool  # Whether the model is the fisheye; else the pinhole


def lens_of(camera: CameraTruth) -> Lens:
    """Return the lens of a camera."""
    c = camera
    return Lens(c.fx, c.fy, c.cx, c.cy, c.k1, c.k2, c.k3, c.k4, c.p1, c.p2, camera.projection == "fisheye")


@njit(cache=True, nogil=True)
def distort(xn: float, yn: float, lens: Lens) -> tuple[float, float]:
    """Return distorted normalised coordinates.

    Pinhole: radial k1, k2, k3 and tangential p1, p2 (Brown 1966, 1971; sign and order as in OpenCV). Fisheye (Kannala
    and Brandt 2006, radial part, as in OpenCV): with theta = atan r, the point lies at
    theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).

    xn, yn: Undistorted normalised coordinates x/z and y/z.
    """
    r2 = xn * xn + yn * yn
    if lens.fisheye:
        if r2 < 1e-16:
            return xn, yn
        r = math.sqrt(r2)
        theta = math.atan(r)
        t2 = theta * theta
        scale = theta * (1.0 + t2 * (lens.k1 + t2 * (lens.k2 + t2 * (lens.k3 + t2 * lens.k4)))) / r
        return scale * xn, scale * yn
    radial = 1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    xd = xn * radial + 2.0 * lens.p1 * xn * yn + lens.p2 * (r2 + 2.0 * xn * xn)
    yd = yn * radial + lens.p1 * (r2 + 2.0 * yn * yn) + 2.0 * lens.p2 * xn * yn
    return xd, yd


@njit(cache=True, nogil=True)
def image_point(x: float, y: float, z: float, lens: Lens) -> tuple[float, float]:
    """Return the image point of a point in the camera's frame.

    Pinhole projection: Hartley and Zisserman (2004), section 6.1. Distortion: Brown (1971), or Kannala and Brandt
    (2006), as in `distort`.

    Returns: u and v, px; NaN if the point does not lie in front of the camera.
    """
    if not z > 0.0:
        return math.nan, math.nan
    xd, yd = distort(x / z, y / z, lens)
    return lens.fx * xd + lens.cx, lens.fy * yd + lens.cy


def undistort(xd: FloatArray, yd: FloatArray, camera: CameraTruth) -> tuple[FloatArray, FloatArray]:
    """Return undistorted normalised coordinates of distorted ones, to 1e-13.

    The pinhole model is inverted by fixed-point iteration, the fisheye by Newton's method. Own derivation: x <- x +
    (x_d - distort(x)) for the pinhole model.

    xd, yd: Distorted normalised coordinates, two arrays of one shape (...,).
    Returns: Undistorted normalised coordinates x/z and y/z.
    Raises ConfigError: If the distortion cannot be inverted there: the radial polynomial decreases inside the
      image.
    """
    lens = lens_of(camera)
    if lens.fisheye:
        return _undistort_fisheye(xd, yd, lens)
    xn, yn = xd.copy(), yd.copy()
    for _ in range(200):
        xe, ye = distort_arrays(xn, yn, lens)
        step_x, step_y = xd - xe, yd - ye
        xn += step_x
        yn += step_y
        worst = max(float(np.abs(step_x).max()), float(np.abs(step_y).max()))
        if not worst < 1e3:
            break
        if worst < 1e-13:
            return xn, yn
    raise _not_invertible()


def distort_arrays(xn: FloatArray, yn: FloatArray, lens: Lens) -> tuple[FloatArray, FloatArray]:
    """Return ``distort`` for arrays.

    xn, yn: Undistorted normalised coordinates, two arrays of one shape (...,).
    """
    flat = _distort(np.column_stack([np.ravel(xn), np.ravel(yn)]), lens)
    return flat[:, 0].reshape(xn.shape), flat[:, 1].reshape(xn.shape)


@njit(cache=True, nogil=True)
def _distort(points: FloatArray, lens: Lens) -> FloatArray:
    """Loop of ``distort_arrays``."""
    out = np.empty_like(points)
    for i in range(points.shape[0]):
        out[i, 0], out[i, 1] = distort(points[i, 0], points[i, 1], lens)
    return out


def _undistort_fisheye(xd: FloatArray, yd: FloatArray, lens: Lens) -> tuple[FloatArray, FloatArray]:
    """Solve theta (1 + k1 theta^2 + ...) = |xd, yd| by Newton's method, starting at |xd, yd| but at most 1.5."""
    wanted = np.hypot(xd, yd)
    theta = np.minimum(wanted, 1.5)
    k1, k2, k3, k4 = lens.k1, lens.k2, lens.k3, lens.k4
    for _ in range(50):
        t2 = theta * theta
        value = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        slope = 1.0 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
        if not (slope > 0.0).all():
            break
        step = (wanted - value) / slope
        theta = theta + step
        if float(np.abs(step).max()) < 1e-13:
            if not (theta < 0.5 * math.pi).all():
                break
            stretch = np.divide(np.tan(theta), wanted, out=np.ones_like(theta), where=wanted > 1e-12)
            return stretch * xd, stretch * yd
    raise _not_invertible()


def _not_invertible() -> ConfigError:
    """Return the error of a distortion that has no inverse."""
    return ConfigError(
        "The distortion cannot be inverted over the whole image.", where="camera", remedy="Use weaker k1, k2."
    )


@lru_cache(maxsize=8)
def ray_grid(camera: CameraTruth, margin_px: int = 0) -> FloatArray:
    """Return rays through points of the image that are about `GRID_PX` apart.

    Own derivation: the inverse of `image_point`, ((u - cx) / fx, (v - cy) / fy) without distortion.

    margin_px: How far the grid extends beyond the image's border.
    Returns: Undistorted normalised coordinates. The grid divides the image evenly, from the outer edges of
      its outermost pixels (or of the margin's).
    Raises ConfigError: If the distortion cannot be inverted there; ``undistort`` raises it.
    """
    u, v = (
        np.linspace(-0.5 - margin_px, size - 0.5 + margin_px, math.ceil((size + 2 * margin_px) / GRID_PX) + 1)
        for size in (camera.width, camera.height)
    )
    uu, vv = np.meshgrid(u, v)
    return np.stack(undistort((uu - camera.cx) / camera.fx, (vv - camera.cy) / camera.fy, camera), axis=-1)
