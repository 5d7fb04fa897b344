"""The readings of a gimbal as observations of the adjustment: three for each view.

The residual of a view is the rotation vector from the rotation that the gimbal predicts to the view's own,
e = log(R (A G B)^T), on the camera's side. This module computes residuals and derivatives; it chooses no weights
besides those of the stated uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.model.gimbal import MOUNTING, NON_ORTHOGONALITY, SCALES, STANDING, Gimbal
from calib.model.prior import Prior
from calib.model.rotation import log_map

Array = NDArray[np.float64]

#: An axis that turned by less does not determine its scale.
_MOVED_DEG = 0.5
#: Prior 1-sigma of mounting and standing, rad. It matters only if the views leave a rotation open: one axis moved.
_OPEN_SIGMA_RAD = 1.0
#: Prior 1-sigma of the angle between pan and tilt about a right angle, rad: half a degree.
_NON_ORTHOGONALITY_SIGMA_RAD = np.deg2rad(0.5)
#: Readings closer than this have the same error of the encoder.
_SAME_READING_DEG = 0.02


@dataclass(frozen=True)
class GimbalObservations:
    """Readings of all views and their weight."""

    angles_deg: Array  # (n, 3) float64 readings of pan, tilt, roll, degrees
    sigma_rad: float  # Standard uncertainty of a reading, rad
    _kept: list[tuple[Gimbal, tuple[Array, Array, Array]]] = field(
        default_factory=list, init=False, repr=False, compare=False
    )

    def subset(self, kept: Sequence[int]) -> GimbalObservations:
        """Return the readings of some of the views."""
        return replace(self, angles_deg=self.angles_deg[list(kept)])

    def information(self, gimbal: Gimbal) -> Array:
        """Return the information of the readings on the rotation of each view.

        An encoder repeats its error at the same reading, so that m views with one reading of an axis know this axis no
        better than one view: each gets m times the variance about it. Own approximation of the joint covariance.

        Returns: (n, 3, 3) inverse covariances of the rotation vectors on the camera's side, 1 / rad^2.
        """
        axes = self._turned(gimbal)[1]
        covariance = axes * self._variances[:, None] @ np.swapaxes(axes, 1, 2)
        return np.asarray(np.linalg.inv(covariance))

    @cached_property
    def _variances(self) -> Array:
        """(n, 3) float64 variance of the rotation about each axis, rad^2."""
        same = np.abs(self.angles_deg[:, None] - self.angles_deg[None]) < _SAME_READING_DEG
        moved = np.ptp(self.angles_deg, axis=0) > _MOVED_DEG
        return np.asarray(self.sigma_rad**2 * np.where(moved, same.sum(axis=1), 1.0))

    def _turned(self, gimbal: Gimbal) -> tuple[Array, Array, Array]:
        """Return `Gimbal.turned`; the last one is kept, because several equations ask for the same."""
        if not self._kept or self._kept[0][0] is not gimbal:
            self._kept[:] = [(gimbal, gimbal.turned(self.angles_deg))]
        return self._kept[0][1]

    def residuals(self, gimbal: Gimbal, rotations: Array) -> Array:
        """Return the rotations seen minus those read.

        Rotation part of the robot-world and hand-eye equation (Zhuang, Roth and Sudhakar, 1994).

        rotations: (n, 3, 3) rotations of the views, camera <- target.
        Returns: (n, 3) rotation vectors on the camera's side, rad.
        """
        read = self._turned(gimbal)[0] @ gimbal.base_from_target
        return log_map(rotations @ np.swapaxes(read, 1, 2))

    def derivatives(self, gimbal: Gimbal, names: Sequence[str]) -> Array:
        """Return the derivatives of the residuals by parameters of the gimbal.

        Own derivation for small residuals: a turn of A or B on its left side turns the prediction by it, or by A G
        times it. A scale turns it about its axis by the reading, the angle between the axes about the axis of delta.

        gimbal: Where to evaluate the derivatives.
        names: G names of free parameters; those that are not the gimbal's give zeros.
        Returns: (n, 3, G) derivatives, rad per unit of each parameter.
        """
        n = len(self.angles_deg)
        out = np.zeros((n, 3, len(names)))
        turned, axes, leaning = self._turned(gimbal)
        by_scale = axes * np.radians(self.angles_deg)[:, None]
        for at, name in enumerate(names):
            if name in MOUNTING:
                out[:, MOUNTING.index(name), at] = -1.0
            elif name in STANDING:
                out[:, :, at] = -turned[:, :, STANDING.index(name)]
            elif name in SCALES:
                out[:, :, at] = -by_scale[:, :, SCALES.index(name)]
            elif name == NON_ORTHOGONALITY:
                out[:, :, at] = -leaning
        return out

    def free_parameters(self, scale_sigma: float) -> Prior:
        """Return the parameters that the readings need, with their prior.

        Own choice: the scale of an axis is free if the axis moved and its scale is not certain; the angle between pan
        and tilt is free if both moved.

        scale_sigma: Standard uncertainty of the scales; 0 if they are certain.
        """
        moved = np.ptp(self.angles_deg, axis=0) > _MOVED_DEG
        sigmas = dict.fromkeys((*MOUNTING, *STANDING), _OPEN_SIGMA_RAD)
        if scale_sigma > 0:
            sigmas |= {name: scale_sigma for name, free in zip(SCALES, moved, strict=True) if free}
        if moved[0] and moved[1]:
            sigmas[NON_ORTHOGONALITY] = float(_NON_ORTHOGONALITY_SIGMA_RAD)
        mean = np.array([1.0 if name in SCALES else 0.0 for name in sigmas])
        return Prior(tuple(sigmas), mean, np.diag([sigma**-2 for sigma in sigmas.values()]))
