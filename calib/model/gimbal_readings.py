"""The readings of a gimbal, and what they are worth as measurements.

Readings measure the rotations of the views. They determine the focal length if the collimator's radius is unknown. Two
errors imitate a change of the focal length and do not show in the residuals: a scale error of the encoder, and
parallax. Parallax needs both a collimator out of focus and an entrance pupil off the pivot: the pupil then moves across
the beam when the camera turns, and the pattern moves with it. This module holds data only; `calib.adjustment` uses it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from calib.arrays import Array, product_sigma
from calib.errors import InputMismatch

#: Names of the axes in readings, in the order of the rotations Ry(pan), Rx(tilt), Rz(roll).
AXES = ("pan_deg", "tilt_deg", "roll_deg")
#: How far a camera's pupil is beside the axes that turn it, 1-sigma, if the camera was set up by eye.
BESIDE_AXES_MM = 2.0
#: Poses that differ by less along all axes are one.
ONE_ANGLE_DEG = 0.05
MIN_VIEWS = 3  # Two turns fix the mounting of the target before the gimbal
MOVED_DEG = 0.5  # A smaller range of an axis says nothing of its direction
#: Errors of an axis at neighbouring angles are alike within this length: a worm wheel of 180 teeth has a period of 2
#: degrees, and a sine is as curved at its top as this kernel at zero.
ALIKE_DEG = 2.0 / (2.0 * np.pi)
#: So many lengths apart, they are not alike (1 %).
_APART = 3.0
#: What neighbours share is expected to be so large, over the 1-sigma of what each reading has for itself.
ENCODER_SHARE = 0.7


@dataclass(frozen=True)
class ParallaxBound:
    """What bounds the parallax of a gimbal before a collimator: each quantity with its standard uncertainty.

    Defocus, dimensionless: when the camera moves across the beam by s, the pattern appears to move by -defocus s on the
    target, on the optical axis. A target at the finite distance D has the defocus r / D; an ideal collimator has 0. Off
    pivot, mm, is how far the entrance pupil is in front of the pivot; beside axes is the 1-sigma of its place along the
    other directions.
    """

    defocus: float
    defocus_sigma: float
    pupil_off_pivot_mm: float
    pupil_off_pivot_sigma_mm: float
    pupil_beside_axes_mm: float = BESIDE_AXES_MM

    def __post_init__(self) -> None:
        for name in ("defocus_sigma", "pupil_off_pivot_sigma_mm", "pupil_beside_axes_mm"):
            if not getattr(self, name) >= 0:
                raise InputMismatch(f"{name} is {getattr(self, name)}; it must not be negative.")
        if not np.isfinite(astuple(self)).all():
            raise InputMismatch("The bound of the parallax contains a number that is not finite.")

    def mean_and_sigma(self, r_mm: float) -> tuple[float, float]:
        """Return the expected displacement of the pattern per sine of the turn, as a share of r, and its 1-sigma.

        The pupil moves across the beam by off_pivot times the sine of the turn, and the pattern by -defocus times
        that.
        """
        off = self.pupil_off_pivot_mm, self.pupil_off_pivot_sigma_mm
        sigma = product_sigma((self.defocus, self.defocus_sigma), off)
        return -self.defocus * off[0] / r_mm, sigma / r_mm

    def aside_sigma(self, r_mm: float) -> float:
        """Return the 1-sigma change of the radius per sine of the turn, as a share, by a pupil beside the pivot."""
        return float(np.hypot(self.defocus, self.defocus_sigma)) * self.pupil_beside_axes_mm / r_mm


@dataclass(frozen=True)
class GimbalReadings:
    """Readings of all views, with their standard uncertainties, which must be positive (scale, eccentricity: may be 0).

    angles_deg: For each view any of ``pan_deg``, ``tilt_deg``, ``roll_deg``.
    reading_sigma_deg: Wobble of the axes included. It holds for the rotation about every axis of the head, also about
      one that the gimbal does not have.
    scale_sigma: Of each axis's scale (true angle over reading).
    eccentricity_deg: Of the amplitude of the encoder's error of one period a turn; over a small range of angles it acts
      as a scale error.
    parallax: What bounds it; None if nothing does. The readings are then compared with the result, but do not enter it.
    source: A certificate, a data sheet, a measurement.
    """

    angles_deg: tuple[Mapping[str, float], ...]
    reading_sigma_deg: float
    scale_sigma: float = 0.0
    eccentricity_deg: float = 0.0
    parallax: ParallaxBound | None = None
    source: str = ""

    def __post_init__(self) -> None:
        if not 0 < self.reading_sigma_deg < np.inf:
            raise InputMismatch(f"reading_sigma_deg is {self.reading_sigma_deg}; it must be positive.")
        for name in ("scale_sigma", "eccentricity_deg"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputMismatch(f"{name} is {getattr(self, name)}; it must not be negative.")
        angles_of(self.angles_deg)
        read = {axis for reading in self.angles_deg for axis in reading}
        for number, reading in enumerate(self.angles_deg, start=1):
            if missing := sorted(read - set(reading)):
                raise InputMismatch(
                    f"Reading {number} has no {missing[0]}, but other readings have.",
                    remedy="Give each axis in all readings, or in none.",
                )

    def part(self, views: Iterable[int]) -> GimbalReadings:
        """Return the readings of some of the views, by their places."""
        return replace(self, angles_deg=tuple(self.angles_deg[at] for at in views))

    @property
    def angles(self) -> Array:
        """(n, 3) float64 pan, tilt, roll of each view, degrees; axes without a reading are zero."""
        return angles_of(self.angles_deg)


def alike_errors(angles_deg: Array) -> Array:
    """Return (k, n, n) how the errors that n readings of k axes share with their neighbours are correlated.

    Own choice of a Gaussian: exp(-(angle between them / `ALIKE_DEG`)^2 / 2).

    A reading without a neighbour has a row of zeros: all of its error is its own. So has one whose neighbours only
    repeat its pose.
    """
    apart = np.abs(angles_deg[:, None] - angles_deg)
    other_pose = apart.max(axis=2) > ONE_ANGLE_DEG
    distance = np.moveaxis(apart, 2, 0) / ALIKE_DEG
    shared = ((distance < _APART) & other_pose).any(axis=2)
    return np.asarray(np.exp(-0.5 * distance**2) * shared[:, :, None] * shared[:, None, :])


def angles_of(readings_deg: Sequence[Mapping[str, float]]) -> Array:
    """Return (n, 3) pan, tilt, roll, degrees; axes without a reading are zero, unknown axes are refused."""
    unknown = sorted({axis for reading in readings_deg for axis in reading} - set(AXES))
    if unknown:
        raise InputMismatch(f"Unknown axis {unknown[0]!r}.", remedy=f"Known: {', '.join(AXES)}.")
    angles = np.array([[reading.get(axis, 0.0) for axis in AXES] for reading in readings_deg]).reshape(-1, 3)
    if not np.isfinite(angles).all():
        raise InputMismatch("An angle is not a finite number.")
    return angles
