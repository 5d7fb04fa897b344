"""What the camera sees of the target through the collimator: a ray model of its own, shared with nobody.

Each pixel's corners are undistorted into rays, turned into the target's frame and cut with the target plane;
the printed brightness is averaged over the pixel, dimmed by the collimator's disc and its uneven light, and
blurred by the lens. Knows where things lie and how bright they are; nothing of time, light drive or events.

Frames: target plane Z = 0, X right, Y down, mm; camera centre c = (x, y, -r); X_cam = R (P - c); OpenCV's
distortion and pixel convention.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.target import StarTarget, TargetLayout, reflectance_at
from simulators.collimator_errors import Bending, Disc, apparent, bending_of, disc_of, is_ideal, reticle_point
from simulators.errors import ConfigError
from simulators.truth import CameraTruth, CollimatorTruth, OpticsTruth, Truth

FloatArray = NDArray[np.float64]

TARGET: Final = StarTarget()
"""The printed target behind the collimator."""


def pose_rotation(angles_deg: Mapping[Any, float], optics: OpticsTruth) -> FloatArray:
    """Rotation camera <- target of a gimbal pose, R = Rz(roll) Rx(tilt) Ry(pan) R0.

    Parameters
    ----------
    angles_deg
        "pan" about the camera's y axis, "tilt" about its x axis, "roll" about its z axis; missing = 0.
    optics
        Holds the mounting rotation R0.

    Returns
    -------
    (3, 3) float64.
    """
    pan, tilt, roll = (math.radians(angles_deg.get(name, 0.0)) for name in ("pan", "tilt", "roll"))
    mounting = np.radians(np.asarray(optics.mounting_deg, np.float64))
    return _turn((0, 0, roll)) @ _turn((tilt, 0, 0)) @ _turn((0, pan, 0)) @ _turn(mounting)


def _turn(rotation_vector: FloatArray | tuple[float, float, float]) -> FloatArray:
    """Rotation matrix of a rotation vector in radians (Rodrigues)."""
    x, y, z = (float(v) for v in rotation_vector)
    angle = math.sqrt(x * x + y * y + z * z)
    if angle == 0.0:
        return np.eye(3)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / angle
    return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * (k @ k)


# ---------------------------------------------------------------- camera


def distort(xn: FloatArray, yn: FloatArray, camera: CameraTruth) -> tuple[FloatArray, FloatArray]:
    """Distorted normalised coordinates of undistorted ones (Brown 1966, as OpenCV has it)."""
    r2 = xn * xn + yn * yn
    radial = 1.0 + r2 * (camera.k1 + r2 * (camera.k2 + r2 * camera.k3))
    xd = xn * radial + 2.0 * camera.p1 * xn * yn + camera.p2 * (r2 + 2.0 * xn * xn)
    yd = yn * radial + camera.p1 * (r2 + 2.0 * yn * yn) + 2.0 * camera.p2 * xn * yn
    return xd, yd


def undistort(xd: FloatArray, yd: FloatArray, camera: CameraTruth) -> tuple[FloatArray, FloatArray]:
    """Undistorted normalised coordinates, by fixed-point iteration to 1e-13.

    Raises
    ------
    ConfigError
        When the distortion cannot be inverted there: the radial polynomial turns back inside the image.
    """
    xn, yn = xd.copy(), yd.copy()
    for _ in range(200):
        xe, ye = distort(xn, yn, camera)
        step_x, step_y = xd - xe, yd - ye
        xn += step_x
        yn += step_y
        worst = max(float(np.abs(step_x).max()), float(np.abs(step_y).max()))
        if not worst < 1e3:
            break
        if worst < 1e-13:
            return xn, yn
    raise ConfigError(
        "The distortion cannot be inverted over the whole image.", where="camera", remedy="Use weaker k1, k2."
    )


def project(points_mm: FloatArray, rotation: FloatArray, truth: Truth) -> FloatArray:
    """Image points, (N, 2) px, of target points, (N, 2) mm; NaN behind the camera."""
    centre = _camera_centre(truth.collimator)
    seen_at = apparent(points_mm, bending_of(truth.collimator, rotation))
    rays = np.column_stack([seen_at, np.zeros(len(points_mm))]) - centre
    in_camera = rays @ rotation.T
    depth = np.where(in_camera[:, 2] > 0.0, in_camera[:, 2], np.nan)
    xd, yd = distort(in_camera[:, 0] / depth, in_camera[:, 1] / depth, truth.camera)
    camera = truth.camera
    return np.column_stack([camera.fx * xd + camera.cx, camera.fy * yd + camera.cy])


def _camera_centre(collimator: CollimatorTruth) -> FloatArray:
    """Camera centre in the target's frame, mm."""
    return np.array([collimator.x, collimator.y, -collimator.r])


