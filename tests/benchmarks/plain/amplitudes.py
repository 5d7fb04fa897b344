"""The sizes of all families of errors: what is expected of them before the views are seen.

An amplitude is the 1-sigma of a family of unknowns: of the stars' noise over its stated value, of a field's
coefficients of one degree in units of r. Its logarithm is Gaussian. Amplitudes of one family are alike, so their
logarithms are correlated: a level that all share, and a smaller scatter about it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.arrays import Array, Ints
from calib.model.gimbal_readings import ENCODER_SHARE

from .fields import DEGREE

STAR, READING, ENCODER = "star noise", "readings", "readings of neighbouring angles"
POSE = tuple(f"pose field, degree {d}" for d in range(1, 5))
COMMON = tuple(f"common field, degree {d}" for d in range(1, DEGREE + 1))
TURN = tuple(f"field by turn, degree {d}" for d in range(1, 6))
TURN_2 = tuple(f"field by turn squared, degree {d}" for d in range(5))
RADIAL, SHIFTED, CURVATURE_TURN = "radial", "shifted axis", "field curvature by turn"
SCALE_TURN_2, CURVATURE_ASIDE = "scale by turn squared", "field curvature beside the axes"
PARALLAX, ASIDE = "parallax", "pupil beside the axes"
RIM, DISCS, ALONG = "rim", "discs", "pupil along the axis"
CHANGE = "irregular errors since the passport"
DISTORTION, TANGENTIAL, PRISM = "lens distortion", "tangential", "prism"

#: A turn, as the sine of its angle, at which the fields by turn have their amplitude.
UNIT_TURN = 0.1
#: How far a pupil is expected to move across the beam per unit turn, as a share of r.
LEVER = 0.03
#: Errors of published collimators, in shares of the focal length: medians of eight designs with the tolerances of a
#: workshop. Distortion |h|^2 h; field curvature |h|^2 s for a pupil aside by s.
_DISTORTION, _CURVATURE = 0.12, 0.33
#: How far a turn of `UNIT_TURN` moves the pupil. A camera that was set up by eye is beside the axis by 2 mm, known to a
#: factor of 2.7, before a collimator of 250 mm.
_MOVED, _BESIDE = LEVER * UNIT_TURN, 0.008
#: From degree to degree, fields of drawn and real collimators fall by 0.5 to 0.8.
_FALL = 0.65
#: The power of the pupil's movement with which errors of glass grow that its place makes, beyond `LEVER`.
_BY_PUPIL = {
    **dict.fromkeys((CURVATURE_TURN, *TURN), 1.0),
    **dict.fromkeys((SCALE_TURN_2, *TURN_2), 2.0),
}
#: Amplitudes are searched within this number of 1-sigma.
REACH = 3.0
#: No field is larger: 1 px at 3345 px.
_LARGEST_FIELD = 3e-4
#: That of a pupil 50 mm before the pivot, in a collimator of 250 mm that is out of focus by an eighth.
_LARGEST_PARALLAX = 0.03
#: Readings may be those of other poses: degrees beside what they say. Sigmas of stars may be in another unit.
_NOISIEST = {READING: 1e6, STAR: 1e4}
_FIELDS = (*POSE, *COMMON, *TURN, *TURN_2)
_NOISES = (STAR, READING, ENCODER, DISCS)


class Family(NamedTuple):
    """Amplitudes that are alike: a level that all share, a slope over their numbers, and a scatter about these."""

    names: tuple[str, ...]
    medians: tuple[float, ...]
    level: float  # 1-sigma of the logarithm of their common level
    scatter: float = 0.0  # 1-sigma of each logarithm about level and slope
    slope: float = 0.0  # 1-sigma of how much the logarithm changes from one to the next
    glass: float = 0.0  # 1-sigma of the level shared with the other families of the collimator's glass

    def first(self, kept: Collection[str]) -> Family:
        """Return the family of those amplitudes that a bench has."""
        pairs = [pair for pair in zip(self.names, self.medians, strict=True) if pair[0] in kept]
        return self._replace(names=tuple(n for n, _ in pairs), medians=tuple(m for _, m in pairs))

    @property
    def covariance(self) -> Array:
        """(N, N) covariance of the logarithms within the family."""
        size = len(self.names)
        steps = self.slope * (np.arange(size) - 0.5 * (size - 1))
        shared = self.level**2 + self.glass**2 + np.outer(steps, steps)
        return np.asarray(shared + self.scatter**2 * np.eye(size))


def falling(first: float, count: int) -> tuple[float, ...]:
    """Return medians that fall from degree to degree, as those of smooth fields do."""
    return tuple(first * _FALL**k for k in range(count))


#: Fields in units of r (at 3345 px, 1e-6 is .0033 px). The medians are those of good collimators and gimbals; widths
#: leave a factor of 20 to 50 to both sides (2 sigma). docs/adjustment.md says where each comes from.
FAMILIES = (
    Family((STAR,), (1.0,), 1.5),
    Family((READING,), (1.0,), 0.4),
    Family((ENCODER,), (ENCODER_SHARE,), 0.7),
    Family(POSE, falling(2e-6, len(POSE)), 1.3, 0.5, 0.25),
    Family(COMMON, falling(12e-6, len(COMMON)), 1.0, 0.5, 0.25, 0.9),
    Family(TURN, falling(3e-6, len(TURN)), 1.0, 0.5, 0.25, 0.9),
    Family(TURN_2, falling(1e-6, len(TURN_2)), 1.0, 0.5, 0.0, 0.9),
    Family(
        (RADIAL, SHIFTED, CURVATURE_TURN, SCALE_TURN_2),
        (_DISTORTION, 1e-3, _CURVATURE * _MOVED, 4e-6),
        1.3,
        0.5,
    ),
    # Of its own: a pupil that is not beside the axis says nothing of the glass.
    Family((CURVATURE_ASIDE,), (_CURVATURE * _BESIDE,), 1.2),
    # A defocus of 0.06, times how far a pupil moves: a well corrected collimator can be out of focus, too.
    Family((PARALLAX, ASIDE), (0.06, 3e-4), 0.8, 0.5),
    Family((DISTORTION,), (0.015,), 1.5),  # Share of the distance from the axis, at the sensor's corner
    Family((TANGENTIAL,), (4e-4,), 0.6),
    Family((PRISM,), (2e-4,), 1.0),
    Family((RIM,), (2e-3,), 1.3),
    Family((DISCS,), (1.0,), 0.3),  # Errors of the visible discs over those that their fit states
    # Change of the radius from pose to pose, as a share: a hand moves the pupil along the beam by 2.5 mm before a
    # collimator with a defocus of a sixteenth.
    Family((ALONG,), (6e-4,), 1.0),
    # Another pupil looks through other places of the glass; another glass differs ten times as much.
    Family((CHANGE,), (3e-6,), 1.3),
)


class Lever(NamedTuple):
    """How far a pupil moves across the beam per unit turn, as a share of r."""

    middle: float = LEVER
    spread: float = 1.0  # 1-sigma of its logarithm; beforehand a pupil is 3 to 20 mm before the pivot

    @property
    def far(self) -> float:
        """How many times as far as expected the pupil moves, at least 1."""
        return max(self.middle / LEVER, 1.0)


@dataclass(frozen=True)
class Expected:
    """The Gaussian of the logarithms of the A amplitudes that a bench has."""

    names: tuple[str, ...]
    mean: Array  # (A,)
    covariance: Array  # (A, A)

    @cached_property
    def information(self) -> Array:
        """(A, A) inverse covariance."""
        return np.asarray(np.linalg.inv(self.covariance))

    @cached_property
    def sigma(self) -> Array:
        """(A,) 1-sigmas."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """(A,) smallest and (A,) largest logarithms in the search."""
        low, high = self.mean - REACH * self.sigma, self.mean + REACH * self.sigma
        fields = self.places(_FIELDS)
        high[fields] = np.minimum(high[fields], np.log(_LARGEST_FIELD))
        high[self.places((PARALLAX,))] = np.log(_LARGEST_PARALLAX)
        for name, largest in _NOISIEST.items():
            high[self.places((name,))] = np.log(largest)
        return low, high

    @cached_property
    def stiff(self) -> Array:
        """(A,) with which a search begins: errors smaller than expected by 1-sigma, noises as expected.

        Large errors would explain what is an error of the start.
        """
        begin = self.mean - self.sigma
        noises = self.places(_NOISES)
        begin[noises] = self.mean[noises]
        return np.asarray(begin)

    @cached_property
    def bundle(self) -> Array:
        """(A,) with which a start is brought near: few errors but those of the lens and radial ones of the glass.

        Without these the centre goes aside, and places of a pupil that a hand moves with it.
        """
        begin = self.mean - REACH * self.sigma
        free = self.places((*_NOISES, DISTORTION, TANGENTIAL))
        begin[free] = self.mean[free]
        radial = self.places((RADIAL,))
        begin[radial] = self.mean[radial] + self.sigma[radial]
        return np.asarray(begin)

    def at(self, name: str) -> int:
        """Return the place of an amplitude."""
        return self.names.index(name)

    def places(self, names: Sequence[str]) -> Ints:
        """Return the places of those of the amplitudes that the bench has."""
        return np.array([k for k, name in enumerate(self.names) if name in names], np.int64)


def expected(kept: Collection[str], lever: Lever, far: float = 1.0) -> Expected:
    """Return what is expected of the amplitudes that a bench has; ``far``: how many times as far its pupil moves."""
    families = [family.first(kept) for family in FAMILIES]
    names = tuple(name for family in families for name in family.names)
    mean = np.log([median for family in families for median in family.medians])
    glass = np.array([family.glass for family in families for _ in family.names])
    covariance, begin = np.outer(glass, glass), 0
    for family in families:
        own = slice(begin, begin := begin + len(family.names))
        covariance[own, own] = family.covariance
    mean += np.log(far) * np.array([_BY_PUPIL.get(name, 0.0) for name in names])
    if PARALLAX in names:
        at = names.index(PARALLAX)
        mean[at] += np.log(lever.middle)
        covariance[at, at] += lever.spread**2
    return Expected(names, mean, covariance)
