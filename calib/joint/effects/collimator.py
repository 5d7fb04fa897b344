"""The collimator and the print as all poses see them, what a passport states of them, and what differs by pose."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.effects.effect import Effect, OwnPart, Places, RandomBlock, Row, Turned
from calib.joint.fields import DEGREE, DEGREES, both, of_degree
from calib.model import result_parts as rows

CENTRE = ("x", "y", "r")
#: Begin of the names of the coefficients of the common field.
FIELD = "common_"
#: Their places in a field: all but those of degree 0, a shift.
COMMON_PLACES = both(DEGREES > 0)
RADIAL = ("radial", "radial_4")
#: radial_4 is typically so many times radial.
RADIAL_RATIO = 20.0
#: Typical sizes of what radial terms become about a shifted axis (`FieldBasis.shifted`).
SHIFTED_SIZES = (1.0, 1.0, RADIAL_RATIO, RADIAL_RATIO)
#: (2, 2, 2) one scale along X and the other along Y, and the same between the axes.
_TWO_SCALES = np.array([[[1.0, 0.0], [0.0, -1.0]], [[0.0, 1.0], [1.0, 0.0]]])
#: Change of scale that comes with radial errors, as a share of what they do at the edge of the field.
_RADIAL_SCALE = 0.06
#: What an unknown of the collimator has become since its passport, less what that states.
CHANGE = "change of {}"
#: The coefficients of a pose's own field, and their degrees.
POSE_PLACES = both((DEGREES > 0) & (amp.POSE_DEGREE >= DEGREES))
_POSE_DEGREES = np.tile(DEGREES, 2)[POSE_PLACES]
_ROW = Row(rows.COMMON_FIELD, "A", "residuals that all poses share")
POSE_ROW = Row(rows.POSE_FIELDS, "A", "residuals that differ from pose to pose")


class Centre(Effect):
    """Foot and length of the perpendicular from the centre to the target."""

    names = CENTRE

    def fill(self, columns: Array, poses: Turned) -> None:
        columns[:, self.pose.shifts, (0, 1)] = -1.0 / self.pose.fields.reference[2]
        columns[:, self.pose.radius, 2] = 1.0


class Radial(Effect):
    """Distortion of the collimator, and a bow of the print that nobody states."""

    names = RADIAL

    def fill(self, columns: Array, poses: Turned) -> None:
        columns[:, self.pose.field] = self.pose.fields.radial

    def priors(self) -> Sequence[RandomBlock]:
        if set(self.bench.passport) & set(RADIAL):
            return ()
        return [RandomBlock(_ROW, RADIAL, ((amp.RADIAL, np.diag([1.0, RADIAL_RATIO])),))]


class CommonField(Effect):
    """Irregular errors that all poses share."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{FIELD}{k}" for k in COMMON_PLACES)

    def fill(self, columns: Array, poses: Turned) -> None:
        columns[:, self.pose.field.start + COMMON_PLACES, range(len(COMMON_PLACES))] = 1.0

    def priors(self) -> Sequence[RandomBlock]:
        """Return a random field of each degree, radial terms about a shifted axis, two scales; none beside a passport.

        Radial errors that are no polynomials of the third and fifth order leave a change of scale. Glass that is not
        round about its axis enlarges one direction more than the other, as oblong pixels do.
        """
        if _stated_fields(self.bench.passport):
            return ()
        degrees, basis = np.tile(DEGREES, 2)[COMMON_PLACES], self.pose.fields
        parts = [(name, of_degree(degrees, d)) for d, name in enumerate(amp.COMMON, start=1)]
        edge = (basis.radius_mm / basis.reference[2]) ** 2
        scale = _RADIAL_SCALE * edge * basis.shape(np.asarray)[COMMON_PLACES, None]
        parts += [(amp.SHIFTED, basis.about_shifted_axis(SHIFTED_SIZES)[COMMON_PLACES]), (amp.RADIAL, scale)]
        two = [basis.shape(partial(_mapped, turned))[COMMON_PLACES] for turned in _TWO_SCALES]
        parts.append((amp.ANAMORPHIC, np.column_stack(two)))
        waves = self.bench.wavefront**2 / (DEGREE * (degrees + 1.0))
        return [RandomBlock(_ROW, self.names, tuple(parts), waves)]


class PrintTerms(Effect):
    """Errors of the print and of the radius that a station states, a column each."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.bench.terms)

    def fill(self, columns: Array, poses: Turned) -> None:
        for k, shape in enumerate(self.bench.terms.values()):
            columns[:, self.pose.field, k] = shape


class Changes(Effect):
    """What has changed since a passport: unknowns that a statement joins to those of the collimator."""

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(CHANGE.format(name) for name in self.bench.passport)

    def priors(self) -> Sequence[RandomBlock]:
        """Return what the common field differs from that of the passport, with one amplitude."""
        names = _stated_fields(self.bench.passport)
        if not names:
            return ()
        degrees = np.tile(DEGREES, 2)[COMMON_PLACES]
        sizes = np.array(amp.smooth(1.0, DEGREE))[degrees - 1] / np.sqrt(degrees + 1.0)
        changes = tuple(CHANGE.format(name) for name in names)
        return [RandomBlock(Row(rows.PASSPORT, "B"), changes, ((amp.CHANGE, np.diag(sizes)),))]


class PoseFields(Effect):
    """What differs from pose to pose: drift, wavefront, mounts that are moved by hand."""

    def own(self) -> Sequence[OwnPart]:
        amplitudes = tuple(amp.POSE[degree - 1] for degree in _POSE_DEGREES)
        places: Places = self.pose.field.start + POSE_PLACES
        return [OwnPart(POSE_ROW, places, amplitudes, 1.0 + _POSE_DEGREES)]


def _mapped(scales: Array, h: Array) -> Array:
    """Return (N, 2) the places h, mapped by a symmetric (2, 2) matrix."""
    return np.asarray(h @ scales)


def _stated_fields(passport: Sequence[str]) -> list[str]:
    """Return the names of the coefficients of the common field that a passport states."""
    return [name for name in passport if name.startswith(FIELD)]
