"""Views whose stars are not where they should be: ids shifted on the lattice, points with another origin.

A shift of all stars of a view, on the target or in the image, is two columns of its basis. So the equations say what
the likelihood gains by any shifts, with all unknowns and with the own fields of the poses (`AddedColumns`). Where they
promise enough, the shifted views are adjusted, and the likelihood ratio decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array
from calib.errors import CalibrationError, NotConverged
from calib.joint.added_columns import PROMISED, AddedColumns, displaced
from calib.joint.effects.effect import Places
from calib.joint.evidence import value_as_weighed
from calib.joint.hypotheses import OTHER_ORIGIN, SHIFTED_IDS
from calib.joint.solve import Optimum, search
from calib.model import cause as kinds
from calib.model.cause import Cause
from calib.model.likelihood_ratio import DECISIVE, needed
from calib.model.local_consistency import local_spacing
from calib.progress import expect
from calib.view import View

#: Shifts of ids up to this number of columns and rows are tried.
MAX_SHIFT = 2
_SHIFTS = [
    (i, j) for i in range(-MAX_SHIFT, MAX_SHIFT + 1) for j in range(-MAX_SHIFT, MAX_SHIFT + 1) if i or j
]
#: Largest deviation of a star from a node of the lattice, pitches.
_ON_LATTICE = 0.05
#: A shift is looked at if -2 log of the likelihood rises by no more than this with it, all linear: wrong ids have made
#: the own fields of the poses look large. On drawn gimbals with right ids it would rise by 300 or more from three poses
#: on; with wrong ids of one of nine views and readings it rose by 9.
_LOOKED_AT = -50.0
#: Largest number of shifts that are adjusted at a time.
_ADJUSTED = 4
#: Of other shifts that explain much, so many are tried with other sizes: each takes up to four searches.
_RIVALS = 2
#: An origin at a pixel's corner instead of its centre, px.
HALF_PX = 0.5


def _shifts(optimum: Optimum, places: Places) -> AddedColumns:
    """Return what the likelihood gains by a shift of each of m views along two ``places`` of their bases: K = 2 m."""
    m, size = len(optimum.marginal.problem.bench.poses), optimum.marginal.equations.of_views.shape[1]
    columns = np.zeros((m, size, 2 * m))
    for v in range(m):
        columns[v, places, [2 * v, 2 * v + 1]] = 1.0
    return AddedColumns.of(optimum, columns)


def _shifted_linearly(optimum: Optimum, places: Places, shifts: Array) -> Optimum:
    """Return the optimum with (m, 2) shifts and the best amplitudes then, all linear."""
    basis = np.zeros((len(shifts), optimum.marginal.equations.of_views.shape[1]))
    basis[:, places] = shifts
    return displaced(optimum, basis, optimum.eta)


@dataclass(frozen=True)
class _Moved:
    """An optimum with some views shifted."""

    shifts: Array  # (m, 2) of the ids, columns and rows
    gain: float  # By how much -2 log of the likelihood falls
    optimum: Optimum


def _moved(first: Optimum, near: Optimum, rounds: int, shifts_mm: Array, eta: Array) -> Optimum:
    """Return the optimum with (m, 2) shifts of the views' stars on the target, from the state of a ``near`` one.

    The search of the amplitudes begins at (A,) logarithms ``eta``.
    """
    problem = first.marginal.problem
    stars = problem.bench.stars.moved(shifts_mm, problem.bench.layout.basis)
    bench, pupils = replace(problem.bench, stars=stars), problem.pupils
    if pupils is not None:
        pupils = pupils.moved(bench.by_pose(shifts_mm) / bench.by_pose(np.ones((len(shifts_mm), 1))))
        bench = replace(bench, pupils=pupils.shown)
    start = bench.aligned(near.state, first.marginal.equations.weights)
    return search(replace(problem, bench=bench, pupils=pupils), start, rounds, eta).at_best


def _gain(first: Optimum, there: Optimum) -> float:
    """Return 2 log of the likelihood ratio of an optimum to the first one."""
    return first.at_best.solution.value - value_as_weighed(there, first)


def find_shifted_ids(
    optimum: Optimum, views: Sequence[View], rounds: int, again: Callable[[Sequence[View]], Optimum]
) -> Cause | None:
    """Look for views whose ids are shifted by columns and rows of the lattice against those of the others.

    The best shift of one view is kept, and the search goes on with the next view, up to half of the views. Where
    another view would do, too, other sizes of its shift are tried. A pupil that a hand moves can imitate a shift: there
    each shift is kept only if the views, adjusted ``again``, gain as much.
    """
    pitch = _lattice_pitch(views)
    if len(views) < 2 or pitch is None:
        return None
    each = needed(len(views) * len(_SHIFTS)) - 2.0 * math.log(SHIFTED_IDS.odds)

    def cost(moved: _Moved) -> float:
        return each * float(np.count_nonzero(moved.shifts.any(axis=1)))

    def worth(moved: _Moved) -> float:
        return moved.gain - cost(moved)

    by_hand = optimum.marginal.problem.pupils is not None

    def holds(moved: _Moved) -> bool:
        if not by_hand:
            return True
        return _gain_again(optimum, views, pitch * moved.shifts, again, rounds) >= cost(moved)

    best = _Moved(np.zeros((len(views), 2)), 0.0, optimum)
    every = [best]
    while more := _shifted(optimum, best, pitch, rounds):
        every += more
        better = max(more, key=worth)
        if worth(better) <= worth(best) or not holds(better):
            break
        best = better
    if not best.shifts.any():
        return None
    others = sorted((moved for moved in every if worth(moved) > 0.0 and moved is not best), key=worth)
    for rival in others[-_RIVALS:]:  # another size of its shift may explain more
        every += _shifted(optimum, rival, pitch, rounds)
    likeliest = max(every, key=worth)
    best = likeliest if likeliest is best or holds(likeliest) else best
    rivals = [moved for moved in every if moved.shifts.any() and worth(moved) > worth(best) - DECISIVE]
    shown = [_in_words(views, moved) for moved in (best, *rivals)]
    if len(views) == 2:  # what all views have in common is another centre
        shown += [_in_words(views, replace(best, shifts=best.shifts - best.shifts.sum(axis=0)))]
    return Cause(kinds.IDS, worth(best) + DECISIVE, axis=", or ".join(dict.fromkeys(shown)))


def _shifted(first: Optimum, best: _Moved, pitch: float, rounds: int) -> list[_Moved]:
    """Return the optima with the most promising shifts of one more view, or with another shift of a shifted one."""
    layout, count = first.marginal.problem.bench.layout, len(best.shifts)
    full = np.count_nonzero(best.shifts.any(axis=1)) >= max(1, (count - 1) // 2)
    tried = np.repeat(best.shifts[None], count * len(_SHIFTS), axis=0).reshape(count, len(_SHIFTS), count, 2)
    for v in range(count):
        tried[v, :, v] = _SHIFTS
    open_views = [v for v in range(count) if best.shifts[v].any() or not full]
    hypotheses = tried[open_views].reshape(-1, count, 2)
    places = layout.pose.shifts
    steps = (hypotheses - best.shifts) * pitch / layout.basis.reference[2]
    gains = _shifts(best.optimum, places).gains(steps.reshape(len(steps), -1))
    gains[~steps.any(axis=(1, 2))] = -np.inf

    by_how_much = (hypotheses.any(axis=2) == best.shifts.any(axis=1)).all(axis=1)  # the views are known
    shifted = []
    for k in np.argsort(-gains)[:_ADJUSTED].tolist():
        if by_how_much[k] or gains[k] > _LOOKED_AT:
            with suppress(NotConverged, np.linalg.LinAlgError):
                linear = _shifted_linearly(best.optimum, places, steps[k])
                promised = best.optimum.at_best.solution.value - linear.solution.value
                if by_how_much[k] or promised > PROMISED:
                    expect(1)
                    there = _moved(first, best.optimum, rounds, pitch * hypotheses[k], linear.eta)
                    shifted.append(_Moved(hypotheses[k], _gain(first, there), there))
    return shifted


def _gain_again(
    optimum: Optimum,
    views: Sequence[View],
    shifts_mm: Array,
    again: Callable[[Sequence[View]], Optimum],
    rounds: int,
) -> float:
    """Return what (m, 2) shifts of stars gain if the shifted views are adjusted anew; 0 if they cannot be.

    Another state may be what gains. So the stars without these shifts are adjusted from there, too.
    """
    moved = [
        replace(view, target_mm=view.target_mm + shift) for view, shift in zip(views, shifts_mm, strict=True)
    ]
    try:
        there = again(moved).at_best
        unmoved = _moved(optimum, there, rounds, np.zeros_like(shifts_mm), there.eta)
    except CalibrationError:
        return 0.0
    return min(optimum.at_best.solution.value, unmoved.solution.value) - there.solution.value


def _in_words(views: Sequence[View], moved: _Moved) -> str:
    """Return shifts in words, as "view left by 1 column"."""
    views_in_words = []
    for view, shift in zip(views, moved.shifts.astype(int).tolist(), strict=True):
        parts = [
            f"{number} {name if abs(number) == 1 else name + 's'}"
            for number, name in zip(shift, ("column", "row"), strict=True)
            if number
        ]
        views_in_words += [f"view {view.name} by {' and '.join(parts)}"] if parts else []
    return " and ".join(views_in_words)


def _lattice_pitch(views: Sequence[View]) -> float | None:
    """Return the pitch of the lattice on which all stars lie, mm; None if they lie on none."""
    if min(len(view) for view in views) < 4:
        return None
    pitch = min(local_spacing(view.target_mm) for view in views)
    steps = (np.concatenate([view.target_mm for view in views]) - views[0].target_mm[0]) / pitch
    return pitch if np.abs(steps - np.round(steps)).max() < _ON_LATTICE else None


def find_other_origins(optimum: Optimum, views: Sequence[View]) -> Cause | None:
    """Look for views whose points lie half a pixel away from those of the other views, along both axes.

    Views join the shifted ones, one by one. The likelihood ratio decides how many there are, at most half of all
    views. An offset of another size must not be decisively more likely. A single view is seldom found, because its own
    rotation imitates a shift. Three or more views are needed.
    """
    if len(views) < 3:
        return None
    places = np.array([optimum.marginal.problem.bench.layout.index[name] for name in ("cx", "cy")])
    shifts = _shifts(optimum, places)
    ratio, shift = max((_joined(shifts, by) for by in (HALF_PX, -HALF_PX)), key=lambda joined: joined[0])
    if ratio < 0.0:
        return None
    pattern = shift.reshape(-1)
    information = float(pattern @ shifts.information @ pattern)
    times = float(pattern @ shifts.gradient) / information
    if (times - 1.0) ** 2 * information > DECISIVE:
        return None
    return Cause(
        kinds.ORIGIN,
        ratio + DECISIVE,
        value=HALF_PX * times,
        expanded=2.0 * HALF_PX / math.sqrt(information),
        unit="px",
        axis="right and down" if shift.sum() > 0.0 else "left and up",
        pose=", ".join(view.name for view, own in zip(views, shift, strict=True) if own.any()),
    )


def _joined(shifts: AddedColumns, by: float) -> tuple[float, Array]:
    """Return 2 log(likelihood ratio) of the best group of views, beyond what is needed, and the (m, 2) shifts, px."""
    views = len(shifts.gradient) // 2
    shift, best = np.zeros((views, 2)), (-np.inf, np.zeros((views, 2)))
    for size in range(1, views // 2 + 1):
        tried = np.array(
            [np.where(np.eye(views)[i][:, None] > 0, by, shift) for i in range(views) if not shift[i, 0]]
        )
        gains = shifts.gains(tried.reshape(len(tried), -1))
        shift = tried[gains.argmax()]
        ratio = float(gains.max()) - needed(2 * math.comb(views, size)) + 2.0 * math.log(OTHER_ORIGIN.odds)
        best = max(best, (ratio, shift), key=lambda ratio_and_shift: ratio_and_shift[0])
    return best
