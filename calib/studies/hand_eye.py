"""Hand-eye check: the gimbal's readings compared with the rotations that the camera saw.

The check is a witness: the readings do not enter the calibration here. It estimates how the camera is mounted, how the
gimbal stands, and a scale of each axis that moved (`calib.studies.gimbal_model`). Pairs of poses give the same scales
without these estimates (`calib.studies.gimbal_model`); a scale that they contradict is not stated. Faults of the gimbal
are searched for (`calib.studies.gimbal_faults`), and the verdict names whose error it is.

A wrong focal length changes all seen angles by the same ratio, along all axes and in all pairs of poses. So a common
ratio within the uncertainty of the focal length belongs to the calibration (camera or collimator), not to the gimbal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import special

from calib.arrays import Array
from calib.compiled import on_one_thread
from calib.errors import DegenerateViews, InputMismatch
from calib.model.gimbal_readings import AXES, angles_of
from calib.model.likelihood_ratio import DECISIVE
from calib.studies.gimbal_faults import Explanation, GimbalFault, SeenRotations, search_faults
from calib.studies.gimbal_model import (
    FaultKind,
    GimbalFit,
    GimbalModel,
    PairRatios,
    global_fit,
    pair_ratios,
    refine,
    scales_near,
)
from calib.uncertainty.projection_uncertainty import ARCSEC

VerdictKind = Literal[
    "agrees",
    "slip",
    "wrong_pose",
    "not_square",
    "wrong_sign",
    "ambiguous",
    "contradictory",
    "focal_length",
    "scale_or_parallax",
    "gimbal_scale",
    "views_biased",
    "scatter",
]

_KINDS: Mapping[FaultKind, VerdictKind] = {"slip": "slip", "pose": "wrong_pose", "squareness": "not_square"}
AXIS_NAMES = ("pan", "tilt", "roll")
#: Parallax before a real collimator imitates a scale up to about this size.
PARALLAX = 0.015
#: Views disagree if they differ this many times more than star noise explains.
_DISAGREE = 1.5
#: A common ratio this near to 1 and within the U of the focal length is agreement.
_SMALL = 1e-3


@dataclass(frozen=True)
class Verdict:
    """Result of the check in one name, and in plain sentences."""

    # ``agrees``: readings and rotations agree. ``slip``, ``wrong_pose``, ``not_square``: a fault was found.
    # ``wrong_sign``: the sign of one axis is reversed. ``ambiguous``: different mountings explain the data
    # equally well. ``contradictory``: fit and pairs of poses disagree on the scale. ``focal_length``: a
    # common ratio within the uncertainty of the focal length. ``scale_or_parallax``: a scale that parallax
    # can imitate. ``gimbal_scale``: a scale error of the gimbal. ``views_biased``: scatter that the views
    # show among themselves. ``scatter``: scatter of unknown cause.
    kind: VerdictKind
    says: tuple[str, ...]


@dataclass(frozen=True)
class Findings:
    """What the verdict is made of."""

    names: Sequence[str]
    # scale, scale_sigma: True angle over reading and 1-sigma, by index of the axis; empty if no scale was
    # estimated.
    scale: Mapping[int, float]
    scale_sigma: Mapping[int, float]
    # 1-sigma of each scale from the scatter of the rotations alone, without errors that all rotations share.
    own_sigma: Mapping[int, float]
    difference_sigma: float  # 1-sigma of the largest difference between two scales
    pairs: PairRatios | None  # Ratios of the pairs of poses; None if no pair turned enough
    contradicted: bool  # Whether the scale of the fit disagrees with the pairs
    ambiguous: bool  # Whether another optimum fits nearly as well
    # Name of the axis whose sign is reversed, or of the axes of which one is; empty if the signs are right.
    reversed_axes: str
    faults: tuple[GimbalFault, ...]
    excess_deg: float  # Scatter of the rotations that nothing explains, degrees
    degrees_of_freedom: int
    # Expanded uncertainty U of the focal length as a share of it; None if unknown.
    focal_uncertainty: float | None
    birge_ratio: float

    @property
    def views_disagree(self) -> bool:
        """Whether the views of the calibration contradict each other, without any reading."""
        return self.birge_ratio > _DISAGREE

    @property
    def scale_known(self) -> bool:
        """Whether a scale may be stated."""
        return bool(self.scale) and not (self.contradicted or self.ambiguous)


def judge(found: Findings) -> Verdict:
    """Return the verdict: faults come first, then reasons not to claim a scale, then the scale, then scatter."""
    kinds: list[VerdictKind] = []
    says: list[str] = []
    for fault in found.faults:
        kind, sentence = _fault(found, fault)
        says.append(sentence)
        kinds.append(kind)
    if found.reversed_axes:
        kinds.append("wrong_sign")
        says.append(
            f"The sign of {found.reversed_axes} is reversed: as they are, the readings fit no mounting in which the "
            "camera looks forward. Check the signs of the axes in the station file."
        )
    if found.ambiguous:
        kinds.append("ambiguous")
        says.append(
            "Different mountings of the camera explain the rotations equally well, so no scale is stated. Add poses "
            "that turn the camera about another axis."
        )
    elif found.contradicted:
        kinds.append("contradictory")
        says.append(f"The fit and the pairs of poses disagree, so no scale is stated. {_of_pairs(found)}")
    for judged in (_scale(found), _scatter(found)):
        if judged is not None:
            kinds.append(judged[0])
            says.append(judged[1])
    kinds.sort(key=lambda kind: kind == "agrees")
    first = [kind for name in _KINDS.values() for kind in kinds if kind == name]
    return Verdict((first or kinds or ["agrees"])[0], tuple(says))


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


def _pose(found: Findings, index: int) -> str:
    """Return number and name of a pose."""
    name = found.names[index] if index < len(found.names) else ""
    return f"pose {index + 1} ({name})" if name else f"pose {index + 1}"


def _fault(found: Findings, fault: GimbalFault) -> tuple[VerdictKind, str]:
    """Return the kind and the sentence of a fault."""
    size = angle_and_uncertainty(fault.size_deg, fault.sigma_deg)
    if fault.kind == "slip":
        assert fault.axis is not None
        assert fault.pose is not None
        before, after = _pose(found, fault.pose - 1), _pose(found, fault.pose)
        more = "more" if fault.size_deg < 0 else "less"
        sentence = f"The {AXIS_NAMES[fault.axis]} axis slipped between {before} and {after}: "
        sentence += f"after that, readings show {size} {more} than the axis turned"
    elif fault.kind == "pose":
        assert fault.pose is not None
        pose = _pose(found, fault.pose)
        sentence = f"{pose[0].upper()}{pose[1:]} does not fit: reading and rotation differ by {size}"
    else:
        sentence = f"The axes of pan and tilt are not at right angles: they differ from it by {size}"
    if fault.rival is not None:
        rival = {"slip": "a slipped axis", "pose": "one wrong pose", "squareness": "axes not at right angles"}
        sentence += f"; {rival[fault.rival]} explains the data nearly as well"
    return _KINDS[fault.kind], f"{sentence}."


def _of_pairs(found: Findings) -> str:
    """Return what the pairs of poses show, in words."""
    pairs = found.pairs
    if pairs is None:
        return "No pair of poses turned far enough for a ratio."
    spread = f", spread {_plain(100 * pairs.spread)} %" if pairs.spread >= 1e-6 else ""
    what = f"{pairs.count} pairs of poses" if pairs.count > 1 else "1 pair of poses"
    text = f"Median of {what}: {_ratio(pairs.ratio, 0.1 * pairs.spread)}{spread}."
    if len(pairs.by_axis) > 1:
        axes = ", ".join(
            f"{AXIS_NAMES[axis]} {_ratio(value, 0.1 * pairs.spread)}" for axis, value in pairs.by_axis.items()
        )
        text = f"{text[:-1]} ({axes})."
    return text


def _significant(found: Findings, size: float, sigma: float) -> bool:
    """Return whether the likelihood ratio decides for a value; that of Student's distribution if there is scatter."""
    ratio, freedom = (size / max(sigma, 1e-12)) ** 2, max(found.degrees_of_freedom, 1)
    return bool((freedom * np.log1p(ratio / freedom) if found.excess_deg > 0 else ratio) > DECISIVE)


