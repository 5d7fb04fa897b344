"""Checks that do not influence a result: split half, hand-eye against the gimbal's readings, faces, entrance pupil.

Each check returns plain data for results.json, or None if there are too few poses for it. Pure: it reads no file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from bench.measure.expected_grid import engine_angles_deg
from bench.record.results import GimbalComparison, Halves, MountFace, Numbers, ParallaxData
from bench.stations.station import Station
from bench.stations.station_budget import GimbalConfig
from bench.wording.numbers import exact, number
from calib.calibration import REFERENCE_MODELS
from calib.diagnosis.hand_eye import check_hand_eye
from calib.diagnosis.hand_eye_result import AGREES
from calib.diagnosis.weighed_suspects import Found
from calib.engine import Calibration, CalibrationOptions
from calib.errors import CalibrationError
from calib.model.cause import LARGEST_EVIDENCE, SLIPPED
from calib.model.gimbal_readings import AXES
from calib.studies.camera_check import split_half
from calib.studies.parallax import Parallax, PupilWalk, pupil_walk
from calib.view import View, times_of

_NOT_INDEPENDENT = (
    "The readings also entered the calibration, so this comparison is not independent of them.",
)
PARALLAX_TEST = "Parallax test"
"""Name of the shipped sequence that must have a result here, or say why there is none."""

#: The station's place of the pupil is contradicted from this many standard uncertainties on: by chance, one in 80 is.
_CONTRADICTED = 2.5


def split_half_check(views: Sequence[View], options: CalibrationOptions) -> Halves | None:
    """Calibrate every other pose and the rest separately; compare the projections of both cameras at infinity.

    ``rms_px worst_px expected_px ratio``; None with fewer than four views, or if a half determines no camera.
    """
    try:
        split = split_half(views, options)
    except CalibrationError:  # too few poses, or a half that constrains nothing: there is no such check then
        return None
    return Halves(split.difference.rms_px, split.difference.worst_px, split.expected_px, split.ratio)


def gimbal_check(
    calibration: Calibration,
    views: Sequence[View],
    readings_deg: Sequence[Mapping[str, float]],
    stated: GimbalConfig | None = None,
) -> GimbalComparison | None:
    """Compare the estimated rotations with the gimbal's readings; ``pan_encoder`` replaces ``pan`` (docs/results.md).

    Within what the station states of the gimbal, nothing is a fault; over few degrees, an eccentricity is a scale.
    None with too few poses, or if an axis did not move.
    """
    try:
        check = check_hand_eye(
            calibration.rotations,
            calibration.rotation_covariance,
            [engine_angles_deg(pose) for pose in readings_deg],
            reading_sigma_deg=stated.reading_sigma_deg if stated else 0.0,
            scale_sigma=math.hypot(stated.scale_sigma, math.radians(stated.eccentricity_deg))
            if stated
            else 0.0,
            # The covariance of the joint adjustment holds that the views differ.
            birge_ratio=calibration.birge_ratio if calibration.model in REFERENCE_MODELS else 1.0,
            names=[view.name for view in views],
            times=times_of(views),
        )
    except CalibrationError:  # too few poses, or axes that did not move
        return None
    entered = calibration.gimbal is not None and calibration.gimbal.entered
    faults = [_fault(found) for found in check.found]
    slips = [fault for fault in faults if fault["kind"] == SLIPPED]
    return GimbalComparison(
        rms_arcsec=check.rms_arcsec,
        scale=check.scale,
        scale_sigma=check.scale_sigma,
        agrees=check.verdict == AGREES,
        excess_arcsec=check.excess_arcsec,
        verdict=check.verdict,
        says=[*check.says, *(_NOT_INDEPENDENT if entered else ())],
        pairs=asdict(check.pairs) if check.pairs is not None else None,
        slip=slips[0] if slips else None,
        faults=faults,
    )


def _fault(found: Found) -> dict[str, str | float | bool | None]:
    """Return a suspect that was found, for results.json; poses count from 0."""
    suspect = found.suspect
    return {
        "kind": suspect.kind,
        "axis": AXES[suspect.axis] if suspect.kind == SLIPPED else None,
        "pose": suspect.pose,
        "size_deg": math.degrees(found.size_rad),
        "sigma_deg": math.degrees(found.sigma_rad),
        "probability": 1.0 / (1.0 + math.exp(0.5 * min(found.evidence, LARGEST_EVIDENCE))),
        "claimed": True,  # Readers of earlier results expect it: those listed others, too
    }


def mount_faces(calibration: Calibration, station: Station) -> list[MountFace] | None:
    """Return ``mount_faces`` of docs/results.md; None without stated faces or without a boresight."""
    boresight = calibration.boresight
    if boresight is None or station.gimbal is None or not station.gimbal.faces:
        return None
    answer: list[MountFace] = []
    for name, face in station.gimbal.faces.items():
        angle, expanded = boresight.angle_to(np.array(face.normal), math.radians(face.sigma_deg))
        normal = boresight.rotation @ np.array(face.normal) / np.linalg.norm(face.normal)
        answer.append(MountFace(name, normal.tolist(), angle, expanded))
    return answer


def parallax_check(
    calibration: Calibration, views: Sequence[View], station: Station, sequence: str
) -> ParallaxData | None:
    """Measure how far the entrance pupil is off the pivot, and its parallax (docs/results.md); or ``why_not``."""
    if calibration.collimator is None:
        why_not = "The planar model has no collimator, so the motion of the beam's disc has no scale. Use model: joint."
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
            "source": "station",
        },
        "parallax": None if parallax is None else {"value": parallax.share, "sigma": parallax.share_sigma},
        "fx_px": None if parallax is None else {"value": parallax.fx_px, "sigma": parallax.fx_sigma_px},
        "says": [*walk.says(), *_for_station(walk, station), *_effect(parallax)],
    }


def _parallax(walk: PupilWalk, calibration: Calibration, station: Station) -> Parallax | None:
    """Return the parallax by the station's defocus; None if it states none."""
    stated = station.collimator.defocus
    if stated is None:
        return None
    assert calibration.collimator is not None
    return walk.parallax(
        stated.value, stated.sigma, r_mm=calibration.collimator.r, fx_px=calibration.camera.fx
    )


def _stated(station: Station) -> Numbers | None:
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
    says = (
        f"With a defocus of {exact(bound.defocus)}, standard uncertainty {exact(bound.defocus_sigma)} (by the station "
        f"file), the parallax is {number(100 * parallax.share, 2)} % of the turn, standard uncertainty "
        f"{number(100 * parallax.share_sigma, 2)} %. Without a correction for it, readings of the gimbal change fx by "
        f"{number(parallax.fx_px, 2)} px, standard uncertainty {number(parallax.fx_sigma_px, 2)} px."
    )
    return [says]
