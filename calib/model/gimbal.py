"""The gimbal: how the readings of its axes become the rotation of the camera.

The camera is mounted on the gimbal's head with the rotation A, and the gimbal's base stands before the target with the
rotation B: R = A Rz(roll) Rx(tilt) Rz(delta) Ry(pan) B, camera <- target. Each angle is its reading times the scale of
its axis; delta is the angle between the axes of pan and tilt minus a right angle. With B and A this is the rotation
part of the robot-world and hand-eye problem (Zhuang, Roth and Sudhakar, 1994).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calib.arrays import Array
from calib.model.rotation import euler_zxy, exp_map, log_map, nearest_rotation

MOUNTING = ("mounting_x", "mounting_y", "mounting_z")
STANDING = ("standing_x", "standing_y", "standing_z")
SCALES = ("scale_pan", "scale_tilt", "scale_roll")
NON_ORTHOGONALITY = "non_orthogonality"
GIMBAL = (*MOUNTING, *STANDING, *SCALES, NON_ORTHOGONALITY)

#: Axes of pan, tilt and roll in the head's frame.
_AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_ALTERNATIONS = 10  # They bring a mounting near; then
_NEWTON_STEPS = 6  # settle it
#: Rolls of the mounting from which the search starts, degrees: a camera may hang upside down or on its side.
_START_ROLLS_DEG = range(0, 360, 45)
#: A camera that looks backwards; it is believed only if its sum of squares is this many times smaller.
_BACKWARDS, _DOUBTED = np.diag([1.0, -1.0, -1.0]), 10.0
#: Sums of squares below this are rounding, rad^2.
_TINY = 1e-14
#: Directions with a singular value below this share of the largest are left open.
_OPEN = 1e-9


@dataclass(frozen=True)
class Gimbal:
    """The parameters of a gimbal."""

    # (3, 3) float64 mounting A, camera <- gimbal's head.
    camera_from_head: Array = field(default_factory=lambda: np.eye(3))
    # (3, 3) float64 standing B, gimbal's base <- target.
    base_from_target: Array = field(default_factory=lambda: np.eye(3))
    scales: tuple[float, float, float] = (1.0, 1.0, 1.0)  # True angle over reading of pan, tilt and roll
    non_orthogonality: float = 0.0  # Angle between the axes of pan and tilt minus a right angle, rad

    def heads(self, angles_deg: Array) -> Array:
        """Return the (n, 3, 3) rotations, head <- base, of (n, 3) readings of pan, tilt, roll."""
        pan, _, _, before_pan = self._turns(angles_deg)
        return np.asarray(before_pan @ pan)

    def turned(self, angles_deg: Array) -> tuple[Array, Array, Array]:
        """Return how the head turns the camera, and about which axes, at (n, 3) readings of pan, tilt, roll.

        Returns: (n, 3, 3) rotations, camera <- base; (n, 3, 3) unit vectors of pan, tilt and roll, seen from the
          camera, in the columns; and (n, 3) that of the axis about which pan leans against a right angle with tilt.
        """
        pan, tilt, roll, before_pan = self._turns(angles_deg)
        leaning = roll @ tilt
        axes = np.empty_like(pan)
        axes[:, :, 0], axes[:, :, 1], axes[:, :, 2] = before_pan[:, :, 1], roll[:, :, 0], _AXES[2]
        mounted = self.camera_from_head @ axes
        return self.camera_from_head @ (before_pan @ pan), mounted, leaning[:, :, 2] @ self.camera_from_head.T

    def _turns(self, angles_deg: Array) -> tuple[Array, Array, Array, Array]:
        """Return (n, 3, 3) the rotations by pan, by tilt and by roll, and the product of all turns left of pan's."""
        scaled = np.radians(angles_deg * np.array(self.scales))
        pan, tilt, roll = exp_map(scaled.T[:, :, None] * _AXES[:, None])
        return pan, tilt, roll, roll @ tilt @ exp_map(np.array([0.0, 0.0, self.non_orthogonality]))

    def rotations(self, angles_deg: Array) -> Array:
        """Return the (n, 3, 3) rotations, camera <- target, of (n, 3) readings of pan, tilt, roll."""
        return np.asarray(self.camera_from_head @ self.heads(angles_deg) @ self.base_from_target)

    def to_dict(self) -> dict[str, float]:
        """Return the parameters named in `GIMBAL`: rotation vectors and angles, rad, and scales."""
        turns = log_map(np.array([self.camera_from_head, self.base_from_target])).reshape(-1).tolist()
        return dict(zip(GIMBAL, (*turns, *map(float, self.scales), self.non_orthogonality), strict=True))

    def after_step(self, steps: Mapping[str, float]) -> Gimbal:
        """Return the gimbal after a step; a rotation is turned on its left side."""
        steps = {**dict.fromkeys(GIMBAL, 0.0), **steps}
        turns = np.array([[steps[name] for name in names] for names in (MOUNTING, STANDING)])
        pan, tilt, roll = (scale + steps[name] for name, scale in zip(SCALES, self.scales, strict=True))
        mounted, standing = exp_map(turns) @ np.array([self.camera_from_head, self.base_from_target])
        leaning = self.non_orthogonality + steps[NON_ORTHOGONALITY]
        return Gimbal(mounted, standing, (pan, tilt, roll), leaning)


