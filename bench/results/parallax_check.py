"""Check that does not influence a result: where the entrance pupil is, and the parallax that follows.

The rims of the beam show how far the entrance pupil is off the pivot (`calib.studies.parallax`). The defocus comes from
the station, or from the calibration if its model has it. The function returns plain data for results.json.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.stations.station import Station
from calib.engine import Calibration
from calib.errors import CalibrationError
from calib.studies.parallax import Parallax, PupilWalk, pupil_walk
from calib.view import View

PARALLAX_TEST = "Parallax test"
"""Name of the shipped sequence that must have a result here, or say why there is none."""

#: The station's place of the pupil is contradicted from this many standard uncertainties on.
_CONTRADICTED = 2.5


def parallax_check(
    calibration: Calibration, views: Sequence[View], station: Station, sequence: str
) -> dict[str, Any] | None:
    """Measure how far the entrance pupil is off the pivot, and what parallax that causes.

    views: Views of the calibration, in its order.
    station: The station; it may state the defocus of the collimator and the place of the pupil.
    Returns: As docs/results.md describes it. If the rims do not determine the place of the pupil: ``why_not``
      alone for the parallax test, None for other sequences.
    """
    if calibration.collimator is None:
        why_not = "The planar model has no collimator, so the motion of the beam's disc has no scale. Use model: auto."
        return {"why_not": why_not} if sequence == PARALLAX_TEST else None
    try:
        walk = pupil_walk(views, calibration.rotations, calibration.collimator)
    except CalibrationError as error:
        return {"why_not": str(error)} if sequence == PARALLAX_TEST else None
    parallax = _parallax(walk, calibration, station)
    return {
        "walk_mm": walk.walk_mm.tolist(),
        "walk_covariance_mm2": walk.covariance_mm2.tolist(),
        "pupil_off_pivot_mm": {"value": walk.pupil_off_pivot_mm, "sigma": walk.sigma_mm},
        "axes_differ": walk.axes_differ,
        "difference_in_sigmas": walk.difference_in_sigmas,
        "without_rim": list(walk.without_rim),
        "station_entry": walk.station_entry,
        "stated_mm": _stated(station),
        "defocus": None
        if parallax is None
        else {
            "value": parallax.bound.defocus,
            "sigma": parallax.bound.defocus_sigma,
            "source": parallax.defocus_source,
        },
        "parallax": None if parallax is None else {"value": parallax.share, "sigma": parallax.share_sigma},
        "fx_px": None if parallax is None else {"value": parallax.fx_px, "sigma": parallax.fx_sigma_px},
        "says": [*walk.says(), *_for_station(walk, station), *_effect(parallax)],
    }


def _parallax(walk: PupilWalk, calibration: Calibration, station: Station) -> Parallax | None:
    """Return the parallax by the station's defocus, or by that of the calibration; None if neither has one."""
    names, stated = calibration.parameter_names, station.collimator.defocus
    if stated is not None:
        defocus, sigma, source = stated.value, stated.sigma, "station"
    elif "pupil_shift" in names:
        defocus = float(calibration.values[names.index("pupil_shift")])
        sigma, source = calibration.sigma["pupil_shift"], "calibration"
    else:
        return None
    assert calibration.collimator is not None
    return walk.parallax(
        defocus, sigma, source=source, r_mm=calibration.collimator.r, fx_px=calibration.camera.fx
    )


def _stated(station: Station) -> dict[str, float] | None:
    """Return the place of the pupil that the station states, mm."""
    off = station.gimbal.pupil_off_pivot_mm if station.gimbal is not None else None
    return None if off is None else {"value": off.value, "sigma": off.sigma}


def _for_station(walk: PupilWalk, station: Station) -> list[str]:
    """Return how the place of the pupil agrees with the station file, and what to write into it."""
    stated = _stated(station)
    if stated is None:
        return [walk.advice]
    sigmas = _difference_in_sigmas(walk, stated["value"], stated["sigma"])
    agrees = sigmas <= _CONTRADICTED
    compared = (
        f"This {'agrees with' if agrees else 'contradicts'} the station file, which states {stated['value']:g} mm, "
        f"standard uncertainty {stated['sigma']:g} mm (largest difference: {sigmas:.1f} standard uncertainties)."
    )
    if agrees and stated["sigma"] <= walk.sigma_mm:
        return [f"{compared} The value of the station file is the more accurate one: keep it."]
    return [compared, walk.advice]


def _difference_in_sigmas(walk: PupilWalk, value: float, sigma: float) -> float:
    """Return the largest difference from a stated place of the pupil: along x, along y, and of both together."""
    off = np.array([*-walk.walk_mm, walk.pupil_off_pivot_mm])
    sigmas = np.array([*walk.walk_sigma_mm, walk.sigma_mm])
    return float((np.abs(off - value) / np.hypot(sigmas, sigma)).max())


def _effect(parallax: Parallax | None) -> list[str]:
    """Return what the parallax does to fx, or what is missing to calculate it."""
    if parallax is None:
        return [
            (
                "The parallax also needs the defocus of the collimator, which the station file does not state "
                "(collimator: {defocus: {value: ..., sigma: ...}})."
            )
        ]
    bound = parallax.bound
    by = "the station file" if parallax.defocus_source == "station" else "this calibration"
    says = (
        f"With a defocus of {bound.defocus:.2g}, standard uncertainty {bound.defocus_sigma:.2g} (by {by}), the "
        f"parallax is {100 * parallax.share:.2g} % of the turn, standard uncertainty "
        f"{100 * parallax.share_sigma:.2g} %. Without a correction for it, readings of the gimbal change fx by "
        f"{parallax.fx_px:.2g} px, standard uncertainty {parallax.fx_sigma_px:.2g} px."
    )
    return [says]
