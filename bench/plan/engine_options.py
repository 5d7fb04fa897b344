"""The options of the calibration engine for a solve step of a sequence."""

from __future__ import annotations

from bench.plan.plan import DEFAULT_MODEL
from calib.calibration import CalibrationOptions
from calib.model.gimbal_readings import GimbalReadings
from calib.model.passport import Passport
from calib.model.type_b_terms import TypeBTerm
from sequences.script import SolveStep


def calibration_options(
    step: SolveStep,
    passport: Passport | None = None,
    gimbal: GimbalReadings | None = None,
    budget: tuple[TypeBTerm, ...] = (),
) -> CalibrationOptions:
    """Return the engine's options for a solve step.

    passport: Passport of the collimator that the step uses (`bench.plan.plan.Plan.passport_for`).
    gimbal: Readings of the gimbal, one for each view, if the step lets them enter the adjustment.
    Returns: Model, distortion, loss, passport, readings, budget, guard band and drift. A step without a model
      is solved with ``auto``.
    """
    passport = passport if step.model != "planar" else None  # it has no collimator
    return CalibrationOptions(
        step.model or DEFAULT_MODEL,
        step.distortion,
        step.loss,
        step.huber_px,
        passport=passport,
        guard_band=step.guard_band,
        drift_mm=step.drift_mm,
        gimbal=gimbal,
        budget=budget,
    )