def aligned_gimbal(rotations: Array, angles_deg: Array) -> Gimbal:
    """Return the start of a gimbal with unit scales from (n, 3, 3) rotations, camera <- target, and (n, 3) readings."""
    heads = Gimbal().heads(angles_deg)
    a, b = mountings(rotations, heads)
    sums = (_seen_minus_read(rotations, a[:, None] @ heads, b) ** 2).sum(axis=(1, 2)) + _TINY
    sums[a[:, 2, 2] < 0] *= _DOUBTED
    best = int(np.argmin(sums))
    return Gimbal(a[best], b[best])


def mountings(rotations: Array, heads: Array) -> tuple[Array, Array]:
    """Return (P, 3, 3) mountings A and standings B that fit (n, 3, 3) rotations of views and head, some maybe equal.

    From several rolls of the mounting, and as many of a camera that looks backwards, which a wrong sign of an axis
    imitates: alternating least squares, where with A known B is the mean of G^T A^T R (mean of rotations: Markley et
    al., 2007), then steps of Gauss and Newton on both. Own procedure.
    """
    back = np.swapaxes(heads, 1, 2)
    upright = np.array([euler_zxy(0.0, 0.0, float(roll)) for roll in _START_ROLLS_DEG])
    a = np.concatenate([upright, upright @ _BACKWARDS])
    for _ in range(_ALTERNATIONS):
        b = nearest_rotation(np.mean(back @ np.swapaxes(a, 1, 2)[:, None] @ rotations, axis=1))
        a = nearest_rotation(np.mean(rotations @ np.swapaxes(b, 1, 2)[:, None] @ back, axis=1))
    for _ in range(_NEWTON_STEPS):
        turned = a[:, None] @ heads
        off = _seen_minus_read(rotations, turned, b)
        jacobian = np.concatenate([np.broadcast_to(np.eye(3), turned.shape), turned], axis=3)
        inverse = np.linalg.pinv(jacobian.reshape(len(a), -1, 6), rcond=_OPEN)
        step = (inverse @ off.reshape(len(a), -1, 1))[:, :, 0]
        a, b = exp_map(step[:, :3]) @ a, exp_map(step[:, 3:]) @ b
    return a, b


def _seen_minus_read(rotations: Array, turned: Array, b: Array) -> Array:
    """Return (P, n, 3) rotation vectors from the predictions of P gimbals to the rotations of n views."""
    return log_map(rotations @ np.swapaxes(turned @ b[:, None], 2, 3))
