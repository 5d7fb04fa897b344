"""Search for faults of a gimbal: an axis that slipped, a single wrong pose, axes that are not at right angles.

Each fault is added to the fit, and an F test shows whether the fit improves by more than chance
(`calib.studies.hand_eye_fit` estimates the chance scatter). A bad pose is removed, so that it cannot hide a slip.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import special

from calib.studies.hand_eye_fit import INCONSISTENT, Explanation, GimbalFit, SeenRotations, seen_minus_read

Array = NDArray[np.float64]
FaultKind = Literal["slip", "pose", "squareness"]

#: Probability of a false alarm, for all faults that are tried.
FALSE_ALARMS = 1e-4
#: A rival of another kind within this difference of the criterion cannot be excluded (Raftery, 1995: strong).
_UNDECIDED = 6.0
_ROUNDS = 3
_TRIED = 3
#: Degrees of freedom needed to look for a slip and a wrong pose together.
_FOR_BOTH = 8


@dataclass(frozen=True)
class GimbalFault:
    """A fault of the gimbal, or of one pose, that the rotations show."""

    # ``slip``: the readings of one axis are off by a constant from one pose on. ``pose``: one pose does not
    # fit. ``squareness``: the axes of pan and tilt are not at right angles.
    kind: FaultKind
    axis: int | None  # Index of the axis that slipped; None for the other kinds
    # Index of the first pose after the slip, or of the pose that does not fit; None for ``squareness``.
    pose: int | None
    # size_deg, sigma_deg: Size of the fault and its 1-sigma, degrees; for ``pose`` the angle by which it is
    # off.
    size_deg: float
    sigma_deg: float
    probability: float
    # Kind of another fault that explains the data nearly as well; None if there is none.
    rival: FaultKind | None = None
    # Whether the fault remains significant beside an error that is quadratic in the angles; None if there are
    # too few poses to tell.
    bends_excluded: bool | None = None


def search_faults(
    seen: SeenRotations, first: Explanation, axes: tuple[int, ...]
) -> tuple[Explanation, tuple[GimbalFault, ...]]:
    """Add one fault after the other, as long as the fit improves by more than chance; the most significant is first.

    Forward selection with F tests (Efroymson, 1960) and Bonferroni's bound for the number of faults tried. A bad pose
    is removed, so that it cannot hide or imitate a slip.
    """
    current, faults = first, []
    for _ in range(_ROUNDS):
        if current.metric.excess == 0.0:
            break
        tried = [(_test(seen, current, other, number), kind, at, other) for kind, at, other, number in
                 _alternatives(seen, current, axes)]  # fmt: skip
        tried = [each for each in tried if each[0] < FALSE_ALARMS]
        if not tried:
            hidden = _hiding_pose(seen, current, axes)
            if hidden is None:
                break
            fault, current = hidden
            faults.append(fault)
            continue
        probability, kind, at, other = min(tried, key=lambda each: _preference(each[3]))
        rivals = [
            each[1] for each in tried if each[1] != kind and each[3].criterion < other.criterion + _UNDECIDED
        ]
        faults.append(
            replace(
                _described(seen, current, other, kind, at, probability),
                rival=rivals[0] if rivals else None,
                bends_excluded=_bends_excluded(seen, current, other),
            )
        )
        current = other
    return current, tuple(faults)


def _preference(one: Explanation) -> tuple[float, float]:
    """Return what decides between explanations: the criterion, and how far the scales are off if it is equal.

    On a grid of poses, a slip between two rows is a slip between two others with another scale.
    """
    scales = one.fit.values[: len(one.fit.model.free)]
    return round(one.criterion, 3), float(np.abs(scales - 1.0).max(initial=0.0))


def _alternatives(
    seen: SeenRotations, current: Explanation, axes: tuple[int, ...]
) -> Iterator[tuple[FaultKind, tuple[int, int], Explanation, int]]:
    """Yield the most promising faults of each kind, each with its fit and the number of faults of all kinds."""
    fit, kept = current.fit, current.kept
    count, model = len(kept), replace(fit.model, angles=fit.model.angles)
    slips = [
        (axis, first) for axis in axes for first in range(2, count - 1) if (axis, first) not in model.slips
    ]
    poses = list(range(count)) if count > 4 else []
    number = len(slips) + len(poses) + 1
    promise = _Promise(current)
    if fit.degrees_of_freedom() >= 3:
        for axis, first in sorted(slips, key=lambda each: -promise([each], []))[:_TRIED]:
            extended = replace(model, slips=(*model.slips, (axis, first)))
            values = np.insert(fit.values, len(model.free) + len(model.slips), 0.0)
            yield "slip", (axis, first), seen.explain(extended, kept, fit, values), number
        if not model.squareness and {0, 1} <= set(axes):
            extended = replace(model, squareness=True)
            values = np.insert(fit.values, len(model.free) + len(model.slips), 0.0)
            yield "squareness", (0, 0), seen.explain(extended, kept, fit, values), number
    if fit.degrees_of_freedom() >= 6:
        for pose in sorted(poses, key=lambda i: -promise([], [i]))[:_TRIED]:
            others = np.delete(np.arange(count), pose)
            yield (
                "pose",
                (0, pose),
                seen.explain(model.subset(others), kept[others], fit, fit.values),
                number,
            )


def _hiding_pose(
    seen: SeenRotations, current: Explanation, axes: tuple[int, ...]
) -> tuple[GimbalFault, Explanation] | None:
    """Return the wrong pose that hides a slip, if only both together explain the rotations; else None."""
    fit, kept = current.fit, current.kept
    count, promise, best = len(kept), _Promise(current), None
    pairs = [((axis, first), pose) for axis in axes for first in range(2, count - 1) for pose in range(count)]
    if fit.degrees_of_freedom() < _FOR_BOTH:
        return None
    for slip, pose in sorted(pairs, key=lambda each: -promise([each[0]], [each[1]]))[:_TRIED]:
        others = np.delete(np.arange(count), pose)
        extended = replace(fit.model, slips=(*fit.model.slips, slip)).subset(others)
        values = np.insert(fit.values, len(fit.model.free) + len(fit.model.slips), 0.0)
        both = seen.explain(extended, kept[others], fit, values)
        probability = _test(seen, current, both, len(pairs))
        if probability < FALSE_ALARMS and (best is None or both.criterion < best[0].criterion):
            best = both, pose, probability
    if best is None:
        return None
    both, pose, probability = best
    others = np.delete(np.arange(count), pose)
    alone = seen.explain(fit.model.subset(others), kept[others], fit, fit.values)
    return _described(seen, current, both, "pose", (0, pose), probability), alone


class _Promise:
    """How much the chi-square of a fit falls, to first order, by a slip or by leaving out a pose."""

    def __init__(self, current: Explanation) -> None:
        fit, self._weigh = current.fit, current.metric.whitening
        self._base = np.linalg.qr(self._weigh @ fit.jacobian)[0]
        self._residual = self._weigh @ fit.off
        self._turning = {axis: _turning(fit, axis) for axis in range(3)}

    def __call__(self, slips: Sequence[tuple[int, int]], poses: Sequence[int]) -> float:
        """Return the fall of the chi-square per parameter added."""
        columns = []
        for axis, first in slips:
            columns.append(self._turning[axis].copy())
            columns[-1][: 3 * first] = 0.0
        columns += [np.eye(len(self._residual))[:, 3 * i : 3 * i + 3] for i in poses]
        new = self._weigh @ np.hstack(columns)
        new = new - self._base @ (self._base.T @ new)
        solved = np.linalg.lstsq(new, self._residual, rcond=1e-9)[0]
        return float(solved @ (new.T @ self._residual)) / new.shape[1]


def _turning(fit: GimbalFit, axis: int) -> Array:
    """Return (3 n, 1) float64 derivatives of the rotations by a common offset of an axis."""
    model = replace(fit.model, slips=(*fit.model.slips, (axis, 0)))
    at = len(model.free) + len(fit.model.slips)
    values = np.insert(fit.values, at, 0.0)
    rotations = np.broadcast_to(np.eye(3), (len(model.angles), 3, 3))
    _, jacobian = seen_minus_read(rotations, model, fit.camera_from_head, fit.base_from_target, values)
    return jacobian[:, 6 + at : 7 + at]


def _test(seen: SeenRotations, null: Explanation, other: Explanation, number: int) -> float:
    """Return the probability that chance improves the fit as much (F test, or chi-square test; Bonferroni)."""
    before = seen.chi_square(null, other.metric.excess)
    after, freedom = other.fit.chi_square, other.fit.degrees_of_freedom()
    more = null.fit.degrees_of_freedom() - freedom
    if more <= 0 or before <= after:
        return 1.0
    if other.metric.excess == 0.0 or freedom <= 0:
        return float(min(1.0, number * special.chdtrc(more, before - after))) if freedom > 0 else 1.0
    ratio = (before - after) / more / max(1.0, after / freedom)
    return float(min(1.0, number * special.fdtrc(more, freedom, ratio)))


def _described(
    seen: SeenRotations,
    null: Explanation,
    other: Explanation,
    kind: FaultKind,
    at: tuple[int, int],
    probability: float,
) -> GimbalFault:
    """Return the fault with its size and uncertainty."""
    fit, axis, pose = other.fit, None, int(null.kept[at[1]]) if kind != "squareness" else None
    if kind == "pose":
        assert pose is not None
        gone = null.fit.model.subset(np.array([at[1]]))
        read = fit.camera_from_head @ gone.heads(fit.values)[0][0] @ fit.base_from_target
        cosine = 0.5 * (np.trace(seen.rotations[pose] @ read.T) - 1.0)
        size = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        sigma = sigma_of_pose(seen, null, at[1], other.metric.excess)
    else:
        place = len(fit.model.free) + len(fit.model.slips) - (kind == "slip")
        row = fit.estimator(other.metric)[6 + place]
        size, sigma = (
            float(fit.values[place]),
            float(np.sqrt(max(row @ other.metric.covariance @ row, 0.0))),
        )
        axis = at[0] if kind == "slip" else None
    return GimbalFault(kind, axis, pose, float(np.rad2deg(size)), float(np.rad2deg(sigma)), probability)


def sigma_of_pose(seen: SeenRotations, null: Explanation, place: int, excess: float) -> float:
    """Return the 1-sigma, rad, of a pose against the other poses, in its least certain direction.

    It is that of the conditional normal distribution (Rao, 1973). An error that the pose shares with the others, as
    that of the principal point, moves no pose against them.
    """
    rows = (3 * null.kept[:, None] + np.arange(3)).ravel()
    whole = seen.covariance[np.ix_(rows, rows)] + excess * np.eye(len(rows))
    own = slice(3 * place, 3 * place + 3)
    information = np.linalg.pinv(whole, rcond=1e-12, hermitian=True)[own, own]
    return float(1.0 / np.sqrt(np.linalg.eigvalsh(information)[0]))


def _bends_excluded(seen: SeenRotations, null: Explanation, other: Explanation) -> bool | None:
    """Return whether the fault remains significant beside bends; None with too few poses."""
    with_bends = []
    for each in (null, other):
        model = replace(each.fit.model, smooth=True)
        values = np.concatenate([each.fit.values, np.zeros(model.bends.shape[2])])
        with_bends.append(seen.explain(model, each.kept, each.fit, values))
    if with_bends[1].fit.degrees_of_freedom() < 4:
        return None
    return _test(seen, with_bends[0], with_bends[1], 1) < INCONSISTENT
