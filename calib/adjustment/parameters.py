"""The parameters of the adjustment: a camera, a collimator, and the rotation and centre of each view.

Views between which the camera hardly turned belong to one pose: they share the errors of collimator and pixel grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.model.gimbal import Gimbal
from calib.model.rotation import exp_map

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AdjustmentParameters:
    """A camera, a collimator, and the rotation and centre of each of n views."""

    camera: CameraModel
    collimator: Collimator
    rotations: Array  # (n, 3, 3) float64 rotations, camera <- target
    # (n, 3) float64 centre of each view minus the collimator's centre, mm; zero in the spherical model.
    offsets: Array
    gimbal: Gimbal | None = None  # The gimbal, if its readings are observations

    @property
    def centres(self) -> Array:
        """(n, 3) float64 centre of each view in the target frame, mm."""
        return self.collimator.centre + self.offsets

    def values(self, names: Sequence[str]) -> Array:
        """Return the (K,) values of shared parameters, each in the unit of its parameter."""
        known = {**self.camera.to_dict(), **self.collimator.to_dict()}
        return np.array([known[name] for name in names])

    def after_step(self, names: Sequence[str], shared: Array, local: Array) -> AdjustmentParameters:
        """Return the parameters after a step: (G,) increments of the shared ones, and local ones of each view.

        A rotation is updated by a small rotation about itself, R <- exp([t]x) R, as Triggs et al. (2000) recommend.
        ``local`` is (n, 3) rotation vectors, rad, on the camera's side; or (n, 6), with shifts of the centres, mm.
        """
        known = {**self.camera.to_dict(), **self.collimator.to_dict()}
        for name, step in zip(names, shared.tolist(), strict=True):
            known[name] += step
        camera = self.camera.with_values(np.array([known[name] for name in self.camera.parameter_names]))
        rotations = exp_map(local[:, :3]) @ self.rotations
        offsets = self.offsets + local[:, 3:] if local.shape[1] > 3 else self.offsets
        return AdjustmentParameters(camera, self.collimator.with_values(known), rotations, offsets)

    def subset(self, kept: Sequence[int]) -> AdjustmentParameters:
        """Return the parameters of some of the views."""
        index = list(kept)
        return replace(self, rotations=self.rotations[index], offsets=self.offsets[index])


#: Views that are turned by less against each other belong to one pose.
SAME_POSE_DEG = 0.2


def poses_of(rotations: Array) -> tuple[int, ...]:
    """Return for each view the index of its pose, from (n, 3, 3) rotations, camera <- target.

    A view belongs to the first pose whose first view is turned by less than 0.2 degrees against it. Own rule.
    """
    flat = np.asarray(rotations).reshape(len(rotations), 9)
    # The chord between two rotations turned by an angle t: |R - S| = sqrt(8) sin(t / 2), in the Frobenius norm.
    chord = np.sqrt(8.0) * np.sin(np.deg2rad(SAME_POSE_DEG) / 2.0)
    same = np.linalg.norm(flat[:, None] - flat[None], axis=2) < chord
    firsts: list[int] = []
    found = []
    for i, near in enumerate(same):
        pose = next((k for k, first in enumerate(firsts) if near[first]), len(firsts))
        if pose == len(firsts):
            firsts.append(i)
        found.append(pose)
    return tuple(found)


def members(poses: Sequence[int]) -> list[list[int]]:
    """Return the views of each pose."""
    return [[i for i, pose in enumerate(poses) if pose == k] for k in range(max(poses) + 1)]
