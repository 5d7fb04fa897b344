"""Result of the hand-eye check, and its verdict in words: whose error it is, how large, and where.

It compares nothing itself (`calib.diagnosis.hand_eye`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from calib.arrays import Array, rms_length
from calib.diagnosis.gimbal_faults import GimbalFault
from calib.diagnosis.gimbal_model import FaultKind, PairRatios
from calib.model.cause import AXES_EXCHANGED, one_of
from calib.model.gimbal_readings import AXES
from calib.model.likelihood_ratio import DECISIVE

VerdictKind = Literal[
    "agrees",
    "slip",
    "camera_turned",
    "wrong_pose",
    "not_square",
    "wrong_sign",
    "ambiguous",
    "scale_or_parallax",
    "gimbal_scale",
    "views_biased",
    "scatter",
]

_KINDS: Mapping[FaultKind, VerdictKind] = {
    "slip": "slip",
    "mount": "camera_turned",
    "pose": "wrong_pose",
    "squareness": "not_square",
}
#: Parallax before a real collimator imitates a scale up to about this size.
PARALLAX = 0.015
#: Views disagree if they differ this many times more than star noise explains.
_DISAGREE = 1.5

_WRONG_SIGN = (
    "The sign of {} is reversed: as they are, the readings fit no mounting in which the camera looks forward. Check "
    "the signs of the axes in the station file.{}"
)
_AMBIGUOUS = (
    "Different mountings of the camera explain the rotations equally well, so no scale is stated. Add poses that turn "
    "the camera about another axis."
)


@dataclass(frozen=True)
class Verdict:
    """Result of the check in one name, and in plain sentences."""

    # ``agrees``: readings and rotations agree. ``slip``, ``camera_turned``, ``wrong_pose``, ``not_square``: a fault
    # was found.
    # ``wrong_sign``: the sign of one axis is reversed. ``ambiguous``: different mountings explain the data
    # equally well. ``scale_or_parallax``: a scale that parallax can imitate. ``gimbal_scale``: a scale error of
    # the gimbal. ``views_biased``: the views contradict each other, so that scatter, or ratios that differ by axis,
    # show no error of the gimbal. ``scatter``: scatter of unknown cause.
    kind: VerdictKind
    says: tuple[str, ...]


@dataclass(frozen=True)
class HandEyeCheck:
    """Result of the comparison of rotations and readings."""

    # True angle over reading, for each axis whose scale may be stated; faults that were found are allowed for.
    scale: Mapping[str, float]
    scale_sigma: Mapping[str, float]  # 1-sigma of the scales
    # (a,) 1-sigma of each scale's difference from 1: what is stated of it, and the scatter of the rotations alone,
    # without errors that all rotations share.
    own_sigma: Array
    difference_sigma: float  # The same of the largest difference between the scales of two axes
    pairs: PairRatios | None  # Ratios from the pairs of poses; None if no pair turned far enough
    ambiguous: bool  # Whether another optimum fits nearly as well
    # The axes of which the sign of one is reversed, each in words; empty if the signs are right.
    reversed_axes: tuple[str, ...]
    # 1-sigma of the scatter, for each component of a rotation, that the stated uncertainties and the faults do
    # not explain, arc seconds.
    excess_arcsec: float
    degrees_of_freedom: int
    # (n, 3) float64 rotation seen minus rotation read without faults, as rotation vectors about the camera's
    # axes, arc seconds.
    residuals_arcsec: Array
    names: Sequence[str] = ()  # Of the poses
    faults: tuple[GimbalFault, ...] = ()
    # Expanded uncertainty U of the focal length as a share of it; None if unknown.
    focal_uncertainty: float | None = None
    birge_ratio: float = 1.0

    @property
    def views_disagree(self) -> bool:
        """Whether the views of the calibration contradict each other, without any reading."""
        return self.birge_ratio > _DISAGREE

    @property
    def rms_arcsec(self) -> float:
        """Root mean square angle between rotations and readings, arc seconds."""
        return rms_length(self.residuals_arcsec)

    @cached_property
    def verdict(self) -> Verdict:
        """Whose error it is."""
        return _judged(self)


def _judged(check: HandEyeCheck) -> Verdict:
    """Return the verdict: faults come first, then reasons not to claim a scale, then the scale, then scatter."""
    judged = [_fault(check, fault) for fault in check.faults]
    if check.reversed_axes:
        axes, also = one_of(check.reversed_axes), AXES_EXCHANGED if len(check.reversed_axes) > 1 else ""
        judged.append(("wrong_sign", _WRONG_SIGN.format(axes, also)))
    if check.ambiguous:
        judged.append(("ambiguous", _AMBIGUOUS))
    judged += filter(None, (_scale(check), _scatter(check)))
    kinds = sorted((kind for kind, _ in judged), key=lambda kind: kind == "agrees")
    first = [kind for name in _KINDS.values() for kind in kinds if kind == name]
    return Verdict((first or kinds or ["agrees"])[0], tuple(sentence for _, sentence in judged))


def angle(degrees: float) -> str:
    """Print an angle without its sign: degrees from 0.1 degrees on, arc seconds below."""
    size = abs(degrees)
    return f"{size:#.2g} degrees" if size >= 0.1 else f"{_plain(3600 * size)} arc seconds"


def angle_and_uncertainty(degrees: float, sigma_deg: float) -> str:
    """Print an angle without its sign, and its expanded uncertainty (from 1-sigma), in the unit that `angle` takes."""
    factor, unit = (1.0, "degrees") if abs(degrees) >= 0.1 else (3600.0, "arc seconds")
    expanded = 2 * factor * sigma_deg
    decimals = _decimals(expanded)
    return f"{abs(factor * degrees):.{decimals}f} ± {expanded:.{decimals}f} {unit} (k = 2)"


def _decimals(uncertainty: float) -> int:
    """Return the decimals that show two significant digits of an uncertainty."""
    return int(np.clip(1 - np.floor(np.log10(max(uncertainty, 1e-7))), 0, 7))


def _plain(value: float) -> str:
    """Return a number with three significant digits and without exponent."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}" if value >= 1e-4 else "0"


