"""Views whose stars are not where they should be: ids shifted on the lattice, points with another origin.

A shift of all stars of a view, on the target or in the image, is two columns of its basis. So the equations say what
the likelihood gains by any shifts (`AddedColumns`). Of ids, where they promise enough, the shifted views are adjusted,
and the likelihood ratio decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from calib.arrays import Array
from calib.errors import CalibrationError, NotConverged
from calib.joint.added_columns import PROMISED, AddedColumns, displaced
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
_SHIFTS = [shift for shift in product(range(-MAX_SHIFT, MAX_SHIFT + 1), repeat=2) if any(shift)]
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


def _with_one(shifts: Array, views: Sequence[int], steps: Sequence[tuple[float, ...]]) -> Array:
    """Return (N, m, 2) the (m, 2) shifts with each step for each of some views instead."""
    places = np.arange(len(shifts))[:, None]
    return np.array([np.where(places == view, step, shifts) for view in views for step in steps])


@dataclass(frozen=True)
class _Shifted:
    """An optimum with the ids of some views shifted."""

    shifts: Array  # (m, 2) columns and rows
    worth: float  # 2 log of the odds against right ids, less those from which on it is named
    optimum: Optimum


@dataclass(frozen=True)
class _Ids:
    """The ids of m views, which may be shifted."""

    first: Optimum
    views: Sequence[View]
    pitch_mm: float
    again: Callable[[Sequence[View]], Optimum]

    def beside(self, best: _Shifted) -> list[_Shifted]:
        """Return the most promising shifts of one more view, up to half of them, or other shifts of a shifted one."""
        m, shifted = len(self.views), best.shifts.any(axis=1)
        full = np.count_nonzero(shifted) >= max(1, (m - 1) // 2)
        tried = _with_one(best.shifts, [v for v in range(m) if best.shifts[v].any() or not full], _SHIFTS)
        tried = tried[(tried != best.shifts).any(axis=(1, 2))]
        layout = self.first.marginal.problem.bench.layout
        directions = np.eye(layout.pose.size)[:, layout.pose.shifts]
        steps = (tried - best.shifts) * self.pitch_mm / layout.basis.reference[2]
        gains = AddedColumns.of_views(best.optimum, directions).gains(steps.reshape(len(steps), -1))
        known = (tried.any(axis=2) == shifted).all(axis=1)
        adjusted = []
        for k in np.argsort(-gains)[:_ADJUSTED].tolist():
            if known[k] or gains[k] > _LOOKED_AT:
                with suppress(NotConverged, np.linalg.LinAlgError):
                    linear = displaced(best.optimum, steps[k] @ directions.T, best.optimum.eta)
                    if known[k] or best.optimum.at_best.solution.value - linear.solution.value > PROMISED:
                        expect(1)
                        there = self._adjusted(tried[k], best.optimum, linear.eta)
                        gain = self.first.at_best.solution.value - value_as_weighed(there, self.first)
                        adjusted.append(_Shifted(tried[k], self._worth_of(gain, tried[k]), there))
        return adjusted

    def _worth_of(self, gain: float, shifts: Array) -> float:
        each = needed(len(self.views) * len(_SHIFTS)) - 2.0 * math.log(SHIFTED_IDS.odds)
        return gain - each * float(np.count_nonzero(shifts.any(axis=1)))

    def _adjusted(self, shifts: Array, near: Optimum, eta: Array) -> Optimum:
        """Return the optimum with (m, 2) shifts, searched from the state of a ``near`` one and from amplitudes."""
        problem, shifts_mm = self.first.marginal.problem, self.pitch_mm * shifts
        stars = problem.bench.stars.moved(shifts_mm, problem.bench.layout.basis)
        bench, pupils = replace(problem.bench, stars=stars), problem.pupils
        if pupils is not None:
            pupils = pupils.moved(bench.by_pose(shifts_mm) / bench.by_pose(np.ones((len(shifts_mm), 1))))
            bench = replace(bench, pupils=pupils.shown)
        start = bench.aligned(near.state, self.first.marginal.equations.weights)
        return search(replace(problem, bench=bench, pupils=pupils), start, eta).at_best

    def holds(self, shifted: _Shifted) -> bool:
        """Tell whether shifted views that are adjusted anew gain as much: a pupil in a hand can imitate a shift.

        Another state may be what gains. So the stars without these shifts are adjusted from there, too.
        """
        if self.first.marginal.problem.pupils is None:
            return True
        shifts_mm = self.pitch_mm * shifted.shifts
        moved = [
            replace(view, target_mm=view.target_mm + shift)
            for view, shift in zip(self.views, shifts_mm, strict=True)
        ]
        before = self.first.at_best.solution.value
        try:
            there = self.again(moved).at_best
            if there.marginal.problem.pupils is None:  # the discs no longer fit together
                return False
            if _unknowns(there) == _unknowns(self.first):  # what seemed two poses can be one
                unmoved = self._adjusted(np.zeros_like(shifts_mm), there, there.eta)
                before = min(before, unmoved.solution.value)
        except CalibrationError:
            return False
        return self._worth_of(before - there.solution.value, shifted.shifts) >= 0.0


def _unknowns(optimum: Optimum) -> tuple[str, ...]:
    return optimum.marginal.problem.bench.layout.names


def _worth(shifted: _Shifted) -> float:
    return shifted.worth


def find_shifted_ids(
    optimum: Optimum, views: Sequence[View], again: Callable[[Sequence[View]], Optimum]
) -> Cause | None:
    """Look for views whose ids are shifted by columns and rows of the lattice against those of the others.

    The best shift of one view is kept, and the search goes on with the next view. Where another view would do, too,
    other sizes of its shift are tried. Where a hand moves the pupil, the views are adjusted ``again``.
    """
    pitch_mm = _lattice_pitch(views)
    if len(views) < 2 or pitch_mm is None:
        return None
    ids = _Ids(optimum, views, pitch_mm, again)
    best = _Shifted(np.zeros((len(views), 2)), 0.0, optimum)
    every = [best]
    while more := ids.beside(best):
        every += more
        better = max(more, key=_worth)
        if better.worth <= best.worth or not ids.holds(better):
            break
        best = better
    if not best.shifts.any():
        return None
    others = sorted((other for other in every if other.worth > 0.0 and other is not best), key=_worth)
    for rival in others[-_RIVALS:]:  # another size of its shift may explain more
        every += ids.beside(rival)
    likeliest = max(every, key=_worth)
    best = likeliest if likeliest is best or ids.holds(likeliest) else best
    rivals = [other for other in every if other.shifts.any() and other.worth > best.worth - DECISIVE]
    shown = [_in_words(views, shifted.shifts) for shifted in (best, *rivals)]
    if len(views) == 2:  # what all views have in common is another centre
        shown += [_in_words(views, best.shifts - best.shifts.sum(axis=0))]
    return Cause(kinds.IDS, best.worth + DECISIVE, axis=", or ".join(dict.fromkeys(shown)))


def _in_words(views: Sequence[View], shifts: Array) -> str:
    """Return (m, 2) shifts in words, as "view left by 1 column"."""
    shown = []
    for view, shift in zip(views, shifts.astype(int).tolist(), strict=True):
        numbers = zip(shift, ("column", "row"), strict=True)
        parts = [f"{number} {name}{'s' * (abs(number) > 1)}" for number, name in numbers if number]
        shown += [f"view {view.name} by {' and '.join(parts)}"] if parts else []
    return " and ".join(shown)


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
    layout = optimum.marginal.problem.bench.layout
    offsets = AddedColumns.of_views(optimum, np.eye(layout.pose.size)[:, layout.places(("cx", "cy"))])
    groups = [group for by in (HALF_PX, -HALF_PX) for group in _joined(offsets, len(views), by)]
    evidence, shifts = max(groups, key=lambda group: group[0])
    size = offsets.along(shifts.reshape(-1, 1))
    information = float(size.information[0, 0])
    times = float(size.gradient[0]) / information
    if evidence < DECISIVE or (times - 1.0) ** 2 * information > DECISIVE:
        return None
    return Cause(
        kinds.ORIGIN,
        evidence,
        value=HALF_PX * times,
        expanded=2.0 * HALF_PX / math.sqrt(information),
        unit="px",
        axis="right and down" if shifts.sum() > 0.0 else "left and up",
        pose=", ".join(view.name for view, own in zip(views, shifts, strict=True) if own.any()),
    )


def _joined(offsets: AddedColumns, views: int, by: float) -> Iterator[tuple[float, Array]]:
    """Give the best groups of ever more views: 2 log of their odds, and (m, 2) the shifts, px."""
    shifts = np.zeros((views, 2))
    for size in range(1, views // 2 + 1):
        tried = _with_one(shifts, np.flatnonzero(shifts[:, 0] == 0.0).tolist(), [(by, by)])
        gains = offsets.gains(tried.reshape(len(tried), -1))
        shifts = tried[gains.argmax()]
        places = 2.0 * math.log(2 * math.comb(views, size))
        yield float(gains.max()) - places + 2.0 * math.log(OTHER_ORIGIN.odds), shifts
