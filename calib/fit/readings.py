"""The fit with the gimbal's readings: their weight against the stars, and whether they contradict them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss, Refinement, refine
from calib.adjustment.readings import ReadingsTest, add_readings, check_readings, with_turns
from calib.calibration import CalibrationOptions
from calib.fit.robust import refine_robustly
from calib.model.beam import Disc
from calib.uncertainty.covariance import covariance_at_optimum
from calib.uncertainty.passport_propagation import certificate_prior
from calib.view import View

#: Readings that scatter more than this many times as much as stated do not enter.
MAX_READING_SCATTER = 5.0
_READING_ROUNDS = 4
_TURN_ROUNDS = 2


def with_readings(
    views: Sequence[View],
    discs: Sequence[Disc],
    bundle: Bundle,
    refined: Refinement,
    loss: Loss,
    options: CalibrationOptions,
) -> tuple[Bundle, Refinement, Loss, ReadingsTest]:
    """Adjust again with the gimbal's readings; without them if they contradict the stars.

    Readings that scatter somewhat more than stated get less weight (Birge, 1932).

    discs: Their visible discs; empty if the model needs none.
    bundle, refined, loss: The adjustment without readings: its bundle, its end, and its loss.
    """
    stated = options.gimbal
    assert stated is not None
    readings, passport = stated, options.passport
    radius = certificate_prior(passport, options.budget) if passport and passport.is_certificate else None
    for _ in range(_READING_ROUNDS):
        joint, start = add_readings(views, discs, bundle, refined.parameters, readings, radius)
        for _ in range(_TURN_ROUNDS):
            joint, together, limit = refine_robustly(joint, start, options)
            start = together.parameters
            joint = with_turns(views, discs, joint, start)
        joint, together = _balanced(joint, replace(together, parameters=start), limit, options)
        test = check_readings(joint, together.parameters, stated)
        if not test.contradicted:
            return joint, together, limit, test
        if test.scatter * test.times_stated > MAX_READING_SCATTER:
            break
        readings = replace(readings, reading_sigma_deg=test.scatter * readings.reading_sigma_deg)
    return bundle, refined, loss, test


def _balanced(
    bundle: Bundle, refined: Refinement, loss: Loss, options: CalibrationOptions
) -> tuple[Bundle, Refinement]:
    """Give readings and priors more weight against stars whose views are inconsistent, and adjust again.

    The errors of a collimator are common to neighbouring stars, so the views know less than their many stars suggest.
    The Birge ratio (Birge, 1932) says how much less.
    """
    estimate = covariance_at_optimum(bundle, refined.parameters, loss)
    if not estimate.inconsistent:
        return bundle, refined
    bundle = replace(bundle, noise_variance=estimate.birge_ratio**2 * bundle.noise_variance)
    return bundle, refine(bundle, refined.parameters, loss, options.max_iterations)
