"""Comparison of a calibration with Zhang's planar model on the same points, and with the truth of a simulated bench."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from calib.engine import Calibration, CalibrationOptions, calibrate
from calib.errors import CalibrationError
from calib.view import View

_COMPARED = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "x", "y", "r")
_MOVE_THE_CENTRE = ("defocus", "coma", "astigmatism", "field_curvature")
"""Errors of a collimator that displace the apparent centre across the beam, as its place depends on the pupil's."""


def planar_calibration(views: Sequence[View], options: CalibrationOptions) -> Calibration | None:
    """Calibrate with Zhang's planar model on the same points (Zhang, 2000).

    Returns: None if the views do not determine the planar model.
    """
    try:
        return calibrate(
            views, CalibrationOptions("planar", options.distortion, options.loss, options.huber_px)
        )
    except CalibrationError:
        return None


def compare_with_truth(calibration: Calibration, truth: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Compare each value with the simulated truth.

    If the simulated collimator has errors that displace the apparent centre, x and y are not compared: they are those
    of the apparent centre, and the truth holds those of the ideal one.

    truth: ``truth`` of results.json: ``camera`` and ``collimator``.
    Returns: For each value ``name value sigma truth error error_sigmas``: the error in the value's own unit,
      and divided by the value's standard uncertainty.
    """
    true = {**truth["camera"], **truth["collimator"]}
    if any(true.get(name) for name in _MOVE_THE_CENTRE):
        true = {name: value for name, value in true.items() if name not in ("x", "y")}
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
