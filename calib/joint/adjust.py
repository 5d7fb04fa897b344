"""The door of the joint adjustment: from views and options to its optimum."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from calib.adjustment.initialization import initialized
from calib.adjustment.parameters import AdjustmentParameters, explain_weak_geometry
from calib.calibration import CalibrationOptions
from calib.diagnosis.gross_stars import noise_px
from calib.errors import CalibrationError, DegenerateViews, InputMismatch, NotConverged
from calib.joint import amplitudes as amp
from calib.joint.effects import rim
from calib.joint.effects.by_turn import Aside, Parallax
from calib.joint.effects.effect import Circumstances, PoseBasis
from calib.joint.equations import Bench, State, ViewStars, sines_of, turns_of
from calib.joint.fields import FIELD_RADIUS, FieldBasis, basis_of
from calib.joint.knowledge import (
    ASPECT,
    CERTIFICATE,
    FOCAL,
    WRONG,
    gather,
    stated_names,
    term_shapes,
    wavefront,
)
from calib.joint.layout import Layout
from calib.joint.marginal import Marginal, Problem
from calib.joint.poses import Poses, seen_poses
from calib.joint.posterior import odds_of
from calib.joint.pupils import LEVER_BY_HAND, lever_of, pupils_of, shown_way
from calib.joint.readings import Readings
from calib.joint.solve import (
    Optimum,
    approached,
    beside,
    first_amplitudes,
    first_equations,
    search,
    search_with_fault,
    solved,
    value_as_weighed,
)
from calib.joint.wrong_views import find_shifted_ids
from calib.model.camera import DISTORTION_SETS, PINHOLE, SKEW
from calib.model.collimator import Collimator
from calib.model.gimbal import SCALES
from calib.model.lens import BROWN, FISHEYE, R8, is_fisheye
from calib.model.passport import Passport
from calib.view import View

#: The other family of lenses is taken if twice the logarithm of its odds exceeds this: strong evidence (Kass and
#: Raftery, 1995).
_EVIDENCE = 10.0
#: Tangent of the angle at the sensor's corner from which on the lens must be of the right family: at 45 degrees, three
#: radial terms of the tangent miss a fisheye lens by several U of fx.
_WIDE_FIELD = 0.8
#: A certificate is another collimator's if its radius differs by this share, and by so many sigma, from what the views
#: alone show, even if all errors are larger than expected by 1-sigma: near the optimum, and at it.
_OTHER_RADIUS, _CLEARLY = 0.1, 6.0
#: From this difference on, the state is looked at to which the search leads if the certificate is wrong, or if the
#: pixels are not square.
_OTHER_STATE = 0.02
#: Near the optimum pixels are square to .3 % only, so that images that were stretched are found.
_NEARLY_SQUARE, _STRETCHED = ((ASPECT, "10 times"),), ((ASPECT, WRONG),)
#: A search that ends so far from its start, as a share of the focal length, begins again.
_FAR_START = 0.05
#: Focal lengths of further starts, as shares of the image's diagonal: octaves from a wide-angle lens to a telephoto
#: lens. A search finds the optimum from .5 to 1.4 times the true one.
_FOCAL_SHARES = (0.5, 1.0, 2.0, 4.0, 8.0)
#: The stars are explained if they scatter by no more than so many times what neighbouring stars show, and the readings
#: if they do by no more than so many times what is stated. On nine ray-traced benches of another author, right ends
#: have 1.1 and .9 at most; ends at another camera have 1.24, or readings that are off by more than 1000 times.
_AS_NEIGHBOURS, _AS_STATED = 1.15, 3.0
#: Starts are compared by so many stars a view, or more.
_COMPARISON_STARS = 50
#: Limit of the stars' weights, in sigmas, so that none counts as an outlier.
_WIDE = 1e3


class _End(NamedTuple):
    """The end of a search."""

    optimum: Optimum
    near: State  # What the views alone show, near the optimum


def lens_names(chosen: Sequence[str]) -> tuple[str, ...]:
    """Return the coefficients that are estimated: the whole family, and those of the denominator only if asked for.

    With a denominator there is no term of r^8, which it would imitate.
    """
    if is_fisheye(dict.fromkeys(chosen, 0.0)):
        return FISHEYE
    wanted = {*BROWN[:5], *chosen}
    further = () if wanted & set(BROWN[5:]) else (R8,)
    return tuple(name for name in (*BROWN, SKEW) if name in wanted) + further


def first_parameters(
    views: Sequence[View], options: CalibrationOptions, lens: Sequence[str]
) -> AdjustmentParameters:
    """Return the best of the closed forms, refined on a share of the stars."""
    few = tuple(name for name in lens if name in ("k1", "k2", "kb1", "kb2"))
    return initialized(views, few, options.passport)[1]


def posed(
    views: Sequence[View],
    options: CalibrationOptions,
    start: AdjustmentParameters,
    lens: Sequence[str],
    seen: Poses,
) -> tuple[Problem, State]:
    """Return the problem and its first state."""
    passport = options.passport
    centre = start.collimator
    reference = (centre.x, centre.y, centre.r)
    if passport is not None and passport.reference is not None:
        reference = passport.reference
    radius = passport.conditions.get(FIELD_RADIUS) if passport is not None else None
    basis = FieldBasis(reference, float(radius)) if radius else basis_of(views, reference)
    poses, discs, pupil = seen
    readings = Readings.of(options.gimbal) if options.gimbal else None
    bound = options.gimbal.parallax if options.gimbal else None
    names = (*PINHOLE, *lens)
    turns, axes = turns_of(start.rotations, poses)
    pupils = pupils_of(discs, centre.r) if discs and pupil is amp.Pupil.BY_HAND else None
    moving = discs if pupil is amp.Pupil.WALKS else None
    lever = LEVER_BY_HAND if pupils else lever_of(moving, turns, centre.r, bound)
    circumstances = Circumstances(
        pupil,
        amp.times_as_far(lever, pupil),
        corner=0.5 * float(np.hypot(*views[0].image_size)) / start.camera.fx,
        reach=float(np.hypot(*(turns - turns.mean(axis=0)).T).max()),
        n_poses=int(poses.max()) + 1,
        parallax_known=bound is not None,
        terms=term_shapes(options.budget, basis),
        wavefront=wavefront(options.budget),
        gimbal=readings.names if readings else (),
        reading_rad=readings.sigma_rad if readings else 0.0,
    )
    layout = Layout(PoseBasis(names, basis, 0 if pupil is amp.Pupil.HELD else rim.NUMBER), circumstances)
    if passport is not None:
        layout = layout.with_passport(stated_names(passport))
    values = {name: start.camera.to_dict().get(name, 0.0) for name in names}
    values |= {"x": centre.x, "y": centre.y, "r": centre.r}
    shared = np.zeros(len(layout.names))
    shared[layout.places(tuple(values))] = list(values.values())
    shared[layout.places([name for name in circumstances.gimbal if name in SCALES])] = 1.0
    hyper = amp.hyperprior(lever, pupil, passport=bool(layout.bench.passport))
    rims = [discs.of_views[pose] for pose in poses] if discs else []
    bench = Bench(
        layout,
        views[0].image_size,
        tuple(ViewStars.of(view, layout, disc) for view, disc in zip_longest(views, rims)),
        poses,
        readings,
        turns,
        axes,
        pupils.shown if pupils else sines_of(turns),
        tuple(rims),
    )
    gimbal = readings.start(start.rotations) if readings else None
    state = State(shared, np.zeros((bench.n_poses, len(layout.own.places))), start.rotations, gimbal)
    wander = discs.wander if discs and pupil is not amp.Pupil.HELD else -np.inf
    knowledge = gather(options, layout, views[0].image_size, values)
    return Problem(bench, knowledge, hyper, pupils, wander), state


def adjust(views: Sequence[View], options: CalibrationOptions, pupil: amp.Pupil | None = None) -> Optimum:
    """Return the optimum of the joint adjustment; if the data choose the lens, that of the more probable family.

    In a wide field both families are always tried: there the wrong one moves the focal length. ``pupil`` says how it is
    moved; None: as the visible discs say.
    """
    chosen = lens_names(options.distortion)
    found = _adjusted(views, options, chosen, pupil)
    if not (options.compares_lenses or _is_wide(found)):
        return found
    other_set = "k1k2k3p1p2" if is_fisheye(dict.fromkeys(chosen, 0.0)) else "fisheye"
    try:
        other = _adjusted(views, options, DISTORTION_SETS[other_set], pupil)
    except CalibrationError:  # these views cannot be those of such a lens
        return found
    if found.solution.value - value_as_weighed(other, found) < _EVIDENCE:
        return found
    return other if options.compares_lenses else replace(found, better_lens=other_set)


def adjust_again(
    found: Optimum, views: Sequence[View], options: CalibrationOptions, pupil: amp.Pupil
) -> Optimum:
    """Return the optimum with the same lens if the pupil is moved in another way."""
    return _adjusted(views, options, found.marginal.problem.bench.layout.pose.camera[len(PINHOLE) :], pupil)


def _is_wide(found: Optimum) -> bool:
    """Tell whether the families of lenses differ in what they can be."""
    bench = found.marginal.problem.bench
    return 0.5 * float(np.hypot(*bench.image_size)) > _WIDE_FIELD * float(found.state.shared[0])


def _adjusted(
    views: Sequence[View], options: CalibrationOptions, lens: tuple[str, ...], pupil: amp.Pupil | None
) -> Optimum:
    """Return the optimum with one family of the lens; if it cannot be solved, the error says why by the geometry.

    A bound of the parallax says that the pupil is on a gimbal. Then the discs only tell which stars are at the rim.
    """
    start = first_parameters(views, options, lens)
    seen = seen_poses(views, start)
    if seen.discs and (options.gimbal is None or options.gimbal.parallax is None):
        seen = seen._replace(pupil=pupil or shown_way(seen.discs))
    try:
        end = _best_searched(views, options, lens, start, seen)
    except (NotConverged, np.linalg.LinAlgError) as error:
        why = explain_weak_geometry(views, start)
        if not why:
            raise NotConverged("The joint adjustment cannot be solved.") from error
        raise DegenerateViews(
            f"These views do not determine the camera. {why}",
            remedy="Add views turned about other axes, with the stars elsewhere in the image.",
        ) from error
    return _without_wrong_certificate(end.optimum, end.near, options)


def _thinned(view: View) -> View:
    """Return a view with a share of its stars, spread over it: enough to compare starts."""
    return view.part(np.arange(len(view)) % max(1, len(view) // _COMPARISON_STARS) == 0)


def _held_starts(
    views: Sequence[View], options: CalibrationOptions, lens: tuple[str, ...], start: AdjustmentParameters
) -> list[AdjustmentParameters]:
    """Return starts with other focal lengths and the radii that belong to them; those that are no camera are left out.

    The image tells the scale fx / r, px/mm, whatever the two are.
    """
    if options.passport is not None and not options.passport.is_certificate:
        return []  # all of the glass is known
    diagonal, held = float(np.hypot(*views[0].image_size)), []
    for share in _FOCAL_SHARES:
        radius = share * diagonal * start.collimator.r / start.camera.fx
        with suppress(CalibrationError):
            held.append(
                first_parameters(views, replace(options, passport=Passport.of_radius(radius, 0.0)), lens)
            )
    return held


def _value_at(begin: tuple[Problem, State]) -> float:
    """Return -2 log of the likelihood at a start, after one step with errors that are smaller than expected."""
    problem, state = begin
    with suppress(NotConverged, np.linalg.LinAlgError):
        marginal = Marginal(problem, first_equations(problem, state), state)
        return solved(marginal, first_amplitudes(problem, state)).value
    return np.inf


def _approached(problem: Problem, start: State, views: Sequence[View], options: CalibrationOptions) -> State:
    """Return a state near the optimum. The certificate takes no part, unless the views need it.

    One whose radius is far from what the views alone show is another collimator's, and is refused: camera, lens and
    fields would take up even twice the radius.
    """
    equations, knowledge = first_equations(problem, start), problem.knowledge
    others = tuple(one for one in knowledge.statements if one.name != CERTIFICATE)
    problem = replace(problem, faults=_NEARLY_SQUARE)
    free = replace(problem, knowledge=replace(knowledge, statements=others))
    try:
        near = approached(free, start, equations, options.max_iterations)
        stated = _certified_radius(options)
        if stated is not None and _is_far(free, near, stated):
            alone = search(free, near, options.max_iterations)
            near = alone.state
            if _is_far(free, near, stated) and _is_denied(problem, start, alone, options):
                again = partial(
                    adjust, options=replace(options, passport=None), pupil=problem.bench.layout.bench.pupil
                )
                shifted = find_shifted_ids(alone, views, options.max_iterations, again).words
                r_mm = float(near.shared[free.bench.layout.index["r"]])
                why = shifted or (
                    f"The pitch of the target is probably {stated / r_mm:.3g} times the stated one, or another target "
                    "is in the collimator. A certificate of another collimator looks the same."
                )
                raise InputMismatch(
                    f"The certificate of the collimator says {stated:.6g} mm; the views alone show about {r_mm:.3g} "
                    f"mm. {why}",
                    remedy="" if shifted else "Check pitch and target, then the certificate.",
                )
    except (NotConverged, np.linalg.LinAlgError):
        return approached(problem, start, equations, options.max_iterations)
    return near


def _is_denied(problem: Problem, start: State, alone: Optimum, options: CalibrationOptions) -> bool:
    """Tell whether the views are clearly less probable with the certificate, at the state where it is held to."""
    try:
        equations = first_equations(problem, start)
        near = approached(problem, start, equations, options.max_iterations)
        held = search(problem, near, options.max_iterations)
    except (NotConverged, np.linalg.LinAlgError):
        return True
    return held.solution.value - alone.solution.value > _CLEARLY**2


def _certified_radius(options: CalibrationOptions) -> float | None:
    """Return the radius of a certificate, mm; None without one."""
    passport = options.passport
    return passport.values_by_name["r"] if passport is not None and passport.is_certificate else None


def _is_far(free: Problem, near: State, stated: float) -> bool:
    """Tell whether a radius, mm, is not that of a state, even if errors are larger than expected."""
    at = free.bench.layout.index["r"]
    away = abs(stated - float(near.shared[at]))
    if away <= _OTHER_RADIUS * float(near.shared[at]):
        return False
    large = free.hyper.mean + np.sqrt(np.diag(free.hyper.covariance))
    found = solved(Marginal(free, free.bench.linearised(near, _WIDE), near), large)
    return away > _CLEARLY * float(np.sqrt(found.covariance[at, at]))


def _best_searched(
    views: Sequence[View],
    options: CalibrationOptions,
    lens: tuple[str, ...],
    start: AdjustmentParameters,
    seen: Poses,
) -> _End:
    """Return the most probable end of searches: from the closed form, and from another start.

    A closed form follows the errors of a collimator along what the views hardly determine, focal length and radius in
    proportion, and can end at eight times the camera. If its end leaves the stars or the readings unexplained, the best
    start with a held radius is followed, too. Nothing is blamed or left out before.
    """
    failed: Exception | None = None
    best: _End | None = None
    try:
        best = _searched(views, options, lens, start, seen)
        if _explains(best.optimum, views):
            return best
    except (NotConverged, np.linalg.LinAlgError) as error:
        failed = error
    few = [_thinned(view) for view in views]
    held = _held_starts(few, options, lens, start)
    if held:
        other = min(held, key=lambda one: _value_at(posed(few, options, one, lens, seen)))
        with suppress(NotConverged, np.linalg.LinAlgError):
            second = _searched(views, options, lens, other, seen)
            best = second if best is None else _better(best, second)
    if best is None:
        assert failed is not None
        raise failed
    return best


def _explains(found: Optimum, views: Sequence[View]) -> bool:
    """Tell whether the stars fit as neighbours agree with each other, and the readings as stated.

    Then no other camera could explain them better.
    """
    stated = [np.sqrt(0.5 * np.median(np.trace(view.covariances_px2, axis1=1, axis2=2))) for view in views]
    local = float(np.median([noise_px(view) / sigma for view, sigma in zip(views, stated, strict=True)]))
    reading = float(np.exp(found.eta[found.marginal.problem.hyper.at(amp.READING)]))
    return np.sqrt(found.solution.star_variance) <= _AS_NEIGHBOURS * local and reading <= _AS_STATED


def _better(first: _End, second: _End) -> _End:
    """Return the more probable of two ends."""
    value = value_as_weighed(second.optimum, first.optimum)
    return second if value < first.optimum.solution.value else first


def _searched(
    views: Sequence[View],
    options: CalibrationOptions,
    lens: tuple[str, ...],
    start: AdjustmentParameters,
    seen: Poses,
) -> _End:
    """Return the end of a search.

    Fields that grew far from the optimum may keep the search from it. Then it begins again where it ended.
    """
    problem, state = posed(views, options, start, lens, seen)
    near = _approached(problem, state, views, options)
    optimum = _square_or_stretched(*_posed_at(near, problem, views, options, start, seen), options)
    away = np.abs(optimum.state.shared[:2] / near.shared[:2] - 1.0).max()
    if away > _FAR_START:
        there = _posed_at(optimum.state, optimum.marginal.problem, views, options, start, seen)
        with suppress(NotConverged):  # the first end stands
            again = search(*there, options.max_iterations)
            optimum = replace(again, iterations=optimum.iterations + again.iterations)
    return _End(optimum, near)


def _square_or_stretched(problem: Problem, near: State, options: CalibrationOptions) -> Optimum:
    """Return the optimum near a state. Where that has no square pixels, images may have been stretched."""
    rounds = options.max_iterations
    stretched = abs(near.shared[0] / near.shared[1] - 1.0) > _OTHER_STATE
    try:
        optimum = search(problem, near, rounds)
    except (NotConverged, np.linalg.LinAlgError):
        if not stretched:
            raise
        return search_with_fault(problem, near, _STRETCHED, rounds)
    if stretched:
        with suppress(NotConverged, np.linalg.LinAlgError):
            there = beside(optimum, _STRETCHED, rounds, near)
            return there if odds_of(there, _STRETCHED, optimum) > 1.0 else optimum
    return optimum


def _posed_at(
    near: State,
    problem: Problem,
    views: Sequence[View],
    options: CalibrationOptions,
    start: AdjustmentParameters,
    seen: Poses,
) -> tuple[Problem, State]:
    """Return the problem about a state of another one, and its first state there: fields begin again at zero.

    Rotations and centre fit what shifts the image, in shares of the reference radius.
    """
    before = problem.bench.layout
    named = dict(zip(before.names, near.shared.tolist(), strict=True))
    camera, centre = problem.bench.camera(near.shared), Collimator(named["x"], named["y"], named["r"])
    there = AdjustmentParameters(camera, centre, near.rotations, start.offsets)
    lens = before.pose.camera[len(PINHOLE) :]
    problem, state = posed(views, options, there, lens, seen)
    layout = problem.bench.layout
    shifts = layout.places((*layout.names_of(Aside), *layout.names_of(Parallax)))
    state.shared[shifts] = before.basis.reference[2] / layout.basis.reference[2] * near.shared[shifts]
    return problem, state


def _without_wrong_certificate(found: Optimum, near: State, options: CalibrationOptions) -> Optimum:
    """Return the optimum that the views show without the certificate, if it is the more probable one.

    Large own errors of the poses would take up a certificate that is wrong by several percent.
    """
    stated, seen = (
        _certified_radius(options),
        float(near.shared[found.marginal.problem.bench.layout.index["r"]]),
    )
    if stated is None or abs(stated - seen) <= _OTHER_STATE * seen:
        return found
    certificate = found.marginal.problem.knowledge.witnesses[CERTIFICATE]
    faults = ((CERTIFICATE, WRONG if certificate.focal is None else FOCAL),)
    try:
        there = beside(found, faults, options.max_iterations, near)
        return there if odds_of(there, faults, found) > 1.0 else found
    except (NotConverged, np.linalg.LinAlgError):
        return found
