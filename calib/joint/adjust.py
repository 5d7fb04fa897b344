"""The search of one explanation: from views, lens and way of the pupil to the optimum."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from calib.adjustment.initialization import FOCAL_SHARES
from calib.adjustment.parameters import AdjustmentParameters, explain_weak_geometry
from calib.calibration import CalibrationOptions
from calib.errors import CalibrationError, DegenerateViews, InputMismatch, NotConverged
from calib.joint import amplitudes as amp
from calib.joint.effects.collimator import CENTRE
from calib.joint.equations import State
from calib.joint.evidence import odds_of, value_as_weighed
from calib.joint.hypotheses import ANOTHER_THING
from calib.joint.knowledge import ASPECT, CERTIFICATE, WRONG
from calib.joint.marginal import Marginal, Problem
from calib.joint.posed import Task, first_parameters, held_parameters, lens_names
from calib.joint.poses import seen_poses
from calib.joint.pupils import shown_way
from calib.joint.readings import MOST_SCATTER
from calib.joint.solve import (
    CURVED,
    TRUSTED,
    Optimum,
    approached,
    first_amplitudes,
    first_equations,
    relative_change,
    search,
    search_with_fault,
    solved,
)
from calib.joint.wrong_views import find_shifted_ids
from calib.model.cause import cause_sentence
from calib.progress import expect
from calib.view import View

#: A certificate may be refused if its radius differs by this share from what the views alone show: below that, doubts
#: of it tell more.
_OTHER_RADIUS = 0.1
#: Near the optimum pixels are square to .3 % only, so that images that were stretched are found.
_NEARLY_SQUARE = ((ASPECT, "10 times"),)
#: The stars are explained if they scatter by no more than so many times what neighbouring stars show. On 41 ray-traced
#: benches, right ends have 1.1 at most; ends at another camera have 1.24 or more, a mirror with fine errors has 1.9.
_AS_NEIGHBOURS = 1.15
#: A foot that lies so far beside the middle of the stars, as a share of the radius, is looked for there, too: a target
#: is square to its collimator to two degrees.
_BESIDE = 0.035
#: Starts are compared by so many stars a view, or more.
_COMPARISON_STARS = 50


class _DeniedError(Exception):
    """The views deny the certificate from one start; another start may show that they do not."""

    def __init__(self, alone: Optimum) -> None:
        super().__init__("The views deny the certificate.")
        self.alone = alone


class _Begin(NamedTuple):
    """Where a search begins."""

    near: State  # What the views alone show, near the optimum
    problem: Problem  # About that state
    state: State


def adjust(
    views: Sequence[View],
    options: CalibrationOptions,
    pupil: amp.Pupil | None = None,
    lens: tuple[str, ...] = (),
) -> Optimum:
    """Return the most probable of `optima`."""
    return optima(views, options, pupil, lens)[0]


def optima(
    views: Sequence[View],
    options: CalibrationOptions,
    pupil: amp.Pupil | None = None,
    lens: tuple[str, ...] = (),
) -> list[Optimum]:
    """Return the ends of all searches that were needed, the most probable first, with one family of the lens.

    ``pupil`` says how it is moved; None: as the visible discs say. A bound of the parallax says that the pupil is on a
    gimbal: then the discs only tell which stars are at the rim. ``lens``: other coefficients than the chosen ones. If
    nothing can be solved, the error says why by the geometry.
    """
    lens = lens or lens_names(options.distortion)
    start = first_parameters(views, options, lens)
    seen = seen_poses(views, start)
    if seen.discs and (options.gimbal is None or options.gimbal.parallax is None):
        seen = seen._replace(pupil=pupil or shown_way(seen.discs))
    try:
        return _searched_ends(Task(views, options, lens, seen), start)
    except (NotConverged, np.linalg.LinAlgError) as error:
        why = explain_weak_geometry(views, start)
        if not why:
            raise NotConverged("The joint adjustment cannot be solved.") from error
        raise DegenerateViews(
            f"These views do not determine the camera. {why}",
            remedy="Add views turned about other axes, with the stars elsewhere in the image.",
        ) from error


def _searched_ends(task: Task, start: AdjustmentParameters) -> list[Optimum]:
    """Return the ends of searches, the most probable first: from the closed form, and from another start.

    A closed form follows the errors of a collimator along what the views hardly determine, focal length and radius in
    proportion, and can end at eight times the camera. Where the stars or the readings do not fit at its end, a second
    search begins at the best start with a held radius. Nothing is blamed, refused or left out before.
    """
    ends, denied, failed = list[Optimum](), list[Optimum](), list[Exception]()

    def begun(begin: AdjustmentParameters) -> _Begin | None:
        problem, state = task.posed(begin)
        try:
            near = _approached(problem, state, task)
        except _DeniedError as error:
            denied.append(error.alone)
        except (NotConverged, np.linalg.LinAlgError) as error:
            failed.append(error)
        else:
            return _Begin(near, *task.posed_at(near, problem))
        return None

    for begin in _begins(task, start, begun):
        try:
            ends.append(_square_or_stretched(begin.problem, begin.state))
        except (NotConverged, np.linalg.LinAlgError) as error:
            failed.append(error)
        else:
            if _explains(ends[-1]):
                break
    if denied:
        alone = min(denied, key=lambda optimum: optimum.solution.value)
        if all(_is_less_probable(end, alone) for end in ends):
            raise _of_another_collimator(alone, task)
    if not ends:
        raise failed[0]
    first = ends[0]

    def rank(end: Optimum) -> tuple[bool, float]:
        return not end.converged, value_as_weighed(end, first)

    ends.sort(key=rank)
    with suppress(NotConverged, np.linalg.LinAlgError):  # the other ends stand
        ends = sorted([*ends, *_about_middle(task, ends[0])], key=rank)
    return ends


def _begins(
    task: Task, start: AdjustmentParameters, begun: Callable[[AdjustmentParameters], _Begin | None]
) -> Iterator[_Begin]:
    """Give where searches begin: by the closed form, and by the best start with a held radius if that is elsewhere.

    A closed form with oblong pixels is probably not the camera, and a search from there is long. It comes last.
    """
    closed = begun(start)
    late = closed is not None and _is_stretched(closed.problem, closed.near)
    if closed is not None and not late:
        yield closed
    few = task._replace(views=[_thinned(view) for view in task.views])
    held = _held_starts(few, start)
    other = begun(min(held, key=lambda begin: _value_at(few.posed(begin)))) if held else None
    if other is not None and (closed is None or not _begin_alike(closed, other)):
        expect(1)
        yield other
    if closed is not None and late:
        expect(1)
        yield closed


def _begin_alike(first: _Begin, other: _Begin) -> bool:
    """Tell whether focal lengths and centres are so near that not even the rotations follow a curve between them."""
    step = other.near.shared - first.near.shared
    return relative_change(first.problem.bench.layout, first.near, step) < CURVED


def _thinned(view: View) -> View:
    """Return a view with a share of its stars, spread over it: enough to compare starts."""
    return view.part(np.arange(len(view)) % max(1, len(view) // _COMPARISON_STARS) == 0)


def _held_starts(few: Task, start: AdjustmentParameters) -> list[AdjustmentParameters]:
    """Return starts with other focal lengths and the radii that belong to them; those that are no camera are left out.

    The image tells the scale fx / r, px/mm, whatever the two are. A search finds the optimum from .5 to 1.4 times the
    true focal length.
    """
    if few.knows_centre:
        return []
    diagonal, held = float(np.hypot(*few.views[0].image_size)), []
    for share in FOCAL_SHARES:
        radius = share * diagonal * start.collimator.r / start.camera.fx
        with suppress(CalibrationError):
            held.append(held_parameters(few.views, radius, few.lens))
    return held


def _value_at(begin: tuple[Problem, State]) -> float:
    """Return -2 log of the likelihood at a start, after one step with errors that are smaller than expected."""
    problem, state = begin
    with suppress(NotConverged, np.linalg.LinAlgError):
        marginal = Marginal(problem, first_equations(problem, state), state)
        return solved(marginal, first_amplitudes(problem, state)).value
    return np.inf


def _explains(optimum: Optimum) -> bool:
    """Tell whether the stars fit as neighbours agree with each other, and the readings as stated.

    Then no other camera could explain them better.
    """
    reading = float(np.exp(optimum.eta[optimum.marginal.problem.hyper.at(amp.READING)]))
    scatter = float(np.sqrt(optimum.solution.star_variance)) / optimum.marginal.problem.bench.stars.local
    return scatter <= _AS_NEIGHBOURS and reading < MOST_SCATTER


def _about_middle(task: Task, end: Optimum) -> list[Optimum]:
    """Return the end of a search whose foot begins in the middle of the stars, if that of ``end`` is far beside it.

    Glass that is not round about its axis imitates another foot, and with it another radius, while the camera stays.
    """
    if task.knows_centre:
        return []
    state, problem = end.state, end.marginal.problem
    bench, at = problem.bench, problem.bench.layout.places(CENTRE)
    foot, middle = state.shared[at], bench.stars.target_mm.mean(axis=0)
    beside = float(np.hypot(*(foot[:2] - middle)))
    if beside < _BESIDE * foot[2]:
        return []
    expect(1)
    shared = state.shared.copy()
    shared[at] = *middle, np.hypot(foot[2], beside)  # what lies in the middle stays as far away
    moved = bench.aligned(replace(state, shared=shared), end.marginal.equations.weights)
    return [_square_or_stretched(*task.posed_at(moved, problem))]


def _square_or_stretched(problem: Problem, near: State) -> Optimum:
    """Return the optimum near a state. If pixels are oblong there: the more probable of square and stretched ones."""
    stretched = ((ASPECT, WRONG),)
    if not _is_stretched(problem, near):
        return search(problem, near)
    try:
        square = search(problem, near)
    except (NotConverged, np.linalg.LinAlgError):
        return search_with_fault(problem, near, stretched)
    with suppress(NotConverged, np.linalg.LinAlgError):
        there = search_with_fault(problem, near, stretched, square.eta)
        return there if odds_of(there, stretched, square) > 1.0 else square
    return square


def _is_stretched(problem: Problem, near: State) -> bool:
    """Tell whether pixels are so oblong at a state that equations there do not hold for square ones."""
    square = problem.knowledge.witnesses[ASPECT]
    return float(np.abs(square.values - square.rows @ near.shared).max()) > TRUSTED


def _approached(problem: Problem, start: State, task: Task) -> State:
    """Return a state near the optimum. The certificate is used only if nothing can be solved without it.

    One whose radius is far from what the views alone show is another collimator's, and is refused: camera, lens and
    fields would take up even twice the radius.
    """
    equations, knowledge = first_equations(problem, start), problem.knowledge
    others = tuple(statement for statement in knowledge.statements if statement.name != CERTIFICATE)
    problem = replace(problem, faults=_NEARLY_SQUARE)
    free = replace(problem, knowledge=replace(knowledge, statements=others))
    try:
        near = approached(free, start, equations)
        passport = task.options.passport
        if passport is not None and passport.is_certificate:
            stated_mm = passport.values_by_name["r"]
            if _is_far(free, near, stated_mm):
                alone = search(free, near)
                near = alone.state
                if _is_far(free, near, stated_mm):
                    near = _more_probable_end(problem, start, alone)
    except (NotConverged, np.linalg.LinAlgError):
        return approached(problem, start, equations)
    return near


def _is_far(free: Problem, near: State, stated_mm: float) -> bool:
    """Tell whether a certified radius is so far from that of a state that it may be another collimator's."""
    seen_mm = float(near.shared[free.bench.layout.index["r"]])
    return abs(stated_mm - seen_mm) > _OTHER_RADIUS * seen_mm