@lru_cache(maxsize=4)
def corner_rays(camera: CameraTruth) -> NDArray[np.float32]:
    """(height + 1, width + 1, 2) undistorted normalised coordinates of all pixel corners."""
    u, v = np.meshgrid(np.arange(camera.width + 1) - 0.5, np.arange(camera.height + 1) - 0.5)
    xn, yn = undistort((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, camera)
    return np.stack([xn, yn], axis=-1).astype(np.float32)


# ---------------------------------------------------------------- what is seen


def star_centres(
    truth: Truth, rotation: FloatArray, *, clearance: float = 0.0, border_px: float = 0.0
) -> tuple[NDArray[np.int64], FloatArray]:
    """Compute the true image points of the stars that are visible in a pose.

    Parameters
    ----------
    clearance
        A star is visible if it lies at least that many squares inside the bright part of the disc.
    border_px
        ... and at least that far inside the image's edge.

    Returns
    -------
    ids
        (N,) int64, rising.
    points_px
        (N, 2) float64, pixel centres at integers.
    """
    ids = TARGET.ids
    positions = np.asarray(TARGET.positions_mm(ids), np.float64)
    points = project(positions, rotation, truth)
    collimator, camera = truth.collimator, truth.camera
    disc = disc_of(collimator, rotation)
    offset = positions - np.array([disc.x, disc.y])
    radius = disc.radius * (1.0 - collimator.rim) - clearance * TARGET.pitch_mm
    low, high = border_px - 0.5, np.array([camera.width, camera.height]) - 0.5 - border_px
    seen = (np.hypot(offset[:, 0], offset[:, 1]) <= radius) & ((points >= low) & (points <= high)).all(axis=1)
    return ids[seen], points[seen]


def render(truth: Truth, rotation: FloatArray, *, subsamples: int = 4) -> NDArray[np.float32]:
    """Share of the full light that reaches each pixel in a pose.

    Parameters
    ----------
    rotation
        (3, 3), camera <- target.
    subsamples
        Samples along each side of a pixel.

    Returns
    -------
    (height, width) float32, about 0 to 1: printed brightness x disc x illumination, after the point spread.
    """
    collimator, optics = truth.collimator, truth.optics
    disc = disc_of(collimator, rotation)
    light = Light(disc, collimator.rim, optics.gradient_x, optics.gradient_y, optics.black)
    image, rho = _render(
        corner_rays(truth.camera),
        rotation.T.copy(),
        _camera_centre(collimator),
        light,
        bending_of(collimator, rotation),
        TARGET.layout,
        subsamples,
    )
    blurred = blur(image, optics.psf_px)
    if optics.psf_rim_px > 0.0:
        share = np.minimum(rho, 1.0) ** 2
        blurred = (1.0 - share) * blurred + share * blur(image, optics.psf_rim_px)
    return np.asarray(blurred + np.float32(optics.stray), np.float32)


class Light(NamedTuple):
    """How the target is lit: the disc, its rim, its gradient, and what black segments let through."""

    disc: Disc
    rim: float
    gradient_x: float
    gradient_y: float
    black: float


def blur(image: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    """Gaussian point spread."""
    if sigma_px == 0.0:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), np.float32)