def _common_to_pairs(found: Findings) -> float:
    """Return how far the ratio of the pairs is from 1, if all pairs show it; else 0.

    With large angles the fit can attribute a common ratio to the focal length, because it knows the covariance.
    """
    if found.pairs is None or found.pairs.count < len(found.scale) + 1:
        return 0.0
    off = abs(found.pairs.ratio - 1)
    return off if off > 3 * found.pairs.spread else 0.0


def _scale(found: Findings) -> tuple[VerdictKind, str] | None:
    """Return what the scales show, or what the pairs show if no scale is known."""
    if found.contradicted and not found.ambiguous:
        return None
    if not found.scale_known:
        return ("agrees", _of_pairs(found)) if found.pairs is not None else None
    axes = list(found.scale)
    values = np.array([found.scale[axis] for axis in axes])
    own = np.array([max(found.own_sigma[axis], 1e-12) for axis in axes])
    common = float(np.average(values, weights=own**-2))
    common_sigma = float(np.min([found.scale_sigma[axis] for axis in axes]))
    focal = found.focal_uncertainty if found.focal_uncertainty is not None else 2 * common_sigma
    differ = _significant(found, float(np.ptp(values)), found.difference_sigma)
    off = float(np.abs(values - 1).max()) if differ else abs(common - 1)
    by_axis = ", ".join(
        f"{AXIS_NAMES[axis]} {_ratio(value, 2 * found.scale_sigma[axis])} ± "
        f"{_ratio(2 * found.scale_sigma[axis], 2 * found.scale_sigma[axis])}"
        for axis, value in zip(axes, values, strict=True)
    )
    seen = f"Angle seen over angle read: {by_axis} (k = 2). {_of_pairs(found)}"
    seen_off = _common_to_pairs(found)
    by_pairs = off < seen_off <= focal and not differ
    if by_pairs and found.pairs is not None:
        off, common = seen_off, found.pairs.ratio
    own_sigma = 1 / float(np.sqrt((own**-2).sum()))
    shown = by_pairs or _significant(found, off, own_sigma)
    if not differ and (not shown or (off <= focal and off < _SMALL)):
        return "agrees", seen
    if off <= focal and (not differ or found.views_disagree):
        direction = "short" if common > 1 else "long"
        alike = "alike along all axes" if not differ else "and the views contradict each other"
        return "focal_length", (
            f"{seen} The ratio differs from 1 by {_percent(off)}, {alike}. A focal length that is "
            f"{_percent(off)} too {direction} gives this, and its U is {_percent(focal)}: the calibration (camera or "
            "collimator) is in question, and nothing points to the gimbal."
        )
    how = f"The ratio is {'not ' if differ else ''}the same along all axes"
    if off <= PARALLAX:
        return "scale_or_parallax", (
            f"{seen} {how} and differs from 1 by {_percent(off)}; the U of the focal length is {_percent(focal)}. "
            "This is a scale error of the gimbal, or parallax (entrance pupil off the pivot, collimator out of "
            "focus): up to about 1 % they cannot be told apart."
        )
    return "gimbal_scale", (
        f"{seen} {how} and differs from 1 by {_percent(off)}, but the U of the focal length is {_percent(focal)}: "
        "the scale of the gimbal is in question. Check the steps or counts per degree in the station file."
    )


