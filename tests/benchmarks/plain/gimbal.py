"""The gimbal's readings as observations of the views' rotations.

A reading predicts the rotation M = A Rz(roll) Rx(tilt) Rz(delta) Ry(pan) B (`calib.model.gimbal`). Unknowns are small
turns of A and B, delta, and errors of the encoders: scales, one period a turn, and smooth ones that poses at
neighbouring angles share.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.arrays import Array, Ints
from calib.model import result_parts as parts
from calib.model.gimbal import MOUNTING, NON_ORTHOGONALITY, STANDING, Gimbal, aligned_gimbal
from calib.model.gimbal_readings import AXES, GimbalReadings, alike_errors
from calib.model.rotation import exp_map, log_map, skew

from . import amplitudes as amp
from . import knowledge as stated
from .shapes import LARGER
from .table import Row, Statement, Table

ENCODER = "encoder"
#: Parts of the smooth errors with a smaller variance are left to what each reading has for itself.
_SMALL_PART = 0.05
#: All scales of a gimbal are wrong together as often as one: one setting scales them all.
_TOGETHER = 1.0
_NO_ANGLE = 1e-8


class AxisError(NamedTuple):
    """An unknown error of an axis."""

    name: str
    axis: int
    by_reading: Array  # (m,) error of each angle for a unit of it, rad
    size: float
    amplitude: str = ""


@dataclass(frozen=True)
class Readings:
    """Readings of all m views, about a gimbal that is near."""

    stated: GimbalReadings
    near: Gimbal
    at: Ints  # (G,) places of the gimbal's unknowns among the shared ones

    @classmethod
    def added(cls, table: Table, readings: GimbalReadings, rotations: Array) -> Readings:
        """Add the unknowns of a gimbal that stands and turns as (m, 3, 3) rotations of the views show."""
        one = cls(readings, aligned_gimbal(rotations, readings.angles), np.zeros(0, np.int64))
        axes = Row(parts.GIMBAL_AXES, "B", "expected sizes")
        at = [table.add(name, axes, 1.0) for name in (*MOUNTING, *STANDING)]
        lean = table.add(NON_ORTHOGONALITY, axes, stated.SKEW_RAD)
        free = np.array([stated.FREE_SKEW_RAD])
        table.statements.append(Statement(stated.ORTHOGONAL, lean, free, LARGER, axes))
        source = f"station: {readings.source}" if readings.source else "station"
        station = Row(parts.GIMBAL_SCALE, "B", source)
        encoder = Row(parts.READINGS, "B", "station: reading_sigma_deg")
        at.append(lean)
        for error in one.errors:
            row = encoder if error.amplitude else station
            at.append(table.add(error.name, row, error.size, amplitude=error.amplitude))
            if error.name.startswith("scale_"):
                what = stated.SCALE_OF.format(error.name.removeprefix("scale_"))
                free = np.array([max(stated.FREE_SCALE, error.size)])
                together = {"together": parts.GIMBAL_SCALE, "together_odds": _TOGETHER}
                table.statements.append(
                    Statement(what, at[-1], free, LARGER, station, "1", 1.0, **together)  # type: ignore[arg-type]
                )
        return cls(readings, one.near, np.concatenate(at))

    @property
    def sigma_rad(self) -> float:
        """Standard uncertainty of each rotation component of a reading."""
        return float(np.radians(self.stated.reading_sigma_deg))

    @cached_property
    def angles_rad(self) -> Array:
        """(m, 3) pan, tilt, roll."""
        return np.radians(self.stated.angles)

    @cached_property
    def errors(self) -> tuple[AxisError, ...]:
        """The errors of all axes that moved."""
        scale, eccentric = self.stated.scale_sigma, float(np.radians(self.stated.eccentricity_deg))
        of_axes, errors = zip(AXES, alike_errors(self.stated.angles), strict=False), list[AxisError]()
        for k, (name, alike) in enumerate(of_axes):
            angles, axis = self.angles_rad[:, k], name.removesuffix("_deg")
            if np.ptp(angles) == 0.0:
                continue
            errors.append(AxisError(f"scale_{axis}", k, angles, max(scale, stated.EXACT)))
            periods = (np.sin(angles), np.cos(angles) - 1.0)
            errors += [
                AxisError(f"eccentricity_{axis}_{part}", k, period, max(eccentric, 1e-9))
                for part, period in zip(("sin", "cos"), periods, strict=True)
            ]
            sizes, shapes = np.linalg.eigh(alike)
            errors += [
                AxisError(
                    f"{ENCODER}_{axis}_{j}",
                    k,
                    np.sqrt(sizes[at]) * shapes[:, at],
                    self.sigma_rad,
                    amp.ENCODER,
                )
                for j, at in enumerate(np.flatnonzero(sizes > _SMALL_PART))
            ]
        return tuple(errors)

    def gimbal(self, g: Array) -> Gimbal:
        """Return the gimbal of (G,) unknowns, without the errors of its axes."""
        mounted, standing = exp_map(g[:6].reshape(2, 3)) @ [
            self.near.camera_from_head,
            self.near.base_from_target,
        ]
        return Gimbal(mounted, standing, non_orthogonality=float(g[6]))

    def true_angles_deg(self, g: Array) -> Array:
        """Return (m, 3) the angles with the errors of the axes."""
        angles = self.angles_rad.copy()
        for value, error in zip(g[7:], self.errors, strict=True):
            angles[:, error.axis] += value * error.by_reading
        return np.degrees(angles)

    def off(self, g: Array, rotations: Array) -> Array:
        """Return (m, 3) rotation vectors from the predictions to the rotations of the views, rad."""
        predicted = self.gimbal(g).rotations(self.true_angles_deg(g))
        return np.asarray(log_map(rotations @ np.swapaxes(predicted, 1, 2)))

    def jacobian(self, g: Array) -> Array:
        """Return (m, 3, G) the turn of the predictions by the unknowns, on the camera's side."""
        turned, axes, leaning = self.gimbal(g).turned(self.true_angles_deg(g))
        mounting = np.broadcast_to(_left(g[:3]), turned.shape)
        by_axes = [axes[:, :, error.axis] * error.by_reading[:, None] for error in self.errors]
        columns = [leaning[:, :, None], *(column[:, :, None] for column in by_axes)]
        return np.concatenate([mounting, turned @ _left(g[3:6]), *columns], axis=2)


def _left(v: Array) -> Array:
    """Return the (3, 3) matrix J with exp(v + d) = exp(J d) exp(v) (Diebel, 2006)."""
    angle, k = max(float(np.linalg.norm(v)), _NO_ANGLE), skew(v[None])[0]
    return np.asarray(
        np.eye(3) + (1.0 - np.cos(angle)) / angle**2 * k + (angle - np.sin(angle)) / angle**3 * k @ k
    )
