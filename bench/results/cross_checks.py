"""Checks that do not influence a result: split half, and the hand-eye check against the gimbal's readings.

Each check returns plain numbers, or None if there are too few poses for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.views.expected_grid import best_angles_deg
from calib.engine import Calibration, CalibrationOptions
from calib.errors import CalibrationError
from calib.model.gimbal_readings import AXES
from calib.studies.gimbal_faults import GimbalFault
from calib.studies.gimbal_pairs import PairRatios
from calib.studies.hand_eye import check_hand_eye
from calib.studies.split_half import split_half
from calib.view import View

_NOT_INDEPENDENT = (
    "The readings also entered the calibration, so this comparison is not independent of them.",
)


def split_half_check(views: Sequence[View], options: CalibrationOptions) -> dict[str, Any] | None:
    """Calibrate every other pose and the rest separately, and compare the projections of the two cameras at infinity.

    Returns: ``rms_px worst_px expected_px ratio``, and ``cameras`` with the values of both halves, from which
      the report draws the difference. None with fewer than four views, or if a half does not determine the
      camera.
    """
    try:
        split = split_half(views, options)
    except CalibrationError:  # too few poses, or a half that constrains nothing: there is no such check then
        return None
    return {
        "rms_px": split.difference.rms_px,
        "worst_px": split.difference.worst_px,
        "expected_px": split.expected_px,
        "ratio": split.ratio,
        "cameras": [half.camera.to_dict() for half in split.halves],
    }


def gimbal_check(
    calibration: Calibration, readings_deg: Sequence[Mapping[str, float]]
) -> dict[str, Any] | None:
    """Compare the estimated rotations with the gimbal's readings.

    readings_deg: For each pose, the angle of each axis (``pan``, ``tilt``, ``roll``), deg. The reading of an
      encoder (``pan_encoder``) replaces that of its axis.
    Returns: ``rms_arcsec scale scale_sigma agrees excess_arcsec verdict says pairs slip faults``, as
      docs/results.md describes them; None with too few poses, or if an axis did not move.
    """
    readings = [{f"{axis}_deg": deg for axis, deg in best_angles_deg(pose).items()} for pose in readings_deg]
    try:
        check = check_hand_eye(
            calibration.rotations,
            calibration.rotation_covariance,
            readings,
            focal_uncertainty=_focal_uncertainty(calibration),
            birge_ratio=calibration.birge_ratio,
            names=[view.name for view in calibration.views],
        )
    except CalibrationError:  # too few poses, or axes that did not move
        return None
    faults = [_fault(fault, claimed=fault in check.claimed_faults) for fault in check.faults]
    slips = [fault for fault in faults if fault["kind"] == "slip" and fault["claimed"]]
    return {
        "rms_arcsec": check.rms_arcsec,
        "scale": dict(check.scale),
        "scale_sigma": dict(check.scale_sigma),
        "agrees": check.consistent,
        "excess_arcsec": check.excess_arcsec,
        "verdict": check.verdict.kind,
        "says": [*check.verdict.says, *(_NOT_INDEPENDENT if _entered(calibration) else ())],
        "pairs": _pairs(check.pairs) if check.pairs is not None else None,
        "slip": slips[0] if slips else None,
        "faults": faults,
    }


def _entered(calibration: Calibration) -> bool:
    """Return whether the readings took part in the calibration."""
    return calibration.gimbal is not None and calibration.gimbal.entered


def _focal_uncertainty(calibration: Calibration) -> float | None:
    """Return the larger U of fx and fy, as a share of the value; None if neither was estimated."""
    values = dict(zip(calibration.parameter_names, calibration.values.tolist(), strict=True))
    sigmas = calibration.sigma
    k, own = calibration.coverage_factor, calibration.coverage_factors
    shares = [own.get(name, k) * sigmas[name] / values[name] for name in ("fx", "fy") if name in values]
    return max(shares, default=None)


def _pairs(pairs: PairRatios) -> dict[str, Any]:
    """Return the ratios of the pairs of poses, for results.json."""
    return {
        "ratio": pairs.ratio,
        "spread": pairs.spread,
        "count": pairs.count,
        "by_axis": {AXES[axis]: ratio for axis, ratio in pairs.by_axis.items()},
        "by_axis_sigma": {AXES[axis]: sigma for axis, sigma in pairs.by_axis_sigma.items()},
    }


def _fault(fault: GimbalFault, *, claimed: bool) -> dict[str, Any]:
    """Return a fault, for results.json; poses count from 0."""
    return {
        "kind": fault.kind,
        "axis": None if fault.axis is None else AXES[fault.axis],
        "pose": fault.pose,
        "size_deg": fault.size_deg,
        "sigma_deg": fault.sigma_deg,
        "probability": fault.probability,
        "claimed": claimed,
    }