@njit(cache=True, nogil=True)
def _plane_row(rays: NDArray, r_t: NDArray, centre: NDArray, bending: Bending, out: NDArray) -> None:
    """Reticle points that a row of rays, (W + 1, 2), sees: (W + 1, 2) mm; NaN if a ray goes away from it."""
    ideal = is_ideal(bending)
    for j in range(rays.shape[0]):
        xn, yn = np.float64(rays[j, 0]), np.float64(rays[j, 1])
        dz = r_t[2, 0] * xn + r_t[2, 1] * yn + r_t[2, 2]
        scale = -centre[2] / dz if dz > 1e-6 else np.nan
        out[j, 0] = centre[0] + scale * (r_t[0, 0] * xn + r_t[0, 1] * yn + r_t[0, 2])
        out[j, 1] = centre[1] + scale * (r_t[1, 0] * xn + r_t[1, 1] * yn + r_t[1, 2])
        if not ideal:
            out[j, 0], out[j, 1] = reticle_point(out[j, 0], out[j, 1], bending)


@njit(cache=True, nogil=True)
def _disc_light(x_mm: float, y_mm: float, light: Light) -> tuple[float, float]:
    """Brightness of the disc at a point of the target, and the point's distance from its centre in radii."""
    dx, dy = (x_mm - light.disc.x) / light.disc.radius, (y_mm - light.disc.y) / light.disc.radius
    rho = math.sqrt(dx * dx + dy * dy)
    if not rho < 1.0:
        return 0.0, rho
    brightness = 1.0 + light.gradient_x * dx + light.gradient_y * dy
    if rho > 1.0 - light.rim:
        c = math.cos(0.5 * math.pi * (rho - 1.0 + light.rim) / light.rim)
        brightness *= c * c
    return brightness, rho


@njit(cache=True, nogil=True)
def _cell_brightness(top: NDArray, bottom: NDArray, j: int, n: int, layout: TargetLayout) -> float:
    """Average the printed brightness over the pixel between two rows of corners, n x n samples."""
    total = 0.0
    for a in range(n):
        v = (a + 0.5) / n
        left_x, left_y = (1 - v) * top[j, 0] + v * bottom[j, 0], (1 - v) * top[j, 1] + v * bottom[j, 1]
        right_x = (1 - v) * top[j + 1, 0] + v * bottom[j + 1, 0]
        right_y = (1 - v) * top[j + 1, 1] + v * bottom[j + 1, 1]
        for b in range(n):
            u = (b + 0.5) / n
            total += reflectance_at((1 - u) * left_x + u * right_x, (1 - u) * left_y + u * right_y, layout)
    return total / (n * n)


@njit(cache=True, nogil=True)
def _render(
    rays: NDArray, r_t: NDArray, centre: NDArray, light: Light, bending: Bending, layout: TargetLayout, n: int
) -> tuple[NDArray, NDArray]:
    """Loop of ``render``: picture before the point spread, and distance from the disc's centre in radii."""
    height, width = rays.shape[0] - 1, rays.shape[1] - 1
    image, distance = np.zeros((height, width), np.float32), np.ones((height, width), np.float32)
    top, bottom = np.empty((width + 1, 2)), np.empty((width + 1, 2))
    _plane_row(rays[0], r_t, centre, bending, top)
    for i in range(height):
        _plane_row(rays[i + 1], r_t, centre, bending, bottom)
        for j in range(width):
            x, y = 0.5 * (top[j, 0] + bottom[j + 1, 0]), 0.5 * (top[j, 1] + bottom[j + 1, 1])
            brightness, distance[i, j] = _disc_light(x, y, light)
            if brightness > 0.0:
                printed = _cell_brightness(top, bottom, j, n, layout)
                image[i, j] = brightness * (light.black + (1.0 - light.black) * printed)
        top, bottom = bottom, top
    return image, distance
