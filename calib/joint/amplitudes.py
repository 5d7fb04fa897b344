"""The amplitudes of the joint adjustment, and what is expected of them before the views are seen.

An amplitude is the standard deviation of a family of unknowns: of the stars' noise over its stated value, of a field's
coefficients of one degree, in units of r. Its logarithm is Gaussian. Amplitudes of one family are alike, so their
logarithms are correlated: a level that all share, and a smaller scatter about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array
from calib.joint.fields import DEGREE
from calib.model.gimbal_readings import ENCODER_SHARE

#: Highest degree of the field of a pose.
POSE_DEGREE = 4
STAR, READING, ENCODER = "star noise", "readings", "readings of neighbouring angles"
POSE = tuple(f"pose field, degree {d}" for d in range(1, POSE_DEGREE + 1))
COMMON = tuple(f"common field, degree {d}" for d in range(1, DEGREE + 1))
TURN = tuple(f"field by turn, degree {d}" for d in range(1, 6))
TURN_2 = tuple(f"field by turn squared, degree {d}" for d in range(5))
RADIAL, SHIFTED, CURVATURE_TURN = "radial", "shifted axis", "field curvature by turn"
SCALE_TURN_2, CURVATURE_ASIDE = "scale by turn squared", "field curvature beside the axes"
ANAMORPHIC = "anamorphic"
PARALLAX, RIM, DISCS, ALONG = "parallax", "rim", "discs", "pupil along the axis"
ASIDE = "pupil beside the axes"
CHANGE = "irregular errors since the passport"
DISTORTION, TANGENTIAL, PRISM = "lens distortion", "tangential", "prism"
#: A turn, as the tangent of its angle, at which the fields by turn have their amplitude.
UNIT_TURN = 0.1
#: How far a pupil is expected to move across the beam per unit turn, as a share of r.
LEVER = 0.03
#: The power of that movement with which the errors of glass grow that the pupil's place makes. The medians hold up to
#: `LEVER`, and for a hand, whose places are counted in such units that one prior serves both (`calib.joint.pupils`).
_BY_PUPIL = {
    **dict.fromkeys((CURVATURE_TURN, *TURN), 1.0),
    **dict.fromkeys((SCALE_TURN_2, *TURN_2), 2.0),
}

#: Errors of published collimators, in shares of the focal length: medians of eight designs with the tolerances of a
#: workshop (doublet, Ploessl, Erfle eyepiece, Tessar, Petzval lens, triplet, two mirrors). Distortion |h|^2 h; field
#: curvature |h|^2 s for a pupil aside by s. Of two more, the medians here are those of drawn collimators, 1.5 to 1.8
#: times as large: |h|^2 e of glass off its axis, .7e-3, and coma |s|^2 h, .24.
_DISTORTION, _CURVATURE = 0.12, 0.33
#: How far a turn of `UNIT_TURN` moves the pupil. A camera that was set up by eye is beside the axis by 2 mm, known to a
#: factor of 2.7, before a collimator of 250 mm.
_MOVED, _BESIDE = LEVER * UNIT_TURN, 0.008
#: From degree to degree, fields of drawn and real collimators fall by 0.5 to 0.8.
_FALL = 0.65

#: Amplitudes are searched within this number of 1-sigma of the hyperprior.
_REACH = 3.0
#: No field is larger: 1 px at 3345 px.
_LARGEST_FIELD = 3e-4
#: That of a pupil 50 mm before the pivot, in a collimator of 250 mm that is out of focus by an eighth.
_LARGEST_PARALLAX = 0.03
#: Readings may be those of other poses: degrees beside what they say. Sigmas of stars may be in another unit.
_NOISIEST_READINGS, _NOISIEST_STARS = 1e6, 1e4
#: No star is taken as found better than this, px: a tenth of what the best recordings show. Stars that are more exact
#: than the shapes of the fields are (points without noise) would deny what is stated: U(fx) was 33 px in place of 1.3.
FINEST_PX = 1e-3


class Pupil(Enum):
    """How the camera's pupil is moved through the beam."""

    HELD = "the parallax is bounded, or no disc is visible: the pupil stays where it is"
    WALKS = "visible discs count, and the pupil follows the turn"
    BY_HAND = "visible discs count, and the pupil wanders: they show where it is"


