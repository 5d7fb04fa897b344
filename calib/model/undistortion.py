"""An image without distortion: the ray of each pixel, its place in the rectified image, and the map back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch
from calib.model.camera import CameraModel

Array = NDArray[np.float64]
Table = NDArray[np.float32]

#: Pixels that are worked on at once.
_BLOCK = 200_000
#: A point of the rectified image farther out than every ray of the sensor would fold back into the image.
_BEYOND = 1.0 + 1e-6
_OUTSIDE = -1.0


@dataclass(frozen=True)
class Undistortion:
    """Tables of a camera for its image without distortion."""

    rays: Table  # (H, W, 3) float32 unit vector of each pixel in the camera's frame; NaN without a ray
    rectified_px: Table  # (H, W, 2) float32 place of each pixel in the rectified image; NaN without a ray
    # (H, W, 2) float32 where the rectified image takes each pixel from, as ``cv2.remap`` has it; -1 from nowhere.
    map_px: Table
    camera: CameraModel  # The camera of the rectified image: a pinhole

    @property
    def without_ray(self) -> float:
        """Share of the pixels that have no ray: there the distortion folds back."""
        return float(np.isnan(self.rays[..., 0]).mean())


def undistort(camera: CameraModel, keep: float = 0.0) -> Undistortion:
    """Return the tables of a camera, whose border's rays must fill a plane image.

    ``keep`` 0 leaves no empty pixel in the rectified image, 1 keeps every pixel of the sensor; between them the camera
    matrix is interpolated, as by ``cv2.getOptimalNewCameraMatrix``.
    """
    width, height = camera.image_size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(float)
    blocks = [slice(start, start + _BLOCK) for start in range(0, len(pixels), _BLOCK)]
    rays = np.concatenate([camera.rays(pixels[block]) for block in blocks])
    plane = rays[:, :2] / rays[:, 2:]
    pinhole = _rectified(plane.reshape(height, width, 2), keep, camera.image_size)
    scale, middle = np.array([pinhole.fx, pinhole.fy]), np.array([pinhole.cx, pinhole.cy])
    reach = _BEYOND * np.nanmax(np.linalg.norm(plane, axis=1))
    maps = np.empty((len(pixels), 2), np.float32)
    for block in blocks:
        wanted = (pixels[block] - middle) / scale
        found = camera.project(np.column_stack([wanted, np.ones(len(wanted))]))
        seen = (np.linalg.norm(wanted, axis=1) <= reach) & np.isfinite(found).all(axis=1)
        maps[block] = np.where(seen[:, None], found, _OUTSIDE)
    shape = (height, width)
    return Undistortion(
        rays.astype(np.float32).reshape(*shape, 3),
        (plane * scale + middle).astype(np.float32).reshape(*shape, 2),
        maps.reshape(*shape, 2),
        pinhole,
    )


def _rectified(plane: Array, keep: float, image_size: tuple[int, int]) -> CameraModel:
    """Return the pinhole whose image is a rectangle between the largest inside the rays and the smallest around them.

    ``plane`` is (H, W, 2), the rays at the distance 1, NaN without a ray.
    """
    sides = (plane[:, 0, 0], plane[:, -1, 0], plane[0, :, 1], plane[-1, :, 1])
    if any(np.isnan(side).all() for side in sides):
        raise InputMismatch(
            "The pixels along a side of the image have no ray in front of the camera.",
            remedy="A plane image without distortion does not exist for this lens. The calibration may be wrong there.",
        )
    left, right, top, bottom = sides
    inner = np.array([np.nanmax(left), np.nanmin(right), np.nanmax(top), np.nanmin(bottom)])
    outer = np.array([np.nanmin(left), np.nanmax(right), np.nanmin(top), np.nanmax(bottom)])
    if not (inner[1] > inner[0] and inner[3] > inner[2]):
        raise InputMismatch(
            "The rays of the border leave no plane image between them.",
            remedy="Check the calibration: its distortion is too large.",
        )
    width, height = image_size
    found = np.zeros(4)
    for share, (first_x, last_x, first_y, last_y) in ((1.0 - keep, inner), (keep, outer)):
        fx, fy = (width - 1) / (last_x - first_x), (height - 1) / (last_y - first_y)
        found += share * np.array([fx, fy, -fx * first_x, -fy * first_y])
    fx, fy, cx, cy = found.tolist()
    return CameraModel(fx, fy, cx, cy, image_size)


def straightness_px(points: Array, lines: Sequence[NDArray[np.int64]]) -> float:
    """Return the RMS distance, px, of (N, 2) points from their straight lines; lines of two points say nothing.

    Total least squares: the smallest singular value of each line's points about their mean.
    """
    used = [points[line] for line in lines if len(line) > 2]
    squares = [float(np.linalg.svd(one - one.mean(axis=0), compute_uv=False)[-1] ** 2) for one in used]
    return float(np.sqrt(sum(squares) / max(sum(len(one) for one in used), 1)))
