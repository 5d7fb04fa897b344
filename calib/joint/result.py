"""The posterior as a `Calibration`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array
from calib.calibration import Calibration, CalibrationOptions, ViewSummary, rms_and_mean
from calib.diagnosis.gross_stars import GrossStars, used_stars
from calib.joint import amplitudes as amp
from calib.joint.boresight import boresight
from calib.joint.effects.collimator import CENTRE, COMMON_PLACES, FIELD, RADIAL
from calib.joint.effects.gimbal import ENCODER
from calib.joint.explanations import posterior_of, shifted_ids, with_doubted_bound
from calib.joint.fields import FIELD_RADIUS
from calib.joint.knowledge import CHANGED_FIELD, FREE_SCALE, READINGS
from calib.joint.left_out import left_out_rms, rotation_errors
from calib.joint.posterior import Posterior
from calib.joint.readings import MOST_SCATTER
from calib.joint.reported import as_seen, without_r8
from calib.joint.solve import moved
from calib.joint.stars import Stars, robust_weights
from calib.joint.summary import summarised
from calib.joint.unsteady_focus import unsteady_focus
from calib.joint.words import notes, require_determined
from calib.joint.wrong_views import find_other_origins
from calib.model.cause import Cause
from calib.model.collimator import Collimator
from calib.model.gimbal import SCALES
from calib.model.passport import Passport
from calib.model.result_parts import Amplitude, GimbalEstimate, Witness
from calib.progress import begin
from calib.view import View

#: Amplitudes that are given in microradians of a direction; all others are factors or coefficients.
_DIRECTIONS = (*amp.POSE, *amp.COMMON, *amp.TURN, *amp.TURN_2, amp.CHANGE)
#: The radius holds the scale of the common field of a passport. That is 0 to so much, far below any other uncertainty.
_NO_SCALE = 1e-8
#: Nor if a scale differs by this many times what a wrong statement is expected to.
_FARTHEST_SCALE = 3.0


def calibrate_jointly(
    views: Sequence[View], options: CalibrationOptions, wrong: Sequence[GrossStars]
) -> Calibration:
    """Return the result; wrong stars take no part, nor do readings of the gimbal that contradict the stars."""
    begin()
    used = used_stars(views, options.guard_band, wrong)
    kept = _kept(views, used)
    adjusted = _adjusted(kept, options)
    focus = None if adjusted.shifted else unsteady_focus(adjusted.posterior)
    if focus is not None and focus.is_sure:
        views = focus.at_middle(views, adjusted.posterior.mean[2:4])
        kept = _kept(views, used)
        adjusted = _adjusted(kept, options)
    posterior, gimbal, entered, shifted = adjusted
    parameters = _parameters(posterior)
    require_determined(posterior, kept, parameters, entered, shifted)
    if focus is not None:
        posterior = replace(posterior, unsteady=focus.beyond(posterior))
    result = _calibration(posterior, views, used, parameters, gimbal)
    from calib.joint.causes import find_causes  # here: it brings scipy, which a forecast does not need

    of_focus = focus.as_cause(kept) if focus else None
    of_views = shifted, of_focus, find_other_origins(posterior.optimum, kept)
    result = replace(result, causes=find_causes(result, posterior, of_views, options))
    return replace(result, notes=notes(result, posterior))


def _kept(views: Sequence[View], used: Sequence[NDArray[np.bool_]]) -> list[View]:
    """Return views with the stars that are used."""
    return [view if own.all() else view.part(own) for view, own in zip(views, used, strict=True)]


class _Adjusted(NamedTuple):
    """The posterior of views."""

    posterior: Posterior
    gimbal: GimbalEstimate | None
    options: CalibrationOptions  # Without readings that did not enter
    shifted: Cause | None  # That ids of views are shifted


def _adjusted(views: Sequence[View], options: CalibrationOptions) -> _Adjusted:
    """Return the posterior of views; a bound of the parallax, and then the readings, have to agree with the stars."""
    posterior = posterior_of(views, options)
    shifted = shifted_ids(posterior.optimum, views, options)
    gimbal = _gimbal(posterior, options)
    if gimbal is not None and gimbal.entered:
        doubted = with_doubted_bound(posterior, views, options, shifted)
        if doubted is not posterior:
            posterior = doubted
            shifted = shifted_ids(posterior.optimum, views, options)
            gimbal = _gimbal(posterior, options)
    if gimbal is not None and not gimbal.entered:
        options = replace(options, gimbal=None)
        posterior = posterior_of(views, options)
        shifted = shifted or shifted_ids(posterior.optimum, views, options)
    return _Adjusted(posterior, gimbal, options, shifted)


def _parameters(posterior: Posterior) -> AdjustmentParameters:
    """Return the posterior's mean. Rotations and gimbal are those that belong to it."""
    optimum, bench = posterior.reported, posterior.optimum.marginal.problem.bench
    seen = as_seen(bench.layout, posterior.mean) @ posterior.mean
    named = dict(zip(bench.layout.names, seen.tolist(), strict=True))
    radial = {name: named[name] for name in RADIAL}
    centre = Collimator(named["x"], named["y"], named["r"], radial, bench.layout.basis.reference)
    best, step = optimum.solution, posterior.mean - optimum.state.shared
    last = moved(optimum.marginal, best.squares, step, best.fields - best.follow @ (step - best.step))
    return AdjustmentParameters(
        bench.camera(posterior.mean), centre, last.rotations, np.zeros((len(last.rotations), 3)), last.gimbal
    )


