"""The calibration, the camera and the collimator that results.json states, as the engine has them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bench.record.results import CalibrationData, CovarianceData
from calib.arrays import Array
from calib.calibration import Calibration, ViewSummary
from calib.model.camera import PINHOLE, CameraModel
from calib.model.collimator import CENTRE, Collimator
from calib.model.result_parts import Boresight

_SAME = (
    *("model", "rms_px", "mean_px", "variance_factor", "degrees_of_freedom", "converged", "iterations"),
    *("coverage_factor", "left_out_rms_px", "budget"),
)
"""What results.json states of a calibration as `Calibration` holds it."""


def stored_calibration(stored: CalibrationData) -> Calibration:
    """Return the calibration of results.json, without residuals and weights."""
    names = tuple(stored["covariance"]["names"])
    values = {**stored["camera"], **(stored["collimator"] or {})}
    return Calibration(
        **{name: stored[name] for name in _SAME},  # type: ignore[literal-required]
        camera=stored_camera(stored),
        collimator=stored_collimator(stored["collimator"]),
        rotations=np.array([view["rotation"] for view in stored["views"]], np.float64),
        centres=np.array([view["centre_mm"] for view in stored["views"]], np.float64),
        parameter_names=names,
        estimates=np.array([values[name] for name in names], np.float64),
        covariance=np.array(stored["covariance"]["matrix"], np.float64),
        residuals_px=[],
        weights=[],
        views=tuple(
            ViewSummary(view["name"], view["n"], view["rms_px"], view["mean_px"]) for view in stored["views"]
        ),
        birge_ratio=stored["disagreement"],
        notes=tuple(stored["notes"]),
        gimbal=stored.get("gimbal"),
        boresight=Boresight.from_dict(stored["boresight"]) if stored.get("boresight") else None,
        budget_rows=tuple(stored["budget_rows"]),
        not_included=tuple(stored["not_included"]),
        remarks=tuple(stored["remarks"]),
        witnesses=tuple(stored["witnesses"]),
        amplitudes=tuple(stored["amplitudes"]),
        coverage_factors=stored.get("coverage_factors", {}),
    )


def stored_camera(stored: Mapping[str, Any]) -> CameraModel:
    """Return the camera that results.json states; errors as `stored_calibration`."""
    return camera_of(stored["camera"], stored["image_size"])


def stored_collimator(values: Mapping[str, float] | None) -> Collimator | None:
    """Return the collimator of results.json, None if planar; ``reference`` is None, since it is not stored."""
    if values is None:
        return None
    aberrations = {name: value for name, value in values.items() if name not in CENTRE}
    return Collimator(values["x"], values["y"], values["r"], aberrations=aberrations)


def camera_of(values: Mapping[str, float], image_size: Sequence[int]) -> CameraModel:
    """Return the camera model for a camera of results.json: ``fx fy cx cy`` and coefficients of the lens."""
    lens = {name: value for name, value in values.items() if name not in PINHOLE}
    fx, fy, cx, cy = (values[name] for name in PINHOLE)
    width, height = image_size
    return CameraModel(fx, fy, cx, cy, (width, height), lens)


def camera_covariance(camera: Iterable[str], covariance: CovarianceData | None) -> Array | None:
    """Return the covariance, (K, K), of the values of ``camera``; None if it is not stated for all of them."""
    values = list(camera)
    if covariance is None or not set(values) <= set(covariance["names"]):
        return None
    at = [covariance["names"].index(name) for name in values]
    return np.array(covariance["matrix"], dtype=np.float64)[np.ix_(at, at)]
