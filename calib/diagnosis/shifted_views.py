"""Views that are shifted against the others: by columns and rows of the target's ids, or by the origin of the image.

A shift of all ids of a view (each star bears the name of a neighbour one or two columns or rows away) is, to first
order, a rotation of the camera. Only the perspective of the target separates them: joint adjustments of all views are
compared. If two hypotheses do about as well, both are named.

The origin of image points is the centre of the first pixel, or its corner, half a pixel away. Views alone cannot show
it: a common shift of all points moves the principal point, and nothing else changes. If only some views of a set are
shifted, the others show it. A rotation of the camera imitates a shift to first order, so only good views decide.

Hypotheses are judged by the joint adjustment linearised at its optimum. Only what a changed camera, centre or rotation
cannot explain leaves a trace. It is linear algebra on a few stars of each view, so that hundreds of hypotheses cost no
more than one step of an adjustment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.adjustment.bundle import Bundle, ViewEquations
from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array, rms_length
from calib.diagnosis.gross_stars import typical_noise_px
from calib.model.likelihood_ratio import DECISIVE, needed
from calib.model.local_consistency import local_spacing
from calib.view import View

#: Shifts up to this number of columns and rows are tried.
MAX_SHIFT = 2
_SHIFTS = [
    (i, j) for i in range(-MAX_SHIFT, MAX_SHIFT + 1) for j in range(-MAX_SHIFT, MAX_SHIFT + 1) if i or j
]
#: Number of stars of each view that take part, of hypotheses that are adjusted, and of steps.
_STARS_OF_IDS = 120
_ADJUSTED = 4
_STEPS = 20
_TOLERANCE = 1e-5
#: Largest deviation of a star from a node of the lattice, pitches.
_ON_LATTICE = 0.05

_Shift = tuple[int, tuple[int, int]]
"""Number of the view, and the columns and rows that its ids must be shifted by."""


def find_shifted_ids(views: Sequence[View], bundle: Bundle, parameters: AdjustmentParameters) -> str:
    """Search for views whose ids are shifted against those of the others, in a model with one centre.

    All shifts of one view by up to two columns and rows are judged by a linearised adjustment; the best are adjusted.
    The best is kept, and the search goes on with the next view, up to half of the views. Own procedure. A sentence,
    which is empty if the views agree, if no shift explains the residuals, if the stars lie on no lattice, or if no view
    has 8 stars.
    """
    pitch = _lattice_pitch(views)
    if len(views) < 2 or pitch is None:
        return ""
    noise = typical_noise_px(views)
    if not np.isfinite(noise):
        return ""
    bundle = _plain_bundle(bundle, _STARS_OF_IDS)
    start = AdjustmentParameters(
        parameters.camera, parameters.collimator, parameters.rotations, np.zeros((len(views), 3))
    )
    rms, limit = _rms_px(bundle, start), needed(len(views) * len(_SHIFTS))
    first_rms, accepted, rivals = rms, list[_Shift](), list[_Shift]()
    for _ in range(max(1, (len(views) - 1) // 2)):
        taken = {place for place, _ in accepted}
        count = _independent_components(bundle, rms, noise)
        tried = _best_shifts(bundle, start, pitch, taken, float(np.exp(0.5 * limit / count)))
        if not tried or _ratio(bundle, rms, tried[0][0], noise) < limit:
            break
        least = tried[0][0]
        rivals = [one for found, one, *_ in tried[1:] if _ratio(bundle, found, least, noise) < DECISIVE]
        rms, shift, bundle, start = tried[0]
        accepted.append(shift)
    if not accepted:
        return ""
    fall = f"the residuals fall from {first_rms:.2g} to {rms:.2g} px"
    shifts = " and ".join(_named(views, one) for one in accepted)
    if not rivals:
        return (
            f"The star ids are wrong: shift the ids of {shifts}, and {fall}. "
            "Check the tag or the id file of this view."
        )
    others = ", or ".join(_named(views, one) for one in rivals)
    return (
        f"The star ids of one view may be shifted; these views cannot decide which: shift the ids of {shifts}, "
        f"or {others}; {fall}. Check the ids of these views, or add views."
    )


def _named(views: Sequence[View], shift: _Shift) -> str:
    """Return a shift in words, as "view left by 1 column"."""
    place, numbers = shift
    parts = [
        f"{number} {name if abs(number) == 1 else name + 's'}"
        for number, name in zip(numbers, ("column", "row"), strict=True)
        if number
    ]
    return f"view {views[place].name} by {' and '.join(parts)}"


def _ratio(bundle: Bundle, before: float, after: float, noise: float) -> float:
    """Return 2 log(likelihood ratio) of residuals whose rms falls from one value to another.

    For n Gaussian residuals of an unknown variance it is n log(before^2 / after^2).
    """
    # An exact fit is no better than rounding allows.
    least = 1e-6
    count = _independent_components(bundle, after, noise)
    return 2.0 * count * float(np.log(max(before, least) / max(after, least)))


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
    equations, views = _shift_equations(bundle, start, of_image=False), len(bundle.observations.slices)
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
        found.append((_rms_px(moved, end), (place, shift), moved, end))
    return sorted(found, key=lambda one: one[0])


def _moved(bundle: Bundle, place: int, shift_mm: Array) -> Bundle:
    """Return the bundle with the target positions of one view moved."""
    obs = bundle.observations
    target = obs.target.copy()
    target[obs.slices[place], :2] += shift_mm
    return replace(bundle, observations=replace(obs, target=target))


HALF_PX = 0.5
_STARS_OF_ORIGINS = 400


def find_other_origins(views: Sequence[View], bundle: Bundle, parameters: AdjustmentParameters) -> str:
    """Look for views whose points lie half a pixel away from those of the other views, along both axes.

    Views join the shifted ones, one by one, and the likelihood ratio decides how many of them lie half a pixel off, at
    most half of them. An offset of another size must not be decisively more likely. One view alone is seldom enough,
    because its own rotation imitates a shift. Own procedure. It takes three or more views without gross errors, and a
    model with one centre. A sentence, empty if all agree, or if the views cannot decide.
    """
    noise = typical_noise_px(views)
    if len(views) < 3 or not np.isfinite(noise):
        return ""
    plain = _plain_bundle(bundle, _STARS_OF_ORIGINS)
    equations = _shift_equations(plain, parameters, of_image=True)
    count = _independent_components(plain, _rms_px(plain, parameters), noise)
    ratio, shift = max((_joined(equations, by, count) for by in (HALF_PX, -HALF_PX)), key=lambda one: one[0])
    if not ratio > 0.0:
        return ""
    # Offsets of the joined views along each axis, from the equations restricted to these views.
    pattern = np.stack([shift * axis for axis in np.eye(2)]) / HALF_PX
    normal = np.einsum("anx,nxmy,bmy->ab", pattern, equations.information, pattern)
    right = np.einsum("anx,nx->a", pattern, equations.gradient)
    variance = float(equations.squares_after(shift[None])[0]) / count
    offset = np.linalg.solve(normal, right)
    away = offset - HALF_PX
    if away @ normal @ away > DECISIVE * variance:
        return ""
    members, sigmas = np.flatnonzero(shift[:, 0]).tolist(), np.sqrt(np.diag(np.linalg.inv(normal)) * variance)
    names = [views[i].name for i in members]
    which = f"view {names[0]} lie" if len(names) == 1 else f"views {', '.join(names)} lie"
    return (
        f"The points of {which} {_words(offset * np.sign(shift[members[0], 0]))} of those of the other views "
        f"(± {2.0 * sigmas.max():.2g} px, k = 2): their origin seems to differ. "
        "Check --origin, and give all views the same."
    )


def _joined(equations: _ShiftEquations, by: float, count: float) -> tuple[float, Array]:
    """Return 2 log(likelihood ratio) of the best group of views, beyond what is needed, and the (n, 2) shifts, px."""
    views = len(equations.gradient)
    shift, best = np.zeros((views, 2)), (-np.inf, np.zeros((views, 2)))
    for size in range(1, views // 2 + 1):
        tried = np.array(
            [np.where(np.eye(views)[i][:, None] > 0, by, shift) for i in range(views) if not shift[i, 0]]
        )
        squares = equations.squares_after(tried)
        shift, least = tried[squares.argmin()], max(float(squares.min()), 1e-9 * equations.squares)
        ratio = count * float(np.log(equations.squares / least)) - needed(2 * math.comb(views, size))
        best = max(best, (ratio, shift), key=lambda one: one[0])
    return best


def _words(offset: Array) -> str:
    """Write an offset, as "0.50 px right and 0.50 px down"."""
    along = f"{abs(offset[0]):.2f} px {'right' if offset[0] >= 0 else 'left'}"
    return f"{along} and {abs(offset[1]):.2f} px {'down' if offset[1] >= 0 else 'up'}"


#: Residuals above this multiple of the noise that neighbouring stars show are mostly systematic. They vary slowly over
#: a view and resemble each other in all views, so they count as this number of independent components: for 72 places,
#: the residuals must fall to 60 %. With more components, sound views of a real collimator were called wrong.
_SYSTEMATIC = 1.3
_INDEPENDENT = 18


@dataclass(frozen=True)
class _ShiftEquations:
    """The cost of an adjustment as a function of a shift of each of n views, everything else adjusted to it.

    Sum of squares, weighted, for shifts s_i: ``squares - 2 sum_i gradient_i s_i + sum_ij s_i information_ij s_j``.
    """

    squares: float  # Sum of squares of the weighted residuals if nothing is shifted
    gradient: Array  # (n, 2) float64, 1 / mm for shifts of the target, 1 / px for shifts of the image
    information: Array  # (n, 2, n, 2) float64, the same units squared

    def squares_after(self, shifts: Array) -> Array:
        """Return (K,) sums of squares, at least 0, after (K, n, 2) shifts of the views, mm or px."""
        flat = shifts.reshape(len(shifts), -1)
        information = self.information.reshape(flat.shape[1], -1)
        change = ((flat @ information - 2.0 * self.gradient.ravel()) * flat).sum(axis=1)
        return np.asarray(np.maximum(self.squares + change, 0.0))


def _plain_bundle(bundle: Bundle, stars: int) -> Bundle:
    """Return a bundle of some of the stars, with shared camera and centre."""
    return Bundle(bundle.observations, bundle.names).thinned(stars)


def _rms_px(bundle: Bundle, parameters: AdjustmentParameters) -> float:
    """Return the rms length of the residual vectors, px; infinite if a star cannot be projected."""
    with np.errstate(invalid="ignore", over="ignore"):
        rms = rms_length(bundle.residuals_px(parameters))
    return rms if np.isfinite(rms) else float("inf")


def _independent_components(bundle: Bundle, rms: float, noise_px: float) -> float:
    """Return the number of independent residual components, if the rms length of the residual vectors is as given, px.

    The noise is that of neighbouring stars, px, 1 sigma per axis.
    """
    obs = bundle.observations
    components = max(2 * len(obs.view) - len(bundle.names) - 3 * len(obs.slices), 0)
    systematic = rms / np.sqrt(2.0) > _SYSTEMATIC * noise_px
    return float(min(components, _INDEPENDENT) if systematic else components)


def _shift_equations(bundle: Bundle, parameters: AdjustmentParameters, *, of_image: bool) -> _ShiftEquations:
    """Return the equations of shifts of the image points of each view, px, or of its target positions, mm.

    Of a bundle of `_plain_bundle`. Gauss and Newton's linearisation; the rotations, then the shared parameters, are
    eliminated by the Schur complement (Triggs et al., 2000, section 6.1).
    """
    count = len(bundle.names)
    # A shift of the image is one of the principal point; a shift of the target is the opposite one of the centre.
    names = (*bundle.names, "cx", "cy") if of_image else bundle.names
    freed = replace(bundle, names=names, free_centres=not of_image).equations(parameters, Loss("l2"))
    order = np.r_[0:count, count + np.array((0, 1, 2, 3, 4) if of_image else (3, 4, 0, 1, 2))]
    sign = np.ones(count + 5)
    sign[count : count + 2] = 1.0 if of_image else -1.0
    normal = np.outer(sign, sign) * freed.normal[:, order[:, None], order]
    whole = ViewEquations(normal, sign * freed.right[:, order], count + 2)
    views = whole.eliminated()
    squares = float((bundle.weighted_residuals(parameters) ** 2).sum())
    squares -= float((whole.right[:, count + 2 :] * views.own).sum())
    gram, score, n = views.information, views.score, len(views.score)
    gradient, coupling = score[:, count:], gram[:, count:, :count]
    information = np.zeros((n, 2, n, 2))
    information[np.arange(n), :, np.arange(n)] = gram[:, count:, count:]
    shared = gram[:, :count, :count].sum(axis=0)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(shared), np.finfo(float).tiny))
    flat = coupling.reshape(2 * n, count) * scale
    inverse = np.linalg.pinv(shared * np.outer(scale, scale), rcond=1e-13, hermitian=True)
    right = scale * score[:, :count].sum(axis=0)
    squares -= float(right @ inverse @ right)
    gradient = gradient - (flat @ inverse @ right).reshape(n, 2)
    information = information - (flat @ inverse @ flat.T).reshape(n, 2, n, 2)
    return _ShiftEquations(max(squares, 0.0), gradient, information)
