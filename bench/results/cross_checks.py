"""Checks that take no part in a result: halves of the poses against each other, rotations against the gimbal.

Each says what it found as plain numbers, or nothing where there are too few poses to tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.views.expected_grid import best_readings
from calib.engine import Calibration, CalibrationOptions
from calib.errors import CalibrationError
from calib.studies.hand_eye import check_hand_eye
from calib.studies.split_half import split_half
from calib.view import View


def split_half_check(views: Sequence[View], options: CalibrationOptions) -> dict[str, Any] | None:
    """Calibrate every other pose, and the rest, and say how the two differ at infinity; None with fewer than four.

    The two cameras are told too: what is drawn of their difference follows from them.
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
    """Hold rotations against the gimbal's readings; None where it cannot be told.

    Parameters
    ----------
    calibration
        Of the poses.
    readings_deg
        For each pose, angle by axis (pan, tilt, roll), and the encoders' (``pan_encoder``) which are better.
    """
    readings = [{f"{axis}_deg": deg for axis, deg in best_readings(pose).items()} for pose in readings_deg]
    try:
        told = check_hand_eye(calibration.rotations, calibration.rotation_covariance, readings)
    except CalibrationError:  # too few poses, or axes that did not move
        return None
    return {
        "rms_arcsec": told.rms_arcsec,
        "scale": dict(told.scale),
        "scale_sigma": dict(told.scale_sigma),
        "agrees": told.consistent,
    }
