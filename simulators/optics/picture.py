"""The image of the target through the collimator, by a ray model of its own that no other package shares.

The black areas of the print are projected from the target plane through the collimator and the lens into the image.
Each pixel gets the exact share that they cover. The light is dimmed by the disc of light and its uneven illumination,
and blurred by the point spread. This module computes where things lie and how bright they are; it uses no time, no
light waveform and no events.

Frames: target plane Z = 0, X right, Y down, mm; camera centre c = (x, y, -r); X_cam = R (P - c); distortion and pixel
convention of OpenCV.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from calib.target import StarTarget
from simulators.optics.collimator_errors import (
    Disc,
    aberrations_of,
    disc_of,
    radius_fraction,
)
from simulators.optics.drawing import (
    Cells,
    Projection,
    draw,
    empty_picture,
    image_points,
    join_cells,
    plane_points,
    spread_kernel,
)
from simulators.optics.lens import ray_grid
from simulators.optics.lens_focus import blur_px, camera_of, reach_px, spread_over_disc
from simulators.optics.outlines import black_polygons
from simulators.world.gimbal import GimbalTruth, gimbal_rotation, rotation_matrix
from simulators.world.truth import CollimatorTruth, OpticsTruth, Truth

FloatArray = NDArray[np.float64]

TARGET: Final = StarTarget()
"""The standard target, which is printed unless a station describes another one."""

PERFECT_GIMBAL: Final = GimbalTruth()

_COARSE_FROM_PX: Final = 4.0
"""Diameter of a blur from which on two cells along a pixel's side suffice."""

_BLOCK_ROWS: Final = 16
"""Rows that are computed at a time: their numbers stay in the processor's cache."""

_black_polygons = lru_cache(maxsize=4)(black_polygons)


def pose_rotation(
    angles_deg: Mapping[Any, float], optics: OpticsTruth, gimbal: GimbalTruth = PERFECT_GIMBAL
) -> FloatArray:
    """Return the rotation camera <- target of a gimbal pose, R = Rz(roll) Rx(tilt) Ry(pan) R0 without errors.

    "pan" is about the camera's y axis, "tilt" about its x axis, "roll" about its z axis; missing = 0. ``optics`` holds
    the mounting rotation R0, ``gimbal`` the errors and their equation. Rotations: Diebel (2006).
    """
    return gimbal_rotation(angles_deg, gimbal) @ rotation_matrix(np.radians(optics.mounting_deg))


def true_rotation(angles_deg: Mapping[Any, float], truth: Truth) -> FloatArray:
    """Return the true rotation camera <- target when the loads of the axes stand at certain angles; missing = 0.

    With backlash they differ from the readings; see ``gimbal.Gears``. All simulated cameras and the rehearsed
    world use this function. Rotations: Diebel (2006).
    """
    rotation = pose_rotation(angles_deg, truth.optics, truth.gimbal)
    pan, tilt, roll = truth.mount.turn_deg
    return gimbal_rotation({"pan": pan, "tilt": tilt, "roll": roll}, PERFECT_GIMBAL) @ rotation


def beam_of(truth: Truth) -> CollimatorTruth:
    """Return the collimator as the camera, shifted by ``mount.shift_mm``, sees it: the disc moves the opposite way."""
    (x, y), c = truth.mount.shift_mm, truth.collimator
    return replace(c, disc_x=c.disc_x - x, disc_y=c.disc_y - y)


def projection_of(truth: Truth, rotation: FloatArray) -> Projection:
    """Return the projection of a pose."""
    c = beam_of(truth)
    return Projection(
        camera_of(truth),
        np.ascontiguousarray(rotation, np.float64),
        np.array([c.x, c.y, -c.r]),
        aberrations_of(c, rotation, truth.reticle),
    )


def project(points_mm: FloatArray, rotation: FloatArray, truth: Truth) -> FloatArray:
    """Return the image points of target points, (N, 2) mm: spherical motion, arXiv:2512.16092, eq. 2."""
    return np.asarray(
        image_points(np.ascontiguousarray(points_mm, np.float64), projection_of(truth, rotation))
    )