def _percent(share: float) -> str:
    """Return a share as percent, with two significant digits."""
    percent = 100 * abs(share)
    return f"{percent:.2g} %" if percent >= 1e-3 else "less than 0.001 %"


def _ratio(value: float, uncertainty: float) -> str:
    """Return a ratio with as many decimals as its uncertainty has, at least two."""
    return f"{value:.{max(_decimals(uncertainty), 2)}f}"


def _name(axis: str) -> str:
    """Return the name of an axis without its unit."""
    return axis.removesuffix("_deg")


def _pose(check: HandEyeCheck, index: int) -> str:
    """Return number and name of a pose."""
    name = check.names[index] if index < len(check.names) else ""
    return f"pose {index + 1} ({name})" if name else f"pose {index + 1}"


def _fault(check: HandEyeCheck, fault: GimbalFault) -> tuple[VerdictKind, str]:
    """Return the kind and the sentence of a fault."""
    size = angle_and_uncertainty(fault.size_deg, fault.sigma_deg)
    if fault.kind == "slip":
        before, after = _pose(check, fault.pose - 1), _pose(check, fault.pose)
        more = "more" if fault.size_deg < 0 else "less"
        sentence = f"The {_name(AXES[fault.axis])} axis slipped between {before} and {after}: "
        sentence += f"after that, readings show {size} {more} than the axis turned"
    elif fault.kind == "mount":
        before, after = _pose(check, fault.pose - 1), _pose(check, fault.pose)
        sentence = f"The camera turned in its mount between {before} and {after}, by {size}"
    elif fault.kind == "pose":
        pose = _pose(check, fault.pose)
        sentence = f"{pose[0].upper()}{pose[1:]} does not fit: reading and rotation differ by {size}"
    else:
        sentence = f"The axes of pan and tilt are not at right angles: they differ from it by {size}"
    if fault.rival is not None:
        rival = {
            "slip": "a slipped axis",
            "mount": "a camera that turned in its mount",
            "pose": "one wrong pose",
            "squareness": "axes not at right angles",
        }
        sentence += f"; {rival[fault.rival]} explains the data nearly as well"
    return _KINDS[fault.kind], f"{sentence}."


def _of_pairs(check: HandEyeCheck) -> str:
    """Return what the pairs of poses show, in words."""
    pairs = check.pairs
    if pairs is None:
        return "No pair of poses turned far enough for a ratio."
    spread = f", spread {_plain(100 * pairs.spread)} %" if pairs.spread >= 1e-6 else ""
    what = f"{pairs.count} pairs of poses" if pairs.count > 1 else "1 pair of poses"
    return f"Median of {what}: {_ratio(pairs.ratio, 0.1 * pairs.spread)}{spread}."


