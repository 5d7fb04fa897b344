"""The parameters of the adjustment: a camera, a collimator, and the rotation and centre of each view.

This module applies steps to the parameters. It does not compare them with observations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

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

    @cached_property
    def shared(self) -> dict[str, float]:
        """All shared parameters by name; not to be changed."""
        gimbal = self.gimbal.to_dict() if self.gimbal else {}
        return {**self.camera.to_dict(), **self.collimator.to_dict(), **gimbal}

    def values(self, names: Sequence[str]) -> Array:
        """Return values of shared parameters.

        Returns: (K,) values, each in the unit of its parameter.
        """
        known = self.shared
        return np.array([known[name] for name in names])

    def after_step(self, names: Sequence[str], shared: Array, local: Array) -> AdjustmentParameters:
        """Return the parameters after a step.

        A rotation is updated by a small rotation about itself, R <- exp([t]x) R, as Triggs et al. (2000) recommend.

        shared: (G,) increments of these parameters.
        local: (n, 3) rotation vectors, rad, that turn each view on the camera's side; or (n, 6), followed by
          shifts of each view's centre, mm.
        """
        return self.after_steps(names, shared[None], local[None])[0]

    def after_steps(self, names: Sequence[str], shared: Array, local: Array) -> list[AdjustmentParameters]:
        """Return the parameters after each of P steps, as `after_step`.

        shared: (P, G) increments of these parameters.
        local: (P, n, L) increments of the local ones.
        """
        rotations = exp_map(local[:, :, :3]) @ self.rotations
        offsets = self.offsets + local[:, :, 3:] if local.shape[2] > 3 else [self.offsets] * len(local)
        return [
            self._after_step(dict(zip(names, one, strict=True)), turned, moved)
            for one, turned, moved in zip(shared.tolist(), rotations, offsets, strict=True)
        ]

    def _after_step(
        self, steps: Mapping[str, float], rotations: Array, offsets: Array
    ) -> AdjustmentParameters:
        """Return the parameters after steps of the shared parameters by name, with new rotations and offsets."""
        known = {**self.camera.to_dict(), **self.collimator.to_dict()}
        known = {name: value + steps.get(name, 0.0) for name, value in known.items()}
        camera = self.camera.with_values(np.array([known[name] for name in self.camera.parameter_names]))
        gimbal = self.gimbal.after_step(steps) if self.gimbal else None
        return AdjustmentParameters(camera, self.collimator.with_values(known), rotations, offsets, gimbal)

    def subset(self, kept: Sequence[int]) -> AdjustmentParameters:
        """Return the parameters of some of the views."""
        index = list(kept)
        return replace(self, rotations=self.rotations[index], offsets=self.offsets[index])
