"""Model of a gimbal: what its readings and its errors say about the rotation of its head.

The head turns by Rz(roll) Rx(tilt) Rz(squareness) Ry(pan). Each axis can have a scale and slips.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class GimbalModel:
    """The readings of a gimbal and the errors of it that are estimated.

    angles: (n, 3) float64 readings of pan, tilt and roll, degrees.
    slips: For each slip the index of its axis, and the index of the first pose after it.
    squareness: Whether the error of the right angle between the pan axis and the tilt axis is estimated.
    smooth: Whether an error of the rotations that is quadratic in the angles is estimated.
    """

    angles: Array
    free: tuple[int, ...]
    slips: tuple[tuple[int, int], ...] = ()
    squareness: bool = False
    smooth: bool = False

    @property
    def parameter_count(self) -> int:
        """Number of parameters beside the rotations A and B."""
        return len(self.free) + len(self.slips) + self.squareness + self.bends.shape[2]

    @property
    def start(self) -> Array:
        """(p,) float64 values of an ideal gimbal."""
        values = np.zeros(self.parameter_count)
        values[: len(self.free)] = 1.0
        return values

    @cached_property
    def bends(self) -> Array:
        """(n, 3, m) float64 quadratic functions of the angles, as rotation vectors; m is 0 or 3 a function."""
        if not self.smooth:
            return np.zeros((len(self.angles), 3, 0))
        x = self.angles - self.angles.mean(axis=0)
        x = x / np.maximum(np.abs(x).max(axis=0), 1e-9)
        moved = [i for i in range(3) if np.ptp(self.angles[:, i]) > 0]
        products = [x[:, i] * x[:, j] for k, i in enumerate(moved) for j in moved[k:]]
        return np.concatenate([column[:, None, None] * np.eye(3) for column in products], axis=2)

    def subset(self, kept: NDArray[np.int64]) -> GimbalModel:
        """Return the model of a part of the poses.

        kept: (k,) int64 increasing indices of the poses kept.
        Returns: Model with the same errors; a slip begins at the first kept pose after it.
        """
        slips = tuple((axis, int(np.searchsorted(kept, first))) for axis, first in self.slips)
        return replace(self, angles=self.angles[kept], slips=slips)

    def heads(self, values: Array) -> tuple[Array, Array]:
        """Return the rotations of the head that the readings and the errors give, and their derivatives.

        values: (p,) scales, slips (rad), squareness (rad) and coefficients of the bends (rad).
        Returns: (n, 3, 3) rotations, gimbal's head <- base; and (n, 3, d) derivatives by the values before
          the bends, as rotation vectors about the head's axes.
        """
        read = np.deg2rad(self.angles)
        turned = read.copy()
        turned[:, list(self.free)] *= values[: len(self.free)]
        at = len(self.free)
        for axis, first in self.slips:
            turned[first:, axis] += values[at]
            at += 1
        roll = about(2, turned[:, 2])
        tilted = roll @ about(0, turned[:, 1])
        square = tilted @ about(2, values[at : at + 1]) if self.squareness else tilted
        # The axis of each motor, about which its angle turns the head.
        motors = np.stack([square[:, :, 1], roll[:, :, 0], np.broadcast_to(_Z, (len(read), 3))], axis=2)
        columns = [motors[:, :, axis] * read[:, axis, None] for axis in self.free]
        for axis, first in self.slips:
            after = np.arange(len(read)) >= first
            columns.append(motors[:, :, axis] * after[:, None])
        if self.squareness:
            columns.append(tilted[:, :, 2])
        derivatives = np.stack(columns, axis=2) if columns else np.zeros((len(read), 3, 0))
        return square @ about(1, turned[:, 0]), derivatives


def about(axis: int, angles_rad: Array) -> Array:
    """Return rotations about a coordinate axis.

    Source: Diebel (2006).

    axis: 0, 1 or 2 for x, y or z.
    angles_rad: (n,) angles, rad.
    Returns: (n, 3, 3) rotation matrices.
    """
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrices = np.zeros((len(angles_rad), 3, 3))
    matrices[:, axis, axis] = 1.0
    matrices[:, i, i] = matrices[:, j, j] = np.cos(angles_rad)
    matrices[:, j, i] = np.sin(angles_rad)
    matrices[:, i, j] = -matrices[:, j, i]
    return matrices
