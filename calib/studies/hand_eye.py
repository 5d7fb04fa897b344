"""Hand-eye check: the gimbal's readings compared with the rotations that the camera saw.

The camera is mounted on the gimbal's head with an unknown rotation A, and the gimbal's base stands before the target
with an unknown rotation B: R = A Rz(roll) Rx(tilt) Ry(pan) B. This is the rotation part of the robot-world and hand-eye
problem (Tsai and Lenz, 1989; Zhuang, Roth and Sudhakar, 1994). A scale of each axis that moved is estimated too if
there are enough views. The readings never enter the calibration, because a scale error of the gimbal would become one
of the focal length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from calib.errors import DegenerateViews, InputMismatch
from calib.model.rotation import euler_zxy, exp_map, log_map, nearest_rotation
from calib.uncertainty.projection_uncertainty import ARCSEC

Array = NDArray[np.float64]

AXES = ("pan_deg", "tilt_deg", "roll_deg")
_MIN_VIEWS = 3
_MOVED_DEG = 0.5
_STEPS = 50


@dataclass(frozen=True)
class HandEyeCheck:
    """Result of the comparison of rotations and readings.

    Attributes
    ----------
    scale
        True angle over reading, for each axis whose scale was estimated.
    scale_sigma
        1-sigma of the scales.
    camera_from_head
        (3, 3) float64 rotation A, camera <- gimbal's head.
    base_from_target
        (3, 3) float64 rotation B, gimbal's base <- target.
    residuals_arcsec
        (n, 3) float64 rotation seen minus rotation read, as rotation vectors about the camera's axes, arc seconds.
    sigma_arcsec
        (n, 3) float64 1-sigma of the rotations seen, arc seconds.
    chi_square, degrees_of_freedom
        Chi-square of the residuals and its degrees of freedom; large if the gimbal repeats worse than the camera
        measures.
    """

    scale: Mapping[str, float]
    scale_sigma: Mapping[str, float]
    camera_from_head: Array
    base_from_target: Array
    residuals_arcsec: Array
    sigma_arcsec: Array
    chi_square: float
    degrees_of_freedom: int

    @property
    def rms_arcsec(self) -> float:
        """Root mean square angle between rotations and readings, arc seconds."""
        return float(np.sqrt((self.residuals_arcsec**2).sum(axis=1).mean()))

    @property
    def consistent(self) -> bool:
        """Whether the chi-square is below its 99.9 % quantile."""
        return bool(self.chi_square < special.chdtri(max(self.degrees_of_freedom, 1), 0.001))


def check_hand_eye(
    rotations: Array, covariance: Array, readings_deg: Sequence[Mapping[str, float]]
) -> HandEyeCheck:
    """Compare the readings of a gimbal with the rotations of a calibration.

    The unknown rotations and scales are estimated by generalised least squares (Gauss-Newton). Robot-world and hand-eye
    equation: Zhuang, Roth and Sudhakar (1994). Least squares with a covariance matrix: Aitken (1936).

    Parameters
    ----------
    rotations
        (n, 3, 3) rotations of the views, camera <- target.
    covariance
        (3 n, 3 n) joint covariance of their rotation vectors, rad^2 (`Calibration.rotation_covariance`).
    readings_deg
        For each view the readings of its axes, degrees: any of ``pan_deg``, ``tilt_deg``, ``roll_deg``.

    Returns
    -------
    HandEyeCheck
        Estimates, residuals and chi-square.

    Raises
    ------
    InputMismatch
        If the numbers of views differ, or an axis is unknown.
    DegenerateViews
        If there are fewer than 3 views, or no axis moved.
    """
    angles = _angles(readings_deg)
    if not len(angles) == len(rotations) == len(covariance) // 3:
        raise InputMismatch(f"{len(rotations)} rotations, but {len(angles)} readings.")
    moved = np.ptp(angles, axis=0) > _MOVED_DEG
    if len(angles) < _MIN_VIEWS or not moved.any():
        raise DegenerateViews(
            f"Cannot check the gimbal: {len(angles)} views, {moved.sum()} axes moved; "
            f"at least {_MIN_VIEWS} views and 1 moved axis are needed."
        )
    free = [int(i) for i in np.flatnonzero(moved)] if 3 * len(angles) > 6 + moved.sum() else []
    scales, base_from_target, camera_from_head = np.ones(3), np.eye(3), np.eye(3)
    base_from_target = nearest_rotation(
        np.mean(np.swapaxes(_heads(angles, scales), 1, 2) @ rotations, axis=0)
    )
    information = np.linalg.pinv(covariance, rcond=1e-12, hermitian=True)
    for _ in range(_STEPS):
        off, jacobian = _linearised(rotations, angles, scales, camera_from_head, base_from_target, free)
        normal = jacobian.T @ information @ jacobian
        step = np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ jacobian.T @ information @ off
        camera_from_head, base_from_target = (
            exp_map(step[:3]) @ camera_from_head,
            exp_map(step[3:6]) @ base_from_target,
        )
        scales[free] += step[6:]
        if np.abs(step).max() < 1e-13:
            break
    off, jacobian = _linearised(rotations, angles, scales, camera_from_head, base_from_target, free)
    spread = np.sqrt(
        np.diag(np.linalg.pinv(jacobian.T @ information @ jacobian, rcond=1e-12, hermitian=True))
    )
    rank = int(np.linalg.matrix_rank(jacobian, tol=1e-9))
    return HandEyeCheck(
        {AXES[i]: float(scales[i]) for i in free},
        {AXES[i]: float(spread[6 + k]) for k, i in enumerate(free)},
        camera_from_head,
        base_from_target,
        ARCSEC * off.reshape(-1, 3),
        ARCSEC * np.sqrt(np.diag(covariance)).reshape(-1, 3),
        float(off @ information @ off),
        len(off) - rank,
    )


def _angles(readings_deg: Sequence[Mapping[str, float]]) -> Array:
    """Return (n, 3) pan, tilt, roll, degrees; axes without a reading are zero."""
    unknown = sorted({axis for reading in readings_deg for axis in reading} - set(AXES))
    if unknown:
        raise InputMismatch(f"Unknown axis {unknown[0]!r}.", remedy=f"Known: {', '.join(AXES)}.")
    return np.array([[reading.get(axis, 0.0) for axis in AXES] for reading in readings_deg])


def _heads(angles: Array, scales: Array) -> Array:
    """Return (n, 3, 3) rotations, gimbal's head <- base."""
    return np.array([euler_zxy(*(scales * row)) for row in angles])


def _linearised(
    rotations: Array,
    angles: Array,
    scales: Array,
    camera_from_head: Array,
    base_from_target: Array,
    free: Sequence[int],
) -> tuple[Array, Array]:
    """Return (3 n,) seen minus read, rad, and the (3 n, 6 + s) derivatives by A, B and the scales.

    Own derivation: with R = A G B, a rotation vector a on the left of A turns R by a, and b on the left of B turns it
    by A G b. The derivatives by the scales are forward differences.
    """
    heads = _heads(angles, scales)
    read = camera_from_head @ heads @ base_from_target
    off = log_map(rotations @ np.swapaxes(read, 1, 2)).reshape(-1)
    by_camera_side = np.tile(np.eye(3), (len(angles), 1))
    by_base_side = (camera_from_head @ heads).reshape(-1, 3)
    columns = [by_camera_side, by_base_side]
    for i in free:
        step = np.zeros(3)
        step[i] = 1e-6
        shifted = camera_from_head @ _heads(angles, scales + step) @ base_from_target
        columns.append(log_map(shifted @ np.swapaxes(read, 1, 2)).reshape(-1, 1) / 1e-6)
    return off, np.hstack(columns)