def _scatter(found: Findings) -> tuple[VerdictKind, str] | None:
    """Return what scatter remains, if the stated uncertainties do not explain it."""
    if found.excess_deg <= 0:
        return None
    size = angle(found.excess_deg)
    if found.views_disagree:
        return "views_biased", (
            f"Rotations and readings differ by {size} (standard deviation per axis) more than the stars' noise "
            f"explains. The views also contradict each other ({found.birge_ratio:.1f} times more than the stars' noise "
            "explains), "
            "without any reading: errors of the collimator or the lens model bias the rotations, so this scatter does "
            "not show an error of the gimbal."
        )
    few = "" if found.degrees_of_freedom >= 6 else " These poses are too few to tell which."
    return "scatter", (
        f"Rotations and readings differ by {size} (standard deviation per axis) more than the stars' noise "
        "explains. Possible causes: an axis slipped, a reading is wrong, or the gimbal repeats worse than the camera "
        f"resolves.{few}"
    )


_MIN_VIEWS = 3
_MOVED_DEG = 0.5
#: The scale of the fit contradicts the pairs beyond this many sigmas of their difference.
_CONTRADICTED = 5.0
#: Probability that the readings of a gimbal without errors do not agree.
_INCONSISTENT = 1e-3
#: A scale with a larger 1-sigma is not determined.
_UNDETERMINED = 0.25
#: Minima differ if their scales or mountings differ by this many sigmas.
_DIFFERENT = 5.0


