"""What an effect is: unknowns, what they do to a pose's image, what is expected of them, and a row of the budget.

A pose sees the shared unknowns b through its own basis: camera, radius and the coefficients of one field, c_i = T_i b.
An effect holds the columns of T_i that belong to its unknowns. Of some entries of the basis each pose has a part of its
own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array
from calib.joint.amplitudes import Pupil
from calib.joint.fields import COEFFICIENTS, FieldBasis

Places = NDArray[np.int64]


class Row(NamedTuple):
    """The row of the budget that unknowns belong to."""

    name: str
    kind: Literal["A", "B"]  # Evaluated from the views, or by other means
    source: str = ""  # Empty: that of the statement about the same


@dataclass(frozen=True)
class RandomBlock:
    """Unknowns with the prior covariance diag(stated) + sum_j a_j^2 U_j U_j^T."""

    row: Row
    names: tuple[str, ...]  # K
    parts: tuple[tuple[str, Array], ...]  # For each amplitude its name and (K, M) its U_j
    stated: Array | float = 0.0  # (K,) variances that a station states


@dataclass(frozen=True)
class OwnPart:
    """Entries of a pose's basis of which it has a part of its own: independent, each with an amplitude."""

    row: Row
    places: Places  # (F,) in the pose's basis
    amplitudes: tuple[str, ...]  # F names
    information: Array  # (F,) for unit amplitudes


@dataclass(frozen=True)
class PoseBasis:
    """The entries of a pose's basis: camera, radius, displacements about its visible disc, one field, disc's middle."""

    camera: tuple[str, ...]
    fields: FieldBasis
    about_disc: int = 0  # Number of displacements about the visible disc; 0 if discs do not count

    @cached_property
    def radius(self) -> int:
        """Place of the radius."""
        return len(self.camera)

    @cached_property
    def rim(self) -> slice:
        """Places of the displacements about the disc."""
        return slice(self.radius + 1, self.radius + 1 + self.about_disc)

    @cached_property
    def field(self) -> slice:
        """Places of the field: coefficients of X, then those of Y."""
        return slice(self.rim.stop, self.rim.stop + COEFFICIENTS)

    @cached_property
    def shifts(self) -> Places:
        """Places of a shift along X and along Y: the field's coefficients of degree 0."""
        return self.rim.stop + np.array([0, COEFFICIENTS // 2])

    @cached_property
    def middle(self) -> slice:
        """Places of the disc's middle."""
        return slice(self.field.stop, self.size)

    @cached_property
    def size(self) -> int:
        """Number of entries."""
        return self.field.stop + 2 * bool(self.about_disc)


@dataclass(frozen=True)
class Circumstances:
    """What the effects read of a bench before its views are seen."""

    pupil: Pupil
    far: float  # How many times as far as expected the pupil of a gimbal moves, at least 1
    corner: float  # Tangent of the angle between the axis and the sensor's corner
    reach: float  # Largest distance of a turn from the mean turn, as a tangent
    n_poses: int
    parallax_known: bool  # Whether a station bounds the parallax
    terms: Mapping[str, Array]  # Type B terms by name: (2 K,) field of a unit
    wavefront: float = 0.0  # RMS slope of the collimator's wavefront that a station states, rad
    gimbal: tuple[str, ...] = ()  # Names of the gimbal's unknowns; empty without readings
    reading_rad: float = 0.0  # Standard uncertainty of a reading
    passport: tuple[str, ...] = ()  # Names of the unknowns that a passport states


@dataclass(frozen=True)
class Turned:
    """How the camera is turned at n poses, and where its pupil is."""

    turns: Array  # (n, 2) tangents of the turns along X and Y
    axes: Array  # (n, 2, 2) the camera's x and y axes on the target
    # (n, 2) what the fields by turn follow: the sines of the turns, or the places of a pupil that is moved by hand
    pupils: Array

    @cached_property
    def cosines(self) -> Array:
        """(n,) of the turns."""
        return np.asarray(1.0 / np.sqrt(1.0 + (self.turns**2).sum(axis=1)))

    @cached_property
    def rotations(self) -> Array:
        """(n, 3, 3) camera <- target."""
        across = -(self.axes @ self.turns[:, :, None])
        axis = np.concatenate([self.turns, np.ones((len(self.turns), 1))], axis=1) * self.cosines[:, None]
        return np.concatenate([np.concatenate([self.axes, across], axis=2), axis[:, None]], axis=1)

    @property
    def order(self) -> Array:
        """(n,) from -1/2, the first pose, to 1/2, the last: times would make each replay of a run another result."""
        n = len(self.turns)
        return np.linspace(-0.5, 0.5, n) if n > 1 else np.zeros(1)


@dataclass(frozen=True)
class Effect:
    """An effect; this one has no unknowns."""

    pose: PoseBasis
    bench: Circumstances

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the shared unknowns."""
        return ()

    def fill(self, columns: Array, poses: Turned) -> None:
        """Set what the K unknowns do to the bases of n poses in (n, B, K) zeros."""

    def priors(self) -> Sequence[RandomBlock]:
        """Return what is expected of unknowns that have amplitudes; statements are in `calib.joint.knowledge`."""
        return ()

    def own(self) -> Sequence[OwnPart]:
        """Return the parts that each pose has for itself."""
        return ()
