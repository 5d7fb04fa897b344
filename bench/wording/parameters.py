"""Units and meanings of the parameters of a calibration."""

from __future__ import annotations

_UNITS = {"fx": "px", "fy": "px", "cx": "px", "cy": "px", "skew": "px", "x": "mm", "y": "mm", "r": "mm"}
MEANINGS = {
    "fx": "focal length, along rows",
    "fy": "focal length, along columns",
    "cx": "principal point, column",
    "cy": "principal point, row",
    "k1": "radial distortion, 2nd order",
    "k2": "radial distortion, 4th order",
    "k3": "radial distortion, 6th order",
    "k4": "radial distortion, denominator, 2nd order",
    "k5": "radial distortion, denominator, 4th order",
    "k6": "radial distortion, denominator, 6th order",
    "p1": "tangential distortion",
    "p2": "tangential distortion",
    "skew": "skew of the pixels' axes, K[0, 1]",
    "x": "collimator axis on the target, X",
    "y": "collimator axis on the target, Y",
    "r": "collimator focal length, in the target's scale",
    "pupil_shift": "collimator: reticle out of focus",
    "radial": "collimator: distortion, or a curved reticle",
    "radial_4": "collimator: distortion, 4th order",
    "field_curve": "collimator: field curvature",
    "tilt_x": "collimator: reticle tilted, about Y",
    "tilt_y": "collimator: reticle tilted, about X",
    "coma": "collimator: coma",
    "coma_round": "collimator: coma, in all directions",
    "astigmatism": "collimator: astigmatism",
    "rim_4": "collimator: rim of the beam, 4th order",
    "rim_10": "collimator: rim of the beam, 10th order",
    "kb1": "fisheye distortion, 2nd order",
    "kb2": "fisheye distortion, 4th order",
    "kb3": "fisheye distortion, 6th order",
    "kb4": "fisheye distortion, 8th order",
}


def unit_of(parameter: str) -> str:
    """Return the unit of a parameter: ``px``, ``mm``, or ``1`` for a pure number such as a distortion coefficient."""
    return _UNITS.get(parameter, "1")


def unit_text(name: str) -> str:
    """Return the unit of a parameter, as it is printed after a number; empty for none."""
    unit = unit_of(name)
    return "" if unit == "1" else unit


def meaning_of(parameter: str) -> str:
    """Return a short description of a parameter; empty for an unknown one."""
    return MEANINGS.get(parameter, "")
