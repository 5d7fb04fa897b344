"""A state of the refinement: a camera, a collimator, and each view's rotation and centre.

Knows how a step moves it; not what it is measured against.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.model.rotation import exp_map

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AdjustmentParameters:
    """A camera, a collimator and each view's rotation and centre.

    Attributes
    ----------
    camera, collimator
        What the views share.
    rotations
        (n, 3, 3), camera <- target.
    offsets
        (n, 3) each view's centre less the collimator's, mm; zero in the spherical model.
    """

    camera: CameraModel
    collimator: Collimator
    rotations: Array
    offsets: Array

    @property
    def centres(self) -> Array:
        """(n, 3) centre of each view in the target frame, mm."""
        return self.collimator.centre + self.offsets

    @property
    def shared(self) -> dict[str, float]:
        """All shared parameters by name."""
        return {**self.camera.to_dict(), **self.collimator.to_dict()}

    def values(self, names: Sequence[str]) -> Array:
        """Return shared parameters by name."""
        known = self.shared
        return np.array([known[name] for name in names])

    def after_step(self, names: Sequence[str], shared: Array, local: Array) -> AdjustmentParameters:
        """Return the state after a step.

        `shared` adds to the named parameters; `local`, (n, 3 or 6), turns each view by a rotation vector on the
        camera's side and moves its centre.
        """
        known = self.shared
        for name, step in zip(names, shared, strict=True):
            known[name] += float(step)
        camera = self.camera.with_values(np.array([known[name] for name in self.camera.parameter_names]))
        rotations = exp_map(local[:, :3]) @ self.rotations
        offsets = self.offsets + local[:, 3:] if local.shape[1] > 3 else self.offsets
        return AdjustmentParameters(camera, self.collimator.with_values(known), rotations, offsets)

    def subset(self, kept: Sequence[int]) -> AdjustmentParameters:
        """Return the state with some of its views."""
        index = list(kept)
        return replace(self, rotations=self.rotations[index], offsets=self.offsets[index])