#: Highest degrees of the fields by turn and by turn squared. A pupil that is moved through the beam by 10 mm sees all
#: that the glass has: with 4 where discs count, 25 poses of a mount moved by hand were 3.6 U wrong. They are the same
#: for a gimbal and a hand: else their odds would be those of the degrees. If places of the pupil are unknown, fields of
#: higher degrees predict poses that are left out worse (published recordings: .18 px with 7, .16 with 5).
TURN_DEGREES = {Pupil.HELD: (4, 3), Pupil.WALKS: (5, 4), Pupil.BY_HAND: (5, 4)}


@dataclass(frozen=True)
class Family:
    """Amplitudes that are alike: a level that all share, a slope over their numbers, and a scatter about these."""

    names: tuple[str, ...]
    medians: tuple[float, ...]
    level: float  # 1-sigma of the logarithm of their common level
    scatter: float  # 1-sigma of each logarithm about level and slope
    slope: float = 0.0  # 1-sigma of how much the logarithm changes from one to the next
    # 1-sigma of the level that it shares with the other families of the collimator's glass
    glass: float = 0.0

    def first(self, count: int) -> Family:
        """Return the family of the first amplitudes alone."""
        return replace(self, names=self.names[:count], medians=self.medians[:count])

    @property
    def covariance(self) -> Array:
        """(N, N) covariance of the logarithms within the family."""
        size = len(self.names)
        steps = self.slope * (np.arange(size) - 0.5 * (size - 1))
        shared = self.level**2 + self.glass**2 + np.outer(steps, steps)
        return np.asarray(shared + self.scatter**2 * np.eye(size))


def smooth(first: float, count: int) -> tuple[float, ...]:
    """Return medians that fall from degree to degree, as those of smooth fields do."""
    return tuple(first * _FALL**k for k in range(count))


#: Fields in units of r (at 3345 px, 1e-6 is .0033 px); stars and readings relative to what is stated. The medians are
#: those of good collimators and gimbals; the widths leave a factor of 20 to 50 to both sides (2 sigma).
FAMILIES = (
    Family((STAR,), (1.0,), 1.5, 0.0),
    Family((READING,), (1.0,), 0.4, 0.0),
    Family((ENCODER,), (ENCODER_SHARE,), 0.7, 0.0),
    Family(POSE, smooth(2e-6, POSE_DEGREE), 1.3, 0.5, 0.25),
    Family(COMMON, smooth(12e-6, DEGREE), 1.0, 0.5, 0.25, 0.9),
    Family(TURN, smooth(3e-6, len(TURN)), 1.0, 0.5, 0.25, 0.9),
    Family(TURN_2, smooth(1e-6, len(TURN_2)), 1.0, 0.5, 0.0, 0.9),
    Family(
        (RADIAL, SHIFTED, CURVATURE_TURN, SCALE_TURN_2),
        (_DISTORTION, 1e-3, _CURVATURE * _MOVED, 4e-6),
        1.3,
        0.5,
    ),
    # Of its own: a pupil that is not beside the axis says nothing of the glass.
    Family((CURVATURE_ASIDE,), (_CURVATURE * _BESIDE,), 1.2, 0.0),
    # Of its own: only glass that is not round about its axis shows two scales; an off-axis mirror has 1e-3.
    Family((ANAMORPHIC,), (1e-4,), 1.4, 0.0),
    # A defocus of 0.06, times how far a pupil moves: a well corrected collimator can be out of focus, too.
    Family((PARALLAX, ASIDE), (0.06, 3e-4), 0.8, 0.5),
    Family((DISTORTION,), (0.015,), 1.5, 0.0),  # Share of the distance from the axis, at the sensor's corner
    Family((TANGENTIAL,), (4e-4,), 0.6, 0.0),
    Family((PRISM,), (2e-4,), 1.0, 0.0),
    Family((RIM,), (2e-3,), 1.3, 0.0),
    Family((DISCS,), (1.0,), 0.3, 0.0),  # Errors of the visible discs over those that their fit states
    # Change of the radius from pose to pose, as a share: a hand moves the pupil along the beam by 2.5 mm before a
    # collimator with a defocus of a sixteenth.
    Family((ALONG,), (6e-4,), 1.0, 0.0),
    # Another pupil looks through other places of the glass; another glass differs ten times as much.
    Family((CHANGE,), (3e-6,), 1.3, 0.0),
)


