"""What a calibration is held against: Zhang's planar model on the same points, and the truth of a simulated world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from calib.engine import Calibration, CalibrationOptions, calibrate
from calib.errors import CalibrationError
from calib.view import View

_COMPARED = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "x", "y", "r")


def planar_calibration(views: Sequence[View], options: CalibrationOptions) -> Calibration | None:
    """Calibrate by Zhang's planar model on the same points, for comparison; None where it cannot be done."""
    try:
        return calibrate(
            views, CalibrationOptions("planar", options.distortion, options.loss, options.huber_px)
        )
    except CalibrationError:
        return None


def compare_with_truth(calibration: Calibration, truth: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Say how far each value lies from the simulated truth, in its own unit and in its own sigmas."""
    true = {**truth["camera"], **truth["collimator"]}
    values = dict(zip(calibration.parameter_names, calibration.values.tolist(), strict=True))
    sigmas = calibration.sigma
    return [
        {
            "name": name,
            "value": values[name],
            "sigma": sigmas[name],
            "truth": true[name],
            "error": values[name] - true[name],
            "error_sigmas": (values[name] - true[name]) / sigmas[name],
        }
        for name in _COMPARED
        if name in values and name in true
    ]
