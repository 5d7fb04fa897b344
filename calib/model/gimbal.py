"""The gimbal: how the readings of its axes become the rotation of the camera.

The camera is mounted on the gimbal's head with the rotation A, and the gimbal's base stands before the target with the
rotation B: R = A Rz(roll) Rx(tilt) Rz(delta) Ry(pan) B, camera <- target. Each angle is its reading times the scale of
its axis; delta is the angle between the axes of pan and tilt minus a right angle. With B and A this is the rotation
part of the robot-world and hand-eye problem (Zhuang, Roth and Sudhakar, 1994).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.model.rotation import euler_zxy, exp_map, log_map, nearest_rotation

Array = NDArray[np.float64]

MOUNTING = ("mounting_x", "mounting_y", "mounting_z")
STANDING = ("standing_x", "standing_y", "standing_z")
SCALES = ("scale_pan", "scale_tilt", "scale_roll")
NON_ORTHOGONALITY = "non_orthogonality"
GIMBAL = (*MOUNTING, *STANDING, *SCALES, NON_ORTHOGONALITY)

#: Axes of pan, tilt and roll in the head's frame.
_AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_ALTERNATIONS = 10
_NEWTON_STEPS = 6
#: Rolls of the mounting from which the search starts, degrees: a camera may hang upside down or on its side.
_START_ROLLS_DEG = range(0, 360, 45)


@dataclass(frozen=True)
class Gimbal:
    """The parameters of a gimbal.

    Attributes
    ----------
    camera_from_head
        (3, 3) float64 mounting A, camera <- gimbal's head.
    base_from_target
        (3, 3) float64 standing B, gimbal's base <- target.
    scales
        True angle over reading of pan, tilt and roll.
    non_orthogonality
        Angle between the axes of pan and tilt minus a right angle, rad.
    """

    camera_from_head: Array = field(default_factory=lambda: np.eye(3))
    base_from_target: Array = field(default_factory=lambda: np.eye(3))
    scales: tuple[float, float, float] = (1.0, 1.0, 1.0)
    non_orthogonality: float = 0.0

    def heads(self, angles_deg: Array) -> Array:
        """Return the rotations of the head.

        Parameters
        ----------
        angles_deg
            (n, 3) readings of pan, tilt, roll, degrees.

        Returns
        -------
        Array
            (n, 3, 3) rotations, head <- base.
        """
        scaled = np.radians(angles_deg * np.array(self.scales))
        skew = np.array([0.0, 0.0, self.non_orthogonality])
        pan, tilt, roll = (exp_map(scaled[:, [k]] * axis) for k, axis in enumerate(_AXES))
        return np.asarray(roll @ tilt @ exp_map(skew) @ pan)

    def axes(self, angles_deg: Array) -> Array:
        """Return the directions of the axes, seen from the camera.

        Parameters
        ----------
        angles_deg
            (n, 3) readings of pan, tilt, roll, degrees.

        Returns
        -------
        Array
            (n, 3, 3) unit vectors of pan, tilt and roll, in the columns.
        """
        scaled = np.radians(angles_deg * np.array(self.scales))
        tilt, roll = (exp_map(scaled[:, [k]] * _AXES[k]) for k in (1, 2))
        skewed = roll @ tilt @ exp_map(np.array([0.0, 0.0, self.non_orthogonality]))
        columns = [skewed @ _AXES[0], roll @ _AXES[1], np.broadcast_to(_AXES[2], (len(scaled), 3))]
        return np.asarray(self.camera_from_head @ np.stack(columns, axis=2))

    def rotations(self, angles_deg: Array) -> Array:
        """Return the rotations of the camera.

        Parameters
        ----------
        angles_deg
            (n, 3) readings of pan, tilt, roll, degrees.

        Returns
        -------
        Array
            (n, 3, 3) rotations, camera <- target.
        """
        return np.asarray(self.camera_from_head @ self.heads(angles_deg) @ self.base_from_target)

    def to_dict(self) -> dict[str, float]:
        """Return the parameters by name; a rotation as its rotation vector.

        Returns
        -------
        dict of str to float
            Rotation vectors and angles in rad, scales without a unit; the names are those of `GIMBAL`.
        """
        values = (*log_map(self.camera_from_head), *log_map(self.base_from_target), *self.scales)
        return dict(zip(GIMBAL, (*map(float, values), self.non_orthogonality), strict=True))

    def after_step(self, steps: Mapping[str, float]) -> Gimbal:
        """Return the gimbal after a step; a rotation is turned on its left side.

        Parameters
        ----------
        steps
            Increments by name; missing ones are zero, names of other things are ignored.

        Returns
        -------
        Gimbal
            Gimbal whose rotations stay orthogonal.
        """
        turn_a, turn_b = (
            np.array([steps.get(name, 0.0) for name in names]) for names in (MOUNTING, STANDING)
        )
        pan, tilt, roll = (
            scale + steps.get(name, 0.0) for name, scale in zip(SCALES, self.scales, strict=True)
        )
        return replace(
            self,
            camera_from_head=exp_map(turn_a) @ self.camera_from_head,
            base_from_target=exp_map(turn_b) @ self.base_from_target,
            scales=(pan, tilt, roll),
            non_orthogonality=self.non_orthogonality + steps.get(NON_ORTHOGONALITY, 0.0),
        )


def aligned_gimbal(rotations: Array, angles_deg: Array) -> Gimbal:
    """Return mounting and standing of a gimbal with unit scales, for the start of an adjustment.

    From several rolls of the mounting: alternating least squares, where with A known B is the mean of G^T A^T R (mean
    of rotations: Markley et al., 2007), then steps of Gauss and Newton on both. Own procedure.

    Parameters
    ----------
    rotations
        (n, 3, 3) rotations of the views, camera <- target.
    angles_deg
        (n, 3) readings of pan, tilt, roll, degrees.

    Returns
    -------
    Gimbal
        The best of all starts.
    """
    heads = Gimbal().heads(angles_deg)
    back = np.swapaxes(heads, 1, 2)
    best, least = Gimbal(), np.inf
    for roll in _START_ROLLS_DEG:
        a = euler_zxy(0.0, 0.0, float(roll))
        for _ in range(_ALTERNATIONS):
            b = nearest_rotation(np.mean(back @ a.T @ rotations, axis=0))
            a = nearest_rotation(np.mean(rotations @ b.T @ back, axis=0))
        for _ in range(_NEWTON_STEPS):
            turned = a @ heads
            off = log_map(rotations @ np.swapaxes(turned @ b, 1, 2))
            jacobian = np.concatenate([np.broadcast_to(np.eye(3), turned.shape), turned], axis=2)
            step = np.linalg.lstsq(jacobian.reshape(-1, 6), off.reshape(-1), rcond=1e-9)[0]
            a, b = exp_map(step[:3]) @ a, exp_map(step[3:]) @ b
        off = log_map(rotations @ np.swapaxes(a @ heads @ b, 1, 2))
        if (off**2).sum() < least:
            best, least = Gimbal(a, b), float((off**2).sum())
    return best
