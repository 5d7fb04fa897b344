"""Lens of the simulated camera: from rays to pixels and back.

Two models, in OpenCV's conventions with pixel centres at integers: pinhole with Brown's distortion (Brown
1966, 1971), and the fisheye of Kannala and Brandt (2006). This module works on directions in the camera's
frame; it uses no scene.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulators.errors import ConfigError
from simulators.world.truth import (
    CameraTruth,
)

FloatArray = NDArray[np.float64]

GRID_PX: Final = 8
"""Spacing of the points at which rays are computed; between them rays are interpolated."""


def distort(xn: FloatArray, yn: FloatArray, lens: CameraTruth) -> tuple[FloatArray, FloatArray]:
    """Return distorted normalised coordinates of undistorted ones x/z and y/z, two arrays of one shape (...,).

    Pinhole: radial k1, k2, k3 and tangential p1, p2 (Brown 1966, 1971; sign and order as in OpenCV). Fisheye (Kannala
    and Brandt 2006, radial part, as in OpenCV): with theta = atan r, the point lies at theta (1 + k1 theta^2 + k2
    theta^4 + k3 theta^6 + k4 theta^8).
    """
    r2 = xn * xn + yn * yn
    if lens.projection == "fisheye":
        r = np.sqrt(np.maximum(r2, 1e-16))
        theta = np.arctan(r)
        t2 = theta * theta
        scale = theta * (1.0 + t2 * (lens.k1 + t2 * (lens.k2 + t2 * (lens.k3 + t2 * lens.k4)))) / r
        return scale * xn, scale * yn
    radial = 1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    xd = xn * radial + 2.0 * lens.p1 * xn * yn + lens.p2 * (r2 + 2.0 * xn * xn)
    yd = yn * radial + lens.p1 * (r2 + 2.0 * yn * yn) + 2.0 * lens.p2 * xn * yn
    return xd, yd


def image_point(
    x: FloatArray, y: FloatArray, z: FloatArray, lens: CameraTruth
) -> tuple[FloatArray, FloatArray]:
    """Return image points u and v, px, of points in the camera's frame, (...,); NaN behind it (as `distort`)."""
    z = np.where(z > 0.0, z, np.nan)
    xd, yd = distort(x / z, y / z, lens)
    return lens.fx * xd + lens.cx, lens.fy * yd + lens.cy


def undistort(xd: FloatArray, yd: FloatArray, lens: CameraTruth) -> tuple[FloatArray, FloatArray]:
    """Return undistorted normalised coordinates of distorted ones, two arrays of one shape (...,), to 1e-13.

    The pinhole model is inverted by fixed-point iteration, x <- x + (x_d - distort(x)) (own derivation), the fisheye by
    Newton's method. Where the radial polynomial decreases inside the image, `ConfigError` is raised.
    """
    if lens.projection == "fisheye":
        return _undistort_fisheye(xd, yd, lens)
    xn, yn = xd.copy(), yd.copy()
    for _ in range(200):
        xe, ye = distort(xn, yn, lens)
        step_x, step_y = xd - xe, yd - ye
        xn += step_x
        yn += step_y
        worst = max(float(np.abs(step_x).max()), float(np.abs(step_y).max()))
        if not worst < 1e3:
            break
        if worst < 1e-13:
            return xn, yn
    raise _not_invertible()


def _undistort_fisheye(xd: FloatArray, yd: FloatArray, lens: CameraTruth) -> tuple[FloatArray, FloatArray]:
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
    """Return rays (undistorted normalised coordinates) through points of the image about `GRID_PX` apart.

    Own derivation: the inverse of `image_point`, ((u - cx) / fx, (v - cy) / fy) without distortion; errors as
    `undistort`. The grid divides the image evenly, from the outer edges of its outermost pixels or, beyond the border,
    of the margin's.
    """
    u, v = (
        np.linspace(-0.5 - margin_px, size - 0.5 + margin_px, math.ceil((size + 2 * margin_px) / GRID_PX) + 1)
        for size in (camera.width, camera.height)
    )
    uu, vv = np.meshgrid(u, v)
    return np.stack(undistort((uu - camera.cx) / camera.fx, (vv - camera.cy) / camera.fy, camera), axis=-1)