def _significant(check: HandEyeCheck, size: float, sigma: float) -> bool:
    """Return whether the likelihood ratio decides for a value; that of Student's distribution if there is scatter."""
    ratio, freedom = (size / max(sigma, 1e-12)) ** 2, max(check.degrees_of_freedom, 1)
    return bool((freedom * np.log1p(ratio / freedom) if check.excess_arcsec > 0 else ratio) > DECISIVE)


def _common_to_pairs(check: HandEyeCheck) -> float:
    """Return how far the ratio of the pairs is from 1; 0 if the pairs differ among themselves.

    With large angles the fit can attribute a common ratio to the focal length, because it knows the covariance.
    """
    if check.pairs is None or check.pairs.count < len(check.scale) + 1:
        return 0.0
    off = abs(check.pairs.ratio - 1)
    return off if off > 3 * check.pairs.spread else 0.0


def _scale(check: HandEyeCheck) -> tuple[VerdictKind, str] | None:
    """Return what the scales show, or what the pairs show if no scale is known."""
    if not check.scale:
        return ("agrees", _of_pairs(check)) if check.pairs is not None else None
    values, own = np.array(list(check.scale.values())), np.maximum(check.own_sigma, 1e-12)
    common = float(np.average(values, weights=own**-2))
    common_sigma = min(check.scale_sigma.values())
    focal = check.focal_uncertainty if check.focal_uncertainty is not None else 2 * common_sigma
    differ = _significant(check, float(np.ptp(values)), check.difference_sigma)
    off = float(np.abs(values - 1).max()) if differ else abs(common - 1)
    by_axis = ", ".join(
        f"{_name(axis)} {_ratio(check.scale[axis], 2 * sigma)} ± {_ratio(2 * sigma, 2 * sigma)}"
        for axis, sigma in check.scale_sigma.items()
    )
    seen = f"Angle seen over angle read: {by_axis} (k = 2). {_of_pairs(check)}"
    seen_off = _common_to_pairs(check)
    by_pairs = off < seen_off <= focal and not differ
    if by_pairs and check.pairs is not None:
        off, common = seen_off, check.pairs.ratio
    own_sigma = 1 / float(np.sqrt((own**-2).sum()))
    shown = by_pairs or _significant(check, off, own_sigma)
    if not differ and not shown:
        return "agrees", seen
    alike = "is not the same along all axes. It differs from 1 by up to" if differ else "differs from 1 by"
    seen += f" The ratio {alike} {_percent(off)}. The U of the focal length is {_percent(focal)}."
    if not differ and off <= focal:
        direction = "short" if common > 1 else "long"
        return "agrees", (
            f"{seen} So the two agree. If the gimbal is right, the focal length is {_percent(off)} too {direction}."
        )
    if off <= focal and check.views_disagree:
        return "views_biased", (
            f"{seen} The views contradict each other, also without the readings. So nothing points to the gimbal."
        )
    if off <= PARALLAX:
        return "scale_or_parallax", (
            f"{seen} The gimbal has a scale error, or there is parallax: the entrance pupil is off the pivot and the "
            "collimator out of focus. Below about 1 % nothing tells the two apart."
        )
    return "gimbal_scale", (
        f"{seen} So the scale of the gimbal is in question. Check the steps or counts per degree in the station file."
    )


def _scatter(check: HandEyeCheck) -> tuple[VerdictKind, str] | None:
    """Return what scatter remains, if the stated uncertainties do not explain it."""
    if check.excess_arcsec <= 0:
        return None
    differ = (
        f"Rotations and readings differ more than their stated uncertainties explain, by "
        f"{angle(check.excess_arcsec / 3600)} (standard deviation per axis)."
    )
    if check.views_disagree:
        return "views_biased", (
            f"{differ} The views also contradict each other, {check.birge_ratio:.1f} times more than the noise of the "
            "stars explains, although no reading is involved. Errors of the collimator or of the lens model bias the "
            "rotations. So this scatter does not show an error of the gimbal."
        )
    few = "" if check.degrees_of_freedom >= 6 else " These poses are too few to tell which."
    return "scatter", (
        f"{differ} Possible causes: an axis slipped, a reading is wrong, or the gimbal repeats worse than the camera "
        f"resolves.{few}"
    )
