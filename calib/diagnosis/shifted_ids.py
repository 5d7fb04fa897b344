"""Views whose ids are shifted: each star bears the name of a neighbour one or two columns or rows away.

A shift of all ids of a view is, to first order, a rotation of the camera. Only the perspective of the target separates
them: joint adjustments of all views are compared. If two hypotheses do about as well, both are named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array
from calib.diagnosis.gross_stars import typical_noise_px
from calib.diagnosis.linearised import independent_components, plain_bundle, rms_px, target_shifts
from calib.model.likelihood_ratio import DECISIVE, needed
from calib.model.local_consistency import local_spacing
from calib.view import View

#: Shifts up to this number of columns and rows are tried.
MAX_SHIFT = 2
_SHIFTS = [
    (i, j) for i in range(-MAX_SHIFT, MAX_SHIFT + 1) for j in range(-MAX_SHIFT, MAX_SHIFT + 1) if i or j
]
#: Number of stars of each view that take part, of hypotheses that are adjusted, and of steps.
_STARS = 120
_ADJUSTED = 4
_STEPS = 20
_TOLERANCE = 1e-5
#: Largest deviation of a star from a node of the lattice, pitches.
_ON_LATTICE = 0.05


@dataclass(frozen=True)
class IdShift:
    """A shift of all ids of one view that makes it fit the others."""

    view: str
    # columns, rows: Number of columns (along X) and rows (along Y) that the ids must be shifted by.
    columns: int
    rows: int

    def __str__(self) -> str:
        """Say it in words, as "view left by 1 column"."""
        parts = [
            f"{number} {name if abs(number) == 1 else name + 's'}"
            for number, name in ((self.columns, "column"), (self.rows, "row"))
            if number
        ]
        return f"view {self.view} by {' and '.join(parts)}"


@dataclass(frozen=True)
class ShiftedIds:
    """The ids that are shifted, as far as the data decide."""

    shifts: tuple[IdShift, ...]  # The shifts that together explain the residuals best; at least one
    # Other single shifts that explain them about as well; none if the data decide.
    rivals: tuple[IdShift, ...]
    # rms_before_px, rms_after_px: Root mean square length of the residual vectors of the stars compared, px,
    # before and after the shifts.
    rms_before_px: float
    rms_after_px: float

    @property
    def decided(self) -> bool:
        """Whether one explanation is clearly the best."""
        return not self.rivals

    @property
    def sentence(self) -> str:
        """Names the views and the shifts, or says that the data cannot decide between them."""
        fall = f"the residuals fall from {self.rms_before_px:.2g} to {self.rms_after_px:.2g} px"
        shifts = " and ".join(str(one) for one in self.shifts)
        if self.decided:
            return (
                f"The star ids are wrong: shift the ids of {shifts}, and {fall}. "
                "Check the tag or the id file of this view."
            )
        others = ", or ".join(str(one) for one in self.rivals)
        return (
            f"The star ids of one view are shifted, but these views cannot decide which: shift the ids of {shifts}, "
            f"or {others}; {fall}. Check the ids of these views, or add views."
        )


def find_shifted_ids(
    views: Sequence[View], bundle: Bundle, parameters: AdjustmentParameters
) -> ShiftedIds | None:
    """Search for views whose ids are shifted against those of the others, in a model with one centre.

    All shifts of one view by up to two columns and rows are judged by a linearised adjustment; the best are adjusted.
    The best is kept, and the search goes on with the next view, up to half of the views. Own procedure. None if the
    views agree, if no shift explains the residuals, if the stars lie on no lattice, or if no view has 8 stars.
    """
    pitch = _lattice_pitch(views)
    if len(views) < 2 or pitch is None:
        return None
    noise = typical_noise_px(views)
    if not np.isfinite(noise):
        return None
    bundle = plain_bundle(bundle, _STARS)
    start = AdjustmentParameters(
        parameters.camera, parameters.collimator, parameters.rotations, np.zeros((len(views), 3))
    )
    rms, limit = rms_px(bundle, start), needed(len(views) * len(_SHIFTS))
    first_rms, accepted, rivals = rms, list[_Shift](), tuple[_Shift, ...]()
    for _ in range(max(1, (len(views) - 1) // 2)):
        taken = {place for place, _ in accepted}
        count = independent_components(bundle, rms, noise)
        tried = _best_shifts(bundle, start, pitch, taken, float(np.exp(0.5 * limit / count)))
        if not tried or _ratio(bundle, rms, tried[0][0], noise) < limit:
            break
        least = tried[0][0]
        rivals = tuple(one for found, one, *_ in tried[1:] if _ratio(bundle, found, least, noise) < DECISIVE)
        rms, shift, bundle, start = tried[0]
        accepted.append(shift)
    if not accepted:
        return None
    return ShiftedIds(
        tuple(_named(views, shift) for shift in accepted),
        tuple(_named(views, shift) for shift in rivals),
        first_rms,
        rms,
    )


def _ratio(bundle: Bundle, before: float, after: float, noise: float) -> float:
    """Return 2 log(likelihood ratio) of residuals whose rms falls from one value to another.

    For n Gaussian residuals of an unknown variance it is n log(before^2 / after^2).
    """
    # An exact fit is no better than rounding allows.
    least = 1e-6
    count = independent_components(bundle, after, noise)
    return 2.0 * count * float(np.log(max(before, least) / max(after, least)))


_Shift = tuple[int, tuple[int, int]]


def _named(views: Sequence[View], shift: _Shift) -> IdShift:
    """Return a shift with the name of its view."""
    place, (columns, rows) = shift
    return IdShift(views[place].name, columns, rows)


def _lattice_pitch(views: Sequence[View]) -> float | None:
    """Return the pitch of the lattice on which all stars lie, mm; None if they lie on none."""
    if min(len(view) for view in views) < 4:
        return None
    x, y = np.concatenate([view.target_mm for view in views]).T
    order = np.lexsort((y, x))
    x, y = x[order], y[order]
    other = np.concatenate([[True], (x[1:] != x[:-1]) | (y[1:] != y[:-1])])
    pitch = local_spacing(np.column_stack([x, y])[other])
    for view in views:
        steps = (view.target_mm - views[0].target_mm[0]) / pitch
        if not np.abs(steps - np.round(steps)).max() < _ON_LATTICE:
            return None
    return pitch


def _best_shifts(
    bundle: Bundle, start: AdjustmentParameters, pitch: float, taken: set[int], fall: float
) -> list[tuple[float, _Shift, Bundle, AdjustmentParameters]]:
    """Return the best shifts of one more view, the best first: rms of the residuals, shift, bundle and optimum.

    The list is empty if the linearised adjustment does not promise that the squares fall by a factor.
    """
    equations, views = target_shifts(bundle, start), len(bundle.observations.slices)
    hypotheses = [(place, shift) for place in range(views) if place not in taken for shift in _SHIFTS]
    shifts = np.zeros((len(hypotheses), views, 2))
    for k, (place, shift) in enumerate(hypotheses):
        shifts[k, place] = pitch * np.array(shift)
    squares = equations.squares_after(shifts)
    if not equations.squares > fall * squares.min():
        return []
    found = []
    for place, shift in [hypotheses[k] for k in np.argsort(squares)[:_ADJUSTED]]:
        moved = _moved(bundle, place, pitch * np.array(shift))
        end = refine(moved, start, Loss("l2"), _STEPS, _TOLERANCE).parameters
        found.append((rms_px(moved, end), (place, shift), moved, end))
    return sorted(found, key=lambda one: one[0])


def _moved(bundle: Bundle, place: int, shift_mm: Array) -> Bundle:
    """Return the bundle with the target positions of one view moved."""
    obs = bundle.observations
    target = obs.target.copy()
    target[obs.slices[place], :2] += shift_mm
    return replace(bundle, observations=replace(obs, target=target))