@dataclass(frozen=True)
class HandEyeCheck:
    """Result of the comparison of rotations and readings."""

    # True angle over reading, for each axis whose scale may be stated; faults that were found are allowed
    # for.
    scale: Mapping[str, float]
    scale_sigma: Mapping[str, float]  # 1-sigma of the scales
    # (n, 3) float64 rotation seen minus rotation read without faults, as rotation vectors about the camera's
    # axes, arc seconds.
    residuals_arcsec: Array
    # chi_square, degrees_of_freedom: Chi-square of the residuals by the stated covariance, without faults,
    # and its degrees of freedom; large if the gimbal repeats worse than the camera measures.
    chi_square: float
    degrees_of_freedom: int
    # 1-sigma of the scatter, for each component of a rotation, that the stated covariance and the faults do
    # not explain, arc seconds.
    excess_arcsec: float
    pairs: PairRatios | None  # Ratios from the pairs of poses; None if no pair turned far enough
    faults: tuple[GimbalFault, ...]
    verdict: Verdict

    @property
    def rms_arcsec(self) -> float:
        """Root mean square angle between rotations and readings, arc seconds."""
        return float(np.sqrt((self.residuals_arcsec**2).sum(axis=1).mean()))

    @property
    def consistent(self) -> bool:
        """Whether the chi-square is below its 99.9 % quantile."""
        return bool(self.chi_square < special.chdtri(max(self.degrees_of_freedom, 1), _INCONSISTENT))


@on_one_thread
def check_hand_eye(
    rotations: Array,
    covariance: Array,
    readings_deg: Sequence[Mapping[str, float]],
    *,
    focal_uncertainty: float | None = None,
    birge_ratio: float = 1.0,
    names: Sequence[str] = (),
) -> HandEyeCheck:
    """Compare the readings of a gimbal, in the order in which they were taken, with the rotations of a calibration.

    The unknown rotations and scales are estimated by generalised least squares. Robot-world and hand-eye equation:
    Zhuang, Roth and Sudhakar (1994). Least squares with a covariance matrix: Aitken (1936). Scatter beyond the stated
    covariance: Paule and Mandel (1982). Rotations, covariance (of `Calibration.rotation_covariance`) and Birge ratio
    are those of a `Calibration`. ``focal_uncertainty`` is U of its focal length as a share of it; None for twice the
    1-sigma of the scales.
    Raises InputMismatch: If the numbers of views differ, or an axis is unknown.
    Raises DegenerateViews: If there are fewer than 3 views, or no axis moved.
    """
    angles = angles_of(readings_deg)
    if not len(angles) == len(rotations) == len(covariance) // 3:
        raise InputMismatch(f"{len(rotations)} rotations, but {len(angles)} readings.")
    moved = np.ptp(angles, axis=0) > _MOVED_DEG
    if len(angles) < _MIN_VIEWS or not moved.any():
        raise DegenerateViews(
            f"Cannot check the gimbal: {len(angles)} views, {moved.sum()} axes moved; "
            f"at least {_MIN_VIEWS} views and 1 moved axis are needed."
        )
    given = tuple(i for i, axis in enumerate(AXES) if any(axis in reading for reading in readings_deg))
    enough = 3 * len(angles) > 6 + moved.sum()
    free = tuple(int(i) for i in np.flatnonzero(moved)) if enough else ()
    model = GimbalModel(angles, free)
    raw = pair_ratios(rotations, model, covariance, model.start)
    ratio = raw.ratio if raw else 1.0
    values = np.array([raw.by_axis.get(axis, ratio) if raw else 1.0 for axis in free])
    equal = np.eye(len(covariance))
    start = global_fit(rotations, model, equal, values)[0]
    seen = SeenRotations(rotations, covariance, start)
    first = seen.explain(model, start)
    mirrored = False
    if 2 in free and len(free) > 1:
        model = replace(model, angles=angles * (1.0, 1.0, -1.0))
        other = seen.explain(model, global_fit(rotations, model, equal, values)[0])
        better = other.likelihood > first.likelihood + DECISIVE or not scales_near(first.fit, values)
        mirrored = better and scales_near(other.fit, values)
        first = other if mirrored else first
    last, faults = search_faults(seen, first, given)
    pairs = pair_ratios(rotations, last.fit.model, last.scatter.covariance, last.fit.values) or raw
    found = _findings(seen, last, pairs, faults, mirrored)
    found = replace(found, names=tuple(names), focal_uncertainty=focal_uncertainty, birge_ratio=birge_ratio)
    turns = first.fit.camera_from_head, first.fit.base_from_target
    stated = refine(rotations, first.fit.model, seen.stated.whitening, (*turns, first.fit.values)).chi_square
    return HandEyeCheck(
        {AXES[axis]: value for axis, value in found.scale.items()} if found.scale_known else {},
        {AXES[axis]: value for axis, value in found.scale_sigma.items()} if found.scale_known else {},
        ARCSEC * first.fit.off.reshape(-1, 3),
        stated,
        first.fit.degrees_of_freedom(),
        ARCSEC * last.excess_rad if last.scattered else 0.0,
        pairs,
        faults,
        judge(found),
    )


