"""Result of the hand-eye check: what explains rotations and readings, as causes and in words.

It compares nothing itself (`calib.diagnosis.hand_eye`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from calib.arrays import Array, rms_length
from calib.diagnosis.gimbal_model import PairRatios
from calib.diagnosis.weighed_suspects import Found
from calib.model import cause as kinds
from calib.model.cause import LARGEST_EVIDENCE, Cause, cause_sentence, rounded
from calib.model.gimbal_readings import AXES
from calib.model.likelihood_ratio import ALONE, DECISIVE

#: Verdicts that are no cause.
AGREES, AMBIGUOUS, OFF_SCALE = "agrees", "ambiguous", "scale or parallax"
#: Views disagree if they differ this many times more than star noise explains.
_DISAGREE = 1.5
#: Nothing is so loose, or reads so badly, that it scatters by half a degree.
_LOOSEST_ARCSEC = 1800.0
#: What a gon reads instead of a degree, and to what share scales have to be that.
_GON, _SAME_UNIT = 0.9, 0.02


@dataclass(frozen=True)
class OtherReadings:
    """Other readings than stated, with which the rotations fit."""

    kind: str  # Of a cause
    axis: str = ""  # Names of axes, in words
    value: float | None = None  # By how many poses the readings are late


@dataclass(frozen=True)
class HandEyeCheck:
    """Result of the comparison of rotations and readings."""

    # True angle over reading, for each axis whose scale may be stated; suspects that were found are allowed for.
    scale: Mapping[str, float]
    scale_sigma: Mapping[str, float]  # 1-sigma of the scales
    stated_scale_sigma: float
    parallax_sigma: float  # 1-sigma of what parallax does to all scales
    pairs: PairRatios | None  # Ratios from the pairs of poses; None if no pair turned far enough
    ambiguous: bool  # Whether another optimum fits nearly as well
    # 1-sigma of the scatter, for each component of a rotation, that the stated uncertainties and the suspects do
    # not explain, arc seconds.
    excess_arcsec: float
    # 2 log of the odds that readings scatter, that rotations do, that errors are smooth, against none of it.
    scatters: Array
    # (n, 3) float64 rotation seen minus rotation read without suspects, as rotation vectors about the camera's
    # axes, arc seconds.
    residuals_arcsec: Array
    none_fits: bool  # Whether poses that are wrong each for itself explain the rotations far better
    found: tuple[Found, ...] = ()
    other: OtherReadings | None = None
    beside: tuple[str, ...] = ()  # Kinds of other readings that fit nearly as well
    names: Sequence[str] = ()  # Of the poses
    birge_ratio: float = 1.0

    @property
    def rms_arcsec(self) -> float:
        """Root mean square angle between rotations and readings, arc seconds."""
        return rms_length(self.residuals_arcsec)

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """What explains rotations and readings, the most probable first; none if they agree."""
        if self.none_fits or self.excess_arcsec > _LOOSEST_ARCSEC:
            return (Cause(kinds.NONE_FITS, DECISIVE, self.rms_arcsec / 3600.0, unit="degrees"),)
        causes = [*map(self._of, self.found), *self._scales(), *self._scatter()]
        if other := self.other:
            named = Cause(other.kind, LARGEST_EVIDENCE, other.value, axis=other.axis, beside=self.beside)
            causes.insert(0, named)
        return tuple(sorted(causes, key=lambda cause: -cause.evidence))

    @property
    def is_smooth(self) -> bool:
        """Whether smooth errors, as those of a collimator, are the most probable of all scatters."""
        return bool(self.scatters.argmax() == len(self.scatters) - 1)

    @property
    def verdict(self) -> str:
        """The kind of the first cause; or that readings and rotations agree, or why nothing can be said."""
        if self.causes:
            return self.causes[0].kind
        if self.ambiguous:
            return AMBIGUOUS
        if self.excess_arcsec > 0.0:
            return kinds.BIASED
        return OFF_SCALE if any(self._scale_evidence(axis) > DECISIVE for axis in self.scale) else AGREES

    @property
    def says(self) -> tuple[str, ...]:
        """The result in sentences."""
        return (
            *map(cause_sentence, self.causes),
            *filter(None, (_OF_VERDICT.get(self.verdict), self._ratios())),
        )

    def _of(self, found: Found) -> Cause:
        suspect, one = found.suspect, found.suspect.kind == kinds.ONE_POSE
        return Cause(
            suspect.kind,
            min(found.evidence, LARGEST_EVIDENCE),
            value=math.degrees(found.size_rad),
            expanded=math.degrees(2.0 * found.sigma_rad),
            unit="degrees",
            axis=_axis(AXES[suspect.axis]) if suspect.kind == kinds.SLIPPED else "",
            before=self._name(suspect.pose - 1) if suspect.pose and not one else "",
            pose=self._name(suspect.pose) if suspect.pose or one else "",
            beside=found.beside,
        )

    def _name(self, pose: int) -> str:
        return self.names[pose] if pose < len(self.names) else f"{pose + 1}"

    def _scale_evidence(self, axis: str, more: float = 0.0) -> float:
        """Return 2 log of the likelihood ratio of a scale against 1, if that has so much more 1-sigma.

        ((scale - 1) / sigma)^2, for a normal distribution.
        """
        sigma = math.hypot(self.scale_sigma[axis], self.stated_scale_sigma, more)
        return ((self.scale[axis] - 1.0) / sigma) ** 2

    def _scales(self) -> Iterator[Cause]:
        """Yield the axes whose scale no parallax imitates; one for all that have the same."""
        values = list(self.scale.values())
        spread = math.hypot(*self.scale_sigma.values(), self.stated_scale_sigma)
        alike = len(values) > 1 and (max(values) - min(values)) ** 2 < DECISIVE * spread**2
        for axis, value in list(self.scale.items())[: 1 if alike else None]:
            evidence = self._scale_evidence(axis, self.parallax_sigma)
            if evidence > DECISIVE + 2.0 * math.log(len(values)):
                small = abs(value - 1.0) < _SMALL
                beside = {
                    kinds.UNITS: alike and min(abs(value / _GON - 1.0), abs(value * _GON - 1.0)) < _SAME_UNIT,
                    kinds.PARALLAX: alike and small,
                    kinds.SAGS: axis == "tilt_deg" and small,
                }
                yield Cause(
                    kinds.AXIS_SCALE,
                    min(evidence, LARGEST_EVIDENCE),
                    value=value,
                    expanded=2.0 * self.scale_sigma[axis],
                    axis=_axis(axis),
                    beside=tuple(kind for kind, likely in beside.items() if likely),
                )

    def _scatter(self) -> Iterator[Cause]:
        """Yield that readings or rotations scatter; nothing if the views disagree also without the readings."""
        if self.excess_arcsec <= 0.0 or self.birge_ratio > _DISAGREE:
            return
        named = kinds.SCATTERED, kinds.LOOSE, kinds.BIASED
        evidence = dict(zip(named, self.scatters.tolist(), strict=True))
        likely = [name for name in evidence if evidence[name] > max(evidence.values()) - ALONE]
        kind, *beside = sorted(likely, key=lambda name: (name == kinds.BIASED, -evidence[name]))
        if kind != kinds.BIASED:
            worth = min(evidence[kind], LARGEST_EVIDENCE)
            yield Cause(kind, worth, self.excess_arcsec / 3600.0, unit="degrees", beside=tuple(beside))

    def _ratios(self) -> str:
        """Return what each axis and the pairs of poses show, in words."""
        axes = [
            "{} {} ± {}".format(_axis(axis), *rounded(value, 2.0 * self.scale_sigma[axis]))
            for axis, value in self.scale.items()
        ]
        ratios = f"Angle seen over angle read: {', '.join(axes)} (k = 2)." if axes else ""
        if self.pairs is None:
            return f"{ratios} No pair of poses turned far enough for a ratio.".strip()
        value, _ = rounded(self.pairs.ratio, max(self.pairs.spread, 1e-5))
        return f"{ratios} Median of the pairs of poses, {self.pairs.count}: {value}.".strip()


#: A camera that sags turns by this share of the tilt at most, and parallax changes all scales by no more.
_SMALL = 0.05
_OF_VERDICT = {
    AMBIGUOUS: "Different mountings of the camera explain the rotations equally well, so no scale is stated. Add poses "
    "that turn the camera about another axis.",
    OFF_SCALE: "The ratio differs from 1: the gimbal has a scale error, the focal length is wrong, or there is "
    "parallax: the entrance pupil is off the pivot and the collimator out of focus. Below about 1 % nothing tells them "
    "apart.",
    kinds.BIASED: "Rotations and readings differ by more than their uncertainties explain. Errors of the collimator or "
    "of the lens model, which bias the views, do so too. So this does not show an error of the gimbal.",
}


def _axis(name: str) -> str:
    """Return the name of an axis without its unit."""
    return name.removesuffix("_deg")