def star_centres(
    truth: Truth, rotation: FloatArray, *, clearance: float = 0.0, border_px: float = 0.0
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return ids, (N,) int64, increasing, and true image points, (N, 2), of the stars that are visible in a pose.

    Pixel centres are at integers. Own rule: a star is visible if it lies at least ``clearance`` squares inside the
    bright part of the disc and ``border_px`` inside the image's edge; projection as in `project`.
    """
    ids = truth.target.ids
    positions = np.asarray(truth.target.positions_mm(ids), np.float64)
    points = project(positions, rotation, truth)
    collimator, camera = beam_of(truth), truth.camera
    disc = disc_of(collimator, rotation)
    bright = 1.0 - collimator.rim - clearance * truth.target.pitch_mm / disc.radius
    low, high = border_px - 0.5, np.array([camera.width, camera.height]) - 0.5 - border_px
    seen = (radius_fraction(positions[:, 0], positions[:, 1], disc) <= bright) & (
        (points >= low) & (points <= high)
    ).all(axis=1)
    return ids[seen], points[seen]


def render(truth: Truth, rotation: FloatArray, *, subsamples: int = 4) -> NDArray[np.float32]:
    """Return the share of the full light, about 0 to 1, that reaches each pixel in a pose.

    It is printed brightness x disc x illumination, after the point spread: own model, described in the head. The areas
    are exact (Levien, 2016).
    """
    optics, camera, disc = truth.optics, camera_of(truth), disc_of(beam_of(truth), rotation)
    blur = blur_px(truth)
    if blur > _COARSE_FROM_PX:
        subsamples = min(subsamples, 2)
    kernel = spread_kernel(optics.psf_px, subsamples)
    margin = math.ceil((kernel.size / subsamples - 1) / 2)
    cells = Cells(subsamples, margin + reach_px(blur))
    steps = empty_picture(camera.width, camera.height, cells.per_px, cells.margin_px)
    rays, projection = ray_grid(camera, cells.margin_px), projection_of(truth, rotation)
    widest = disc.radius * (1.0 + float(np.abs(disc.edge).sum()))
    black = _black_polygons(truth.target)
    reach = truth.target.pitch_mm * max(1.0, 1.5 * truth.target.tag_squares / truth.target.tag_modules)
    lit = np.hypot(*(black[:, 0] - (disc.x, disc.y)).T) < widest + reach
    draw(black[lit], projection, rays, cells, steps)
    white, dark = (1.0, optics.black)[:: 1 if truth.reticle.polarity == "positive" else -1]
    shades = (white, dark - white)
    light = _light(
        plane_points(rays, projection),
        truth,
        disc,
        camera.height + 2 * cells.margin_px,
        camera.width + 2 * cells.margin_px,
    )
    image = spread_over_disc(join_cells(steps, light, shades, kernel, subsamples, margin), blur)
    return np.asarray(image + np.float32(optics.stray), np.float32)


def _light(plane: FloatArray, truth: Truth, disc: Disc, height: int, width: int) -> NDArray[np.float32]:
    """Return the disc's brightness at the corners of all pixels.

    ``plane`` holds the points where rays meet the target, on a grid that covers the image evenly; they are interpolated
    bilinearly.
    """
    rows, v = _between(plane.shape[0], height)
    columns, u = _between(plane.shape[1], width)
    brightness = np.zeros((height + 1, width + 1), np.float32)
    for first in range(0, height + 1, _BLOCK_ROWS):
        block = slice(first, first + _BLOCK_ROWS)
        above, below = plane[rows[block]], plane[rows[block] + 1]
        down = (1 - v[block, None, None]) * above + v[block, None, None] * below
        x, y = (
            (1 - u) * each[:, columns] + u * each[:, columns + 1] for each in (down[..., 0], down[..., 1])
        )
        brightness[block] = _disc_light(x, y, truth, disc)
    return brightness


def _disc_light(x_mm: FloatArray, y_mm: FloatArray, truth: Truth, disc: Disc) -> FloatArray:
    """Return the disc's brightness at target points; own model: a gradient times cos^2 at the rim."""
    rim, optics = truth.collimator.rim, truth.optics
    x, y = (x_mm - disc.x) / disc.radius, (y_mm - disc.y) / disc.radius
    rho = radius_fraction(x_mm, y_mm, disc)
    brightness = 1.0 + optics.gradient_x * x + optics.gradient_y * y
    c = np.cos(0.5 * math.pi * np.clip(rho - 1.0 + rim, 0.0, rim) / (rim or 1.0))
    return np.where(rho < 1.0, brightness * (c * c), 0.0)


def _between(points: int, steps: int) -> tuple[Any, Any]:
    """Return where so many even steps lie among points that cover the same length: the point before, and the share."""
    at = np.arange(steps + 1) * ((points - 1) / steps)
    before = np.minimum(at.astype(np.int64), points - 2)
    return before, np.asarray(at - before)
