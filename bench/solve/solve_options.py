"""How a solve step is calibrated: its options, passport and gimbal readings, the same for a run and its repetitions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np

from bench.measure.expected_grid import engine_angles_deg
from bench.plan.passports import determines_one_view
from bench.record import results
from bench.stations.station import OfflineStation, Station
from calib.calibration import Calibration, CalibrationOptions
from calib.errors import DegenerateViews
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.result_parts import WORST_CORNER
from calib.model.target_focus import TargetFocus
from calib.uncertainty.projection_uncertainty import projection_uncertainty
from calib.view import View
from sequences.script import SolveStep

if TYPE_CHECKING:
    from bench.plan.job import Job

NO_SECTION = (
    "The station file has no gimbal section, so the uncertainty of the gimbal's readings is not known."
)
ONE_VIEW = (
    "With a passport of this collimator (`starbench passport make`), one view is enough: on the published recordings "
    "it gives the focal length to about 3 px of 2409 px. With a certificate, which states the focal length of the "
    "collimator alone, two views are enough."
)


def solve_options(
    job: Job, step: SolveStep, measured_deg: Sequence[Mapping[str, float]]
) -> CalibrationOptions:
    """Return the engine's options of a solve step: with passport, readings, the station's budget and radial prior."""
    from bench.plan.job import calibration_options

    station = job.station
    readings = None if step.readings == "witness" else gimbal_readings(station, measured_deg)
    return with_statements(calibration_options(step, job.plan.passport_for(step), readings), station)


def with_statements(options: CalibrationOptions, station: OfflineStation) -> CalibrationOptions:
    """Return options with what a station states besides passport and readings: budget, radial prior and focus."""
    budget = station.budget.terms(station.collimator)
    radial_sigma, focus = stated_radial_sigma(station), stated_focus(station)
    return replace(options, budget=budget, radial_sigma=radial_sigma, focus=focus)


def stated_focus(station: OfflineStation) -> TargetFocus | None:
    """Return what the station states of the target's focus and of the pupil's place; None if nothing."""
    defocus, pupil = station.collimator.defocus, station.collimator.pupil_to_focus_mm
    if defocus is None and pupil is None:
        return None
    return TargetFocus(*((stated.value, stated.sigma) if stated else None for stated in (defocus, pupil)))


def stated_radial_sigma(station: OfflineStation) -> float | None:
    """Return the prior of the target's radial term, no unit, from bow and distortion; None if the station lacks one."""
    collimator, expected = station.collimator, station.expected
    certificate = collimator.certificate
    radii = (
        getattr(certificate, "r_mm", None),
        collimator.nominal_r_mm,
        expected.r_mm if expected is not None else None,
    )
    r_mm = next((radius for radius in radii if radius is not None), None)
    return None if r_mm is None else station.budget.radial_sigma(r_mm)


def require_enough_views(views: Sequence[View], options: CalibrationOptions, *, board: bool) -> None:
    """Refuse one view without a passport (there is none for a ``board``) that holds the collimator's centre."""
    if len(views) == 1 and not (options.passport and determines_one_view(options.passport)):
        remedy = (
            "Show the board at more angles."
            if board
            else f"Record the target from more angles, each in a file of its own. {ONE_VIEW}"
        )
        raise DegenerateViews("1 view given; at least 2 needed.", remedy=remedy)


def gimbal_readings(station: Station, measured_deg: Sequence[Mapping[str, float]]) -> GimbalReadings | None:
    """Return the gimbal's readings, encoders first, with uncertainty; None if the station does not state it."""
    gimbal, defocus = station.gimbal, station.collimator.defocus
    if gimbal is None:
        return None
    off = gimbal.pupil_off_pivot_mm
    bound = (
        ParallaxBound(defocus.value, defocus.sigma, off.value, off.sigma, gimbal.pupil_beside_axes_mm)
        if defocus is not None and off is not None
        else None
    )
    return GimbalReadings(
        tuple(map(engine_angles_deg, measured_deg)),
        gimbal.reading_sigma_deg,
        gimbal.scale_sigma,
        gimbal.eccentricity_deg,
        bound,
        gimbal.source,
    )


def limited_numbers(calibration: Calibration) -> dict[str, float]:
    """Return the numbers that a solve step's limits judge: ``rms mean sigma_... expanded_fx ... worst_corner``.

    U = k u (JCGM 100:2008, 6.2.1); corners by the camera's covariance, along the worst direction.
    """
    numbers = {"rms": calibration.rms_px, "mean": calibration.mean_px}
    numbers |= {f"sigma_{name}": value for name, value in calibration.sigma.items()}
    numbers |= {f"expanded_{name}": calibration.U[name] for name in ("fx", "fy")}
    corners = projection_uncertainty(calibration.camera, calibration.camera_covariance).sigma_px
    k = calibration.coverage_factors.get(WORST_CORNER, calibration.coverage_factor)
    numbers[WORST_CORNER] = k * float(np.nanmax(corners[[0, 0, -1, -1], [0, -1, 0, -1]], initial=0.0))
    return numbers


def readings_result(
    calibration: Calibration, options: CalibrationOptions, *, witness: bool = False, stated: bool = True
) -> results.ReadingsUse:
    """Return what results.json states about the gimbal's readings: whether they entered, and what bounds them."""
    readings = options.gimbal
    entered = calibration.gimbal is not None and calibration.gimbal.entered
    statement = None
    if readings is not None:
        statement = results.ReadingsStatement(
            readings.source, readings.reading_sigma_deg, readings.scale_sigma, readings.eccentricity_deg
        )
    return results.ReadingsUse(
        entered,
        statement,
        _bound(calibration, readings),
        None if entered else _why_not(calibration, readings, witness=witness, stated=stated),
    )


def _bound(calibration: Calibration, readings: GimbalReadings | None) -> results.Numbers | None:
    bound = readings.parallax if readings else None
    if bound is None:
        return None
    stated = asdict(bound)
    if calibration.collimator is None:
        return stated
    parallax, sigma = bound.mean_and_sigma(calibration.collimator.r)
    return {**stated, "parallax": parallax, "parallax_sigma": sigma}


def _why_not(
    calibration: Calibration, readings: GimbalReadings | None, *, witness: bool, stated: bool
) -> str:
    if witness:
        return "The sequence keeps them out of the adjustment (readings: witness)."
    if readings is None or not stated:
        return NO_SECTION
    if calibration.model == "planar":
        return "The planar model frees the centre of each view, so readings do not determine it."
    if calibration.model == "spherical":
        return "The spherical model is a method of reference: it uses no readings."
    gimbal = calibration.gimbal
    if gimbal is None:
        return "They took no part in this calibration. Its notes give the reason."
    return (
        f"They contradict the stars: {gimbal.rms_deg:.2g} degrees RMS, chi-square {gimbal.chi_square:.4g} with "
        f"{gimbal.degrees_of_freedom} degrees of freedom. Check the station's gimbal section, the signs and scales of "
        "the axes, and the collimator's passport."
    )
