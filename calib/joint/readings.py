"""The gimbal's readings as observations of the views' rotations.

A reading predicts the rotation M = A Rz(roll) Rx(tilt) Rz(delta) Ry(pan) B (`calib.model.gimbal`). Each angle is its
reading times the scale of its axis, plus two errors of the encoder: e_s sin(a) + e_c (cos(a) - 1) of one period, and a
smooth one. Poses at neighbouring angles share it, so they do not count as independent readings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.arrays import Array
from calib.joint.effects.gimbal import ECCENTRICITY, ENCODER
from calib.model.gimbal import GIMBAL, MOUNTING, NON_ORTHOGONALITY, STANDING, Gimbal, aligned_gimbal
from calib.model.gimbal_readings import AXES, GimbalReadings, alike_errors
from calib.model.rotation import log_map

#: Readings that scatter this many times more than stated are looked at.
SCATTER = 2.0
#: Readings that scatter this many times more than stated contradict the stars, and do not enter. On nine ray-traced
#: benches of another author, right ends have .9 at most; ends at another camera are off by more than 1000 times.
MOST_SCATTER = 3.0
#: Parts of the smooth errors with a smaller variance are left to what each reading has for itself.
_SMALL_PART = 0.05


@dataclass(frozen=True)
class Readings:
    """Readings of all views."""

    angles_deg: Array  # (m, 3) pan, tilt, roll
    sigma_rad: float  # Standard uncertainty of each rotation component
    moved: tuple[bool, bool, bool]  # Which axes have different readings

    @classmethod
    def of(cls, stated: GimbalReadings) -> Readings:
        """Return the readings that a station states."""
        angles = stated.angles
        moved = np.ptp(angles, axis=0) > 0.0
        return cls(angles, float(np.radians(stated.reading_sigma_deg)), tuple(moved.tolist()))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the gimbal's unknowns; an axis that stands still has none."""
        axes = [axis for axis, moves in zip(("pan", "tilt", "roll"), self.moved, strict=True) if moves]
        turned = [f"scale_{axis}" for axis in axes] + [
            name for name in ECCENTRICITY if name.split("_")[1] in axes
        ]
        return (*MOUNTING, *STANDING, *turned, *self.smooth, NON_ORTHOGONALITY)

    @cached_property
    def smooth(self) -> Mapping[str, tuple[int, Array]]:
        """By the name of an unknown: the axis, and (m,) the part of its smooth errors with this unit variance."""
        parts_by_name: dict[str, tuple[int, Array]] = {}
        for k, alike in enumerate(alike_errors(self.angles_deg)):
            if self.moved[k]:
                sizes, parts = np.linalg.eigh(alike)
                axis = AXES[k].removesuffix("_deg")
                for number, at in enumerate(np.flatnonzero(sizes > _SMALL_PART)):
                    parts_by_name[f"{ENCODER}_{axis}_{number}"] = k, np.sqrt(sizes[at]) * parts[:, at]
        return parts_by_name

    @cached_property
    def errors(self) -> Mapping[str, tuple[int, Array]]:
        """By the name of an error of an encoder: its axis, and (m,) the error of each reading for a unit of it."""
        errors: dict[str, tuple[int, Array]] = {}
        angles = np.radians(self.angles_deg)
        for name in ECCENTRICITY:
            axis, part = name.split("_")[1:]
            k = AXES.index(f"{axis}_deg")
            errors[name] = k, np.sin(angles[:, k]) if part == "sin" else np.cos(angles[:, k]) - 1.0
        return {**errors, **self.smooth}

    def start(self, rotations: Array) -> Gimbal:
        """Return the gimbal that fits given rotations with unit scales."""
        return aligned_gimbal(rotations, self.angles_deg)

    def true_angles_deg(self, shared: Mapping[str, float]) -> Array:
        """Return (m, 3) the readings with the encoders' errors of one period, before the scales."""
        errors = np.zeros_like(self.angles_deg)
        for name, (k, error) in self.errors.items():
            errors[:, k] += shared.get(name, 0.0) * error
        return self.angles_deg + np.degrees(errors)

    def off(self, gimbal: Gimbal, shared: Mapping[str, float], rotations: Array) -> Array:
        """Return (m, 3) rotation vectors from the predictions to the views' rotations, rad."""
        predicted = gimbal.rotations(self.true_angles_deg(shared))
        return np.asarray(log_map(rotations @ np.swapaxes(predicted, 1, 2)))

    def jacobian(self, gimbal: Gimbal, shared: Mapping[str, float]) -> Array:
        """Return (m, 3, g) change of the predicted rotations by the unknowns of `names`, on the camera's side."""
        turned, axes, leaning = gimbal.turned(self.true_angles_deg(shared))
        by_mounting, angles = np.broadcast_to(np.eye(3), turned.shape), np.radians(self.angles_deg)
        by_gimbal = np.concatenate([by_mounting, turned, axes * angles[:, None], leaning[:, :, None]], axis=2)
        columns = dict(zip(GIMBAL, by_gimbal.transpose(2, 0, 1), strict=True))
        columns |= {name: axes[:, :, k] * error[:, None] for name, (k, error) in self.errors.items()}
        return np.stack([columns[name] for name in self.names], axis=2)