def _findings(
    seen: SeenRotations,
    last: Explanation,
    pairs: PairRatios | None,
    faults: tuple[GimbalFault, ...],
    mirrored: bool,
) -> Findings:
    """Collect what the verdict is made of."""
    fit, covariance = last.fit, last.scatter.covariance
    free = fit.model.free
    estimator = fit.estimator(last.scatter.whitening)[6 : 6 + len(free)]
    spread = estimator @ covariance @ estimator.T
    sigma = np.sqrt(np.maximum(np.diag(spread), 0.0))
    freedom = fit.degrees_of_freedom()
    # Shared errors have few, large eigenvalues; the median is the variance that is a rotation's own.
    scatter = max(fit.off @ fit.off / max(freedom, 1), float(np.median(np.linalg.eigvalsh(covariance))))
    own = np.sqrt(scatter * np.diag(np.linalg.pinv(fit.jacobian.T @ fit.jacobian))[6 : 6 + len(free)])
    values = fit.values[: len(free)]
    difference = 0.0
    if len(free) > 1:
        apart = np.zeros(len(free))
        apart[int(values.argmax())] += 1.0
        apart[int(values.argmin())] -= 1.0
        difference = float(np.sqrt(np.maximum(apart @ spread @ apart, 0.0)))
    contradicted = False
    for k, axis in enumerate(free):
        if pairs is None or axis not in pairs.by_axis:
            continue
        row = estimator[k] - pairs.estimator[axis]
        apart_sigma = float(np.sqrt(np.maximum(row @ covariance @ row, 0.0)))
        limit = _CONTRADICTED * apart_sigma + 0.1 * abs(pairs.by_axis[axis] - 1) + 1e-7
        contradicted |= bool(abs(values[k] - pairs.by_axis[axis]) > limit)
    whole = freedom == len(fit.off) - fit.jacobian.shape[1]
    return Findings(
        (),
        {axis: float(values[k]) for k, axis in enumerate(free)},
        {axis: float(sigma[k]) for k, axis in enumerate(free)},
        {axis: float(own[k]) for k, axis in enumerate(free)},
        difference,
        pairs,
        contradicted,
        bool(free)
        and (fit.undetermined_scales() or bool(sigma.max() > _UNDETERMINED) or _ambiguous(seen, last, sigma)),
        _reversed_axes(set(free), bool(whole and fit.camera_from_head[2, 2] < -0.5), mirrored),
        faults,
        float(np.rad2deg(last.excess_rad)) if last.scattered else 0.0,
        freedom,
        None,
        1.0,
    )


def _reversed_axes(free: set[int], backwards: bool, mirrored: bool) -> str:
    """Return the axes of which the sign of one is reversed, in words; empty if no sign is.

    Half a turn of the mounting about x reverses pan and roll, about y tilt and roll, about z pan and tilt. So a wrong
    sign shows as a camera that looks backwards, or, with three axes, as readings that fit only if roll is mirrored.
    """
    if free >= {0, 1} and backwards != mirrored and not mirrored:
        return "pan or of tilt" if 2 not in free else "roll and of one other axis"
    if mirrored and free == {0, 1, 2}:
        return "pan or of tilt" if backwards else "roll"
    return "roll" if backwards and 2 in free and len(free) == 2 else ""


def _ambiguous(seen: SeenRotations, last: Explanation, sigma: Array) -> bool:
    """Return whether another minimum with other scales, or another mounting, fits nearly as well."""
    fit, scatter, count = last.fit, last.scatter, len(last.fit.model.free)
    minima = global_fit(seen.rotations, fit.model, scatter.whitening, fit.values)
    mounted = fit.estimator(scatter.whitening)[:3]
    mounting = float(np.sqrt(np.trace(np.asarray(mounted @ scatter.covariance @ mounted.T))))
    whole = fit.degrees_of_freedom() == len(fit.off) - fit.jacobian.shape[1]

    def differs(other: GimbalFit) -> bool:
        if not scales_near(other, fit.values) or other.chi_square > fit.chi_square + DECISIVE:
            return False
        if (np.abs(other.values[:count] - fit.values[:count]) > _DIFFERENT * sigma + 1e-6).any():
            return True
        cosine = 0.5 * (np.trace(other.camera_from_head @ fit.camera_from_head.T) - 1.0)
        turned = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        return whole and turned > _DIFFERENT * mounting + 1e-4

    return any(differs(other) for other in minima)
