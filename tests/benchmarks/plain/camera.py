"""The camera as unknowns: log f and the ratio of fx and fy, the principal point in units of f, and its lens.

Beyond the family of the lens it has thin prism distortion s |d|^2 of the image d (Weng, Cohen and Herniou, 1992); a
fisheye lens, which has no p1 and p2, also their decentring |d|^2 e + 2 (d e) d. They act on the image that the lens
makes, so that they stay small where tangents grow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.arrays import Array
from calib.model.camera import SKEW, CameraModel
from calib.model.lens import BROWN, FISHEYE, R8, distort_with_jacobians, is_fisheye

PINHOLE = ("log f", "aspect", "centre x", "centre y")
DECENTRING, PRISM = ("decentring x", "decentring y"), ("prism x", "prism y")


def lens_names(chosen: Sequence[str]) -> tuple[str, ...]:
    """Return the coefficients that are estimated: the whole family, and those of the denominator only if asked for.

    With a denominator there is no term of r^8, which it would imitate.
    """
    if is_fisheye(dict.fromkeys(chosen, 0.0)):
        return FISHEYE
    wanted = {*BROWN[:5], *chosen}
    further = () if wanted & set(BROWN[5:]) else (R8,)
    return tuple(name for name in (*BROWN, SKEW) if name in wanted) + further


@dataclass(frozen=True)
class Camera:
    """The unknowns of a camera. ``f0_px`` is the scale of log f and of the principal point, and does not change."""

    image_size: tuple[int, int]
    f0_px: float
    lens: tuple[str, ...]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the C unknowns."""
        return (*PINHOLE, *self.lens, *(DECENTRING if self.is_fisheye else ()), *PRISM)

    @property
    def is_fisheye(self) -> bool:
        """Whether the lens is of the fisheye family."""
        return is_fisheye(self.lens)

    @property
    def middle(self) -> Array:
        """(2,) the middle of the image, px."""
        return 0.5 * (np.array(self.image_size, float) - 1.0)

    @property
    def corner(self) -> float:
        """The corner of the sensor: the tangent of its angle, or the angle itself for a fisheye lens."""
        tangent = 0.5 * float(np.hypot(*self.image_size)) / self.f0_px
        return float(np.arctan(tangent)) if self.is_fisheye else tangent

    def model(self, c: Array) -> CameraModel:
        """Return the camera of (C,) unknowns, without prism and decentring of a fisheye."""
        fx, fy = self._focal(c)
        cx, cy = self.middle + self.f0_px * c[2:4]
        return CameraModel(fx, fy, float(cx), float(cy), self.image_size, self._coefficients(c))

    def unknowns(self, model: CameraModel) -> Array:
        """Return (C,) the unknowns of a camera."""
        c = np.zeros(len(self.names))
        c[0] = 0.5 * np.log(model.fx * model.fy) - np.log(self.f0_px)
        c[1] = np.log(model.fx / model.fy)
        c[2:4] = (np.array([model.cx, model.cy]) - self.middle) / self.f0_px
        c[4 : 4 + len(self.lens)] = [model.distortion.get(name, 0.0) for name in self.lens]
        return c

    def by_unknowns(self, c: Array) -> Array:
        """Return (4 + K, C) how the parameters of `model` follow the unknowns."""
        fx, fy = self._focal(c)
        rows = np.eye(4 + len(self.lens), len(c))
        rows[0, :2], rows[1, :2] = (fx, 0.5 * fx), (fy, -0.5 * fy)
        rows[2, 2] = rows[3, 3] = self.f0_px
        return rows

    def project(self, c: Array, points: Array) -> Array:
        """Return (N, 2) px of (N, 3) points in the camera's axes; NaN behind it."""
        return self.linearised(c, points)[0]

    def linearised(self, c: Array, points: Array) -> tuple[Array, Array, Array]:
        """Return (N, 2) px, their derivatives by the (N, 3) points, (N, 2, 3), and by the unknowns, (N, 2, C)."""
        depth = np.where(points[:, 2:] > 0.0, points[:, 2:], np.nan)
        plane = points[:, :2] / depth
        bent, by_plane, by_lens = distort_with_jacobians(plane, self._coefficients(c))
        image, by_bent, by_further = self._further(c, bent)
        scale = np.array(self._focal(c))
        sheared = np.diag(scale)
        if SKEW in self.lens:
            sheared[0, 1] = c[4 + self.lens.index(SKEW)]
        px = image @ sheared.T + self.middle + self.f0_px * c[2:4]
        by_image = sheared @ by_bent
        by_plane = by_image @ by_plane
        by_point = np.concatenate([by_plane, -(by_plane @ plane[:, :, None])], axis=2) / depth[:, :, None]
        by_unknowns = np.zeros((len(points), 2, len(c)))
        by_unknowns[:, :, 0] = scale * image
        by_unknowns[:, :, 1] = scale * image * np.array([0.5, -0.5])
        by_unknowns[:, 0, 2] = by_unknowns[:, 1, 3] = self.f0_px
        by_unknowns[:, :, 4 : 4 + len(self.lens)] = by_image @ by_lens
        by_unknowns[:, :, 4 + len(self.lens) :] = sheared @ by_further
        if SKEW in self.lens:
            by_unknowns[:, 0, 4 + self.lens.index(SKEW)] = image[:, 1]
        return px, by_point, by_unknowns

    def _focal(self, c: Array) -> tuple[float, float]:
        fx, fy = self.f0_px * np.exp(c[0] + np.array([0.5, -0.5]) * c[1])
        return float(fx), float(fy)

    def _coefficients(self, c: Array) -> dict[str, float]:
        return dict(zip(self.lens, c[4 : 4 + len(self.lens)].tolist(), strict=True))

    def _further(self, c: Array, d: Array) -> tuple[Array, Array, Array]:
        """Return the (N, 2) image with prism and decentring, and its derivatives by d and by these unknowns."""
        more = c[4 + len(self.lens) :]
        e, s = (more[:2], more[2:]) if self.is_fisheye else (np.zeros(2), more)
        square, along = (d * d).sum(axis=1), d @ e
        image = d + square[:, None] * (s + e) + 2.0 * along[:, None] * d
        by_d = np.eye(2) * (1.0 + 2.0 * along[:, None, None]) + 2.0 * (s + e)[:, None] * d[:, None, :]
        by_d = by_d + 2.0 * d[:, :, None] * e
        by_prism = square[:, None, None] * np.eye(2)
        if not self.is_fisheye:
            return image, by_d, by_prism
        return image, by_d, np.concatenate([by_prism + 2.0 * d[:, :, None] * d[:, None, :], by_prism], axis=2)