def _calibration(
    posterior: Posterior,
    views: Sequence[View],
    used: Sequence[NDArray[np.bool_]],
    parameters: AdjustmentParameters,
    gimbal: GimbalEstimate | None,
) -> Calibration:
    bench = posterior.optimum.marginal.problem.bench
    stated = summarised(posterior)
    star = float(np.sqrt(posterior.reported.solution.star_variance))
    residuals, weights = _residuals(posterior, views, used, star)
    lengths = [np.linalg.norm(e[own], axis=1) for e, own in zip(residuals, used, strict=True)]
    rms_px, mean_px = rms_and_mean(np.concatenate(lengths))
    errors = rotation_errors(posterior)
    return Calibration(
        model="joint",
        camera=without_r8(parameters.camera),
        collimator=parameters.collimator,
        rotations=parameters.rotations,
        centres=parameters.centres,
        parameter_names=stated.names,
        estimates=stated.estimates,
        covariance=stated.covariance,
        residuals_px=residuals,
        weights=weights,
        rms_px=rms_px,
        mean_px=mean_px,
        variance_factor=star**2,
        degrees_of_freedom=max(round(posterior.reported.solution.freedom), 1),
        views=tuple(
            ViewSummary(view.name, len(own), *rms_and_mean(own))
            for view, own in zip(views, lengths, strict=True)
        ),
        converged=posterior.optimum.converged,
        iterations=posterior.optimum.iterations,
        birge_ratio=posterior.reported.disagreement,
        coverage_factor=stated.coverage_factors["fx"],
        left_out_rms_px=left_out_rms(posterior.reported),
        rotation_covariance=errors.joint_covariance,
        rotation_errors=errors,
        budget=stated.budget,
        gimbal=gimbal,
        boresight=boresight(posterior, parameters.camera, parameters.gimbal),
        poses=tuple(int(pose) for pose in bench.poses),
        budget_rows=stated.rows,
        witnesses=_witnesses(posterior),
        amplitudes=_amplitudes(posterior),
        coverage_factors=stated.coverage_factors,
        glass=_glass(posterior, views),
    )


def _residuals(
    posterior: Posterior,
    views: Sequence[View],
    used: Sequence[NDArray[np.bool_]],
    star: float,
) -> tuple[list[Array], list[Array]]:
    """Return the residuals of all stars at the mode, and their weights; 0 for stars that were not used."""
    optimum, bench = posterior.reported, posterior.optimum.marginal.problem.bench
    stars = Stars.of(views, bench.layout.basis, bench.stars.discs)
    whole = replace(bench, stars=stars)
    best = optimum.solution
    state = moved(optimum.marginal, best.squares, best.step, best.fields)
    precision = stars.precision(optimum.marginal.equations.rim)
    weights = precision * robust_weights(np.sqrt(precision) * whole.whitened(state), star)
    return stars.of_views(whole.residuals(state)), stars.of_views(np.concatenate(used) * weights)


def _witnesses(posterior: Posterior) -> tuple[Witness, ...]:
    """Return the statements against what all others say."""
    witnesses = []
    for innovation in posterior.innovations():
        statement, together = innovation.statement, len(innovation.statement.values) > 1
        said = statement.values[0], np.sqrt(statement.covariance[0, 0])
        numbers = (*said, innovation.expected[0], innovation.sigma[0])
        stated, sigma, expected, spread = (None if together else float(number) for number in numbers)
        what = innovation.name, statement.source, statement.unit
        witnesses.append(
            Witness(*what, stated, sigma, expected, spread, innovation.normalised, innovation.probability)
        )
    marginal = posterior.optimum.marginal
    if marginal.uses_readings:
        witnesses.append(_size(posterior, READINGS, "station: reading_sigma_deg", amp.READING))
    if amp.CHANGE in marginal.problem.hyper.names:
        witnesses.append(_size(posterior, CHANGED_FIELD, "expected of another pupil", amp.CHANGE))
    return tuple(witnesses)