class Lever(NamedTuple):
    """How far a pupil moves across the beam per unit turn, as a share of r."""

    middle: float
    spread: float  # 1-sigma of its logarithm


def times_as_far(lever: Lever, pupil: Pupil) -> float:
    """Return how many times `LEVER` the pupil of a gimbal moves, at least 1."""
    return 1.0 if pupil is Pupil.BY_HAND else max(lever.middle / LEVER, 1.0)


@dataclass(frozen=True)
class Hyperprior:
    """Gaussian of the logarithms of the amplitudes."""

    names: tuple[str, ...]
    mean: Array  # (A,)
    covariance: Array  # (A, A)
    lever: Lever
    star_px: float  # Usual stated noise of a star

    @cached_property
    def stiff(self) -> Array:
        """(A,) logarithms that a search begins with: errors that are smaller than expected, by 1-sigma.

        They grow where the stars ask for it. A search that begins with large ones ends where they have explained what
        is an error of camera or centre.
        """
        begin = self.mean - np.sqrt(np.diag(self.covariance))
        noise = [at for at, name in enumerate(self.names) if name in (STAR, READING, ENCODER, DISCS)]
        begin[noise] = self.mean[noise]
        return np.asarray(begin)

    @cached_property
    def information(self) -> Array:
        """(A, A) inverse covariance."""
        return np.asarray(np.linalg.inv(self.covariance))

    @cached_property
    def bounds(self) -> list[tuple[float, float]]:
        """Smallest and largest logarithm of each amplitude in the search."""
        reach = _REACH * np.sqrt(np.diag(self.covariance))
        low, high = self.mean - reach, self.mean + reach
        fields = [at for at, name in enumerate(self.names) if name in (*POSE, *COMMON, *TURN, *TURN_2)]
        high[fields] = np.minimum(high[fields], np.log(_LARGEST_FIELD))
        high[self.at(PARALLAX)] = np.log(_LARGEST_PARALLAX)
        high[self.at(READING)], high[self.at(STAR)] = np.log([_NOISIEST_READINGS, _NOISIEST_STARS])
        finest = min(FINEST_PX / self.star_px, 1.0)  # Stars that are stated as finer are believed
        low[self.at(STAR)] = max(low[self.at(STAR)], np.log(finest))
        return list(zip(low.tolist(), high.tolist(), strict=True))

    def at(self, name: str) -> int:
        """Return the place of an amplitude."""
        return self.names.index(name)

    def places(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Return the places of amplitudes."""
        return np.array([self.names.index(name) for name in names], np.int64)


def _families(pupil: Pupil, *, passport: bool) -> list[Family]:
    """Return the families of the amplitudes that there are."""
    degree, degree_2 = TURN_DEGREES[pupil]
    counts = {TURN: degree, TURN_2: degree_2 + 1}
    counts |= {(DISCS,): int(pupil is not Pupil.HELD), (ALONG,): int(pupil is Pupil.BY_HAND)}
    counts[CHANGE,] = int(passport)
    return [family.first(counts.get(family.names, len(family.names))) for family in FAMILIES]


def hyperprior(lever: Lever, pupil: Pupil, *, passport: bool = False, star_px: float = 1.0) -> Hyperprior:
    """Return the hyperprior.

    ``passport``: whether a passport states the irregular errors of the glass. ``star_px``: usual stated star noise.
    """
    families = _families(pupil, passport=passport)
    names = tuple(name for family in families for name in family.names)
    mean = np.log([median for family in families for median in family.medians])
    glass = np.array([family.glass for family in families for _ in family.names])
    covariance = np.outer(glass, glass)
    begin = 0
    for family in families:
        own = slice(begin, begin + len(family.names))
        covariance[own, own] = family.covariance
        begin = own.stop
    parallax = names.index(PARALLAX)
    mean[parallax] += np.log(lever.middle)
    covariance[parallax, parallax] += lever.spread**2
    mean += np.log(times_as_far(lever, pupil)) * np.array([_BY_PUPIL.get(name, 0.0) for name in names])
    return Hyperprior(names, mean, covariance, lever, star_px)