def _more_probable_end(problem: Problem, start: State, alone: Optimum) -> State:
    """Return the more probable of two ends of a search: with the certificate, and ``alone``, without it.

    If the views hardly determine the radius, the search without it can end far from the camera. `_DeniedError` if the
    views are clearly less probable with the certificate.
    """
    try:
        held = search(problem, approached(problem, start, first_equations(problem, start)))
    except (NotConverged, np.linalg.LinAlgError):
        raise _DeniedError(alone) from None
    if _is_less_probable(held, alone):
        raise _DeniedError(alone)
    return held.state if _less_probable_by(held, alone) < 0.0 else alone.state


def _less_probable_by(held: Optimum, alone: Optimum) -> float:
    """Return by how much -2 log of the likelihood is higher with the certificate."""
    try:
        return value_as_weighed(held, alone) - alone.at_best.solution.value
    except np.linalg.LinAlgError:
        return math.inf


def _is_less_probable(held: Optimum, alone: Optimum) -> bool:
    """Tell whether the certificate is more probably another collimator's: all octaves of a radius are as probable."""
    radius_mm = float(alone.state.shared[alone.marginal.problem.bench.layout.index["r"]])
    return _less_probable_by(held, alone) > 2.0 * math.log(radius_mm / ANOTHER_THING.odds)


def _of_another_collimator(alone: Optimum, task: Task) -> InputMismatch:
    """Return the error for a certificate that is not of this collimator, or of views whose ids are shifted."""
    assert task.options.passport is not None
    stated_mm = float(task.options.passport.values_by_name["r"])
    layout = alone.marginal.problem.bench.layout
    again = partial(adjust, options=replace(task.options, passport=None), pupil=layout.bench.pupil)
    shifted = find_shifted_ids(alone, task.views, again)
    r_mm = float(alone.state.shared[layout.index["r"]])
    why = (
        cause_sentence(shifted)
        if shifted
        else (
            f"The pitch of the target is probably {stated_mm / r_mm:.3g} times the stated one, or another target "
            "is in the collimator. A certificate of another collimator looks the same."
        )
    )
    return InputMismatch(
        f"The certificate of the collimator says {stated_mm:.6g} mm; the views alone show about {r_mm:.3g} mm. {why}",
        remedy="" if shifted else "Check pitch and target, then the certificate.",
    )