def _size(posterior: Posterior, name: str, source: str, amplitude: str) -> Witness:
    """Return the witness of errors whose size is expected: how many times as large they are."""
    hyper = posterior.optimum.marginal.problem.hyper
    at = hyper.at(amplitude)
    log_times = float(posterior.optimum.eta[at] - hyper.mean[at])
    width = float(np.sqrt(hyper.covariance[at, at]))
    times = float(np.exp(log_times))
    spread = times * float(posterior.spread[at])
    return Witness(name, source, "times stated", 1.0, width, times, spread, -log_times / width, 0.0)


def _amplitudes(posterior: Posterior) -> tuple[Amplitude, ...]:
    """Return the amplitudes of terms that the adjustment has; fields as directions."""
    hyper, layout = posterior.optimum.marginal.problem.hyper, posterior.optimum.marginal.problem.bench.layout
    answer = []
    for name, eta, spread, middle in zip(
        hyper.names, posterior.optimum.eta, posterior.spread, hyper.mean, strict=True
    ):
        if name == amp.RIM and not layout.pose.about_disc:
            continue
        unit, times = ("urad", 1e6) if name in _DIRECTIONS else ("1", 1.0)
        answer.append(
            Amplitude(name, times * float(np.exp(eta)), float(spread), unit, times * float(np.exp(middle)))
        )
    return tuple(answer)


def _glass(posterior: Posterior, views: Sequence[View]) -> Passport:
    """Return what was found out about the collimator: centre, radial terms, common field, jointly."""
    layout = posterior.optimum.marginal.problem.bench.layout
    names = (*CENTRE, *RADIAL, *(f"{FIELD}{k}" for k in COMMON_PLACES))
    rows = as_seen(layout, posterior.mean)[layout.places(names)]
    field = np.array([name.startswith(FIELD) for name in names])
    return Passport(
        names,
        rows @ posterior.mean,
        rows @ posterior.covariance @ rows.T + np.diag(field * _NO_SCALE**2),
        layout.basis.reference,
        posterior.reported.disagreement,
        tuple(view.name for view in views),
        {FIELD_RADIUS: layout.basis.radius_mm},
    )


def _gimbal(posterior: Posterior, options: CalibrationOptions) -> GimbalEstimate | None:
    """Return the gimbal's parameters and how its readings agree; None without readings."""
    marginal = posterior.optimum.marginal
    bench = marginal.problem.bench
    if bench.readings is None or options.gimbal is None:
        return None
    parameters = _parameters(posterior)
    if parameters.gimbal is None:
        return None
    names, at = bench.gimbal, bench.gimbal_places
    plain = [name in SCALES for name in names]
    unit = np.where(plain, 1.0, np.rad2deg(1.0))
    turns = parameters.gimbal.to_dict()
    values = {
        **dict(zip(names, posterior.mean[at].tolist(), strict=True)),
        **{name: turns[name] for name in names if name in turns},
    }
    sigmas = np.sqrt(np.diag(posterior.covariance)[at])
    reading = marginal.problem.hyper.at(amp.READING)
    times = float(np.exp(posterior.largest.eta[reading]))
    off_scale = max((abs(values[name] - 1.0) for name in names if name in SCALES), default=0.0)
    entered = times < MOST_SCATTER and off_scale < _FARTHEST_SCALE * max(
        options.gimbal.scale_sigma, FREE_SCALE
    )
    off = bench.readings.off(parameters.gimbal, values, parameters.rotations)
    if not entered:  # the mean may hold other scales instead
        times = float(np.exp(posterior.optimum.eta[reading]))
        off = bench.readings_off(posterior.optimum.state)
    stated = [
        (name, u) for name, u in zip(names, unit, strict=True) if entered and not name.startswith(ENCODER)
    ]
    return GimbalEstimate(
        entered=entered,
        values={name: float(u * values[name]) for name, u in stated},
        sigma={name: float(u * sigmas[names.index(name)]) for name, u in stated},
        chi_square=float((off**2).sum()) / bench.readings.sigma_rad**2,
        degrees_of_freedom=max(off.size - 6, 1),
        rms_deg=float(np.rad2deg(np.sqrt((off**2).sum(axis=1).mean()))),
        reading_sigma_deg=times * options.gimbal.reading_sigma_deg,
        scatter=times,
        source=options.gimbal.source,
    )
