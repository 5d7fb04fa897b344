"""The problem: from views and options to unknowns, statements and a first state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.adjustment.initialization import initialized, with_distorted_glass
from calib.adjustment.parameters import AdjustmentParameters
from calib.calibration import CalibrationOptions
from calib.joint import amplitudes as amp
from calib.joint.effects import rim
from calib.joint.effects.by_turn import Aside, Parallax
from calib.joint.effects.effect import Circumstances, PoseBasis
from calib.joint.equations import Bench, State, sines_of, turns_of
from calib.joint.fields import FIELD_RADIUS, FieldBasis, basis_of
from calib.joint.knowledge import gather, stated_names, term_shapes, wavefront
from calib.joint.layout import Layout
from calib.joint.marginal import Problem
from calib.joint.poses import Poses
from calib.joint.pupils import LEVER_BY_HAND, lever_of, pupils_of
from calib.joint.readings import Readings
from calib.joint.stars import Stars
from calib.model.camera import PINHOLE, SKEW
from calib.model.collimator import Collimator
from calib.model.gimbal import SCALES
from calib.model.lens import BROWN, FISHEYE, R8, is_fisheye
from calib.model.passport import Passport
from calib.view import View, times_of


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
    """Return the best of the closed forms, refined on a share of the stars, with radial distortion of the glass.

    The radius is free then: distortion would take up that of another collimator's certificate.
    """
    bundle, start = initialized(views, _first_lens(lens), options.passport)
    if options.passport is not None and not options.passport.is_certificate:
        return start
    free = dict.fromkeys((*bundle.names, "r"))
    return with_distorted_glass(replace(bundle, names=tuple(free)), start)


def held_parameters(views: Sequence[View], radius_mm: float, lens: Sequence[str]) -> AdjustmentParameters:
    """Return the same for a radius that is held."""
    return with_distorted_glass(*initialized(views, _first_lens(lens), Passport.of_radius(radius_mm, 0.0)))


def _first_lens(lens: Sequence[str]) -> tuple[str, ...]:
    return tuple(name for name in lens if name in ("k1", "k2", "kb1", "kb2"))


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
    values |= centre.to_dict()
    shared = np.zeros(len(layout.names))
    shared[layout.places(tuple(values))] = list(values.values())
    shared[layout.places([name for name in circumstances.gimbal if name in SCALES])] = 1.0
    rims = [discs.of_views[pose] for pose in poses] if discs else []
    bench = Bench(
        layout,
        views[0].image_size,
        Stars.of(views, basis, rims),
        poses,
        times_of(views),
        readings,
        turns,
        axes,
        pupils.shown if pupils else sines_of(turns),
    )
    hyper = amp.hyperprior(
        lever, pupil, passport=bool(layout.bench.passport), star_px=bench.stars.usual_sigma_px
    )
    gimbal = readings.start(start.rotations) if readings else None
    state = State(shared, np.zeros((bench.n_poses, len(layout.own.places))), start.rotations, gimbal)
    wander = discs.wander if discs and pupil is not amp.Pupil.HELD else -np.inf
    knowledge = gather(options, layout, views[0].image_size, values)
    return Problem(bench, knowledge, hyper, pupils, wander), state


class Task(NamedTuple):
    """What a search is given, whatever its start."""

    views: Sequence[View]
    options: CalibrationOptions
    lens: tuple[str, ...]
    seen: Poses

    @property
    def knows_centre(self) -> bool:
        """Whether a passport states the centre, and all of the glass."""
        passport = self.options.passport
        return passport is not None and not passport.is_certificate

    def posed(self, start: AdjustmentParameters) -> tuple[Problem, State]:
        """Return the problem and its first state."""
        return posed(self.views, self.options, start, self.lens, self.seen)

    def posed_at(self, near: State, problem: Problem) -> tuple[Problem, State]:
        """Return the problem about a state of another one, and its first state there: fields begin again at zero.

        Rotations and centre fit what shifts the image, in shares of the reference radius.
        """
        before = problem.bench.layout
        named = dict(zip(before.names, near.shared.tolist(), strict=True))
        camera, centre = problem.bench.camera(near.shared), Collimator(named["x"], named["y"], named["r"])
        offsets = np.zeros((len(near.rotations), 3))
        problem, state = self.posed(AdjustmentParameters(camera, centre, near.rotations, offsets))
        layout = problem.bench.layout
        shifts = layout.places((*layout.names_of(Aside), *layout.names_of(Parallax)))
        state.shared[shifts] = before.basis.reference[2] / layout.basis.reference[2] * near.shared[shifts]
        return problem, state
