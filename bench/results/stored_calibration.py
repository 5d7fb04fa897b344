"""A calibration made again from the numbers of results.json, without its residuals; nothing is calculated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.calibration import Calibration, ViewSummary
from calib.model.budget_row import BudgetRow
from calib.model.camera import PINHOLE, CameraModel
from calib.model.collimator import CENTRE, Collimator
from calib.model.gimbal_estimate import GimbalEstimate


def stored_calibration(stored: Mapping[str, Any]) -> Calibration:
    """Return the calibration that results.json states.

    stored: ``calibration`` of results.json.
    Returns: Residuals and weights are empty, the candidates are not read; all other parts are as stored.
    Raises KeyError, TypeError, ValueError: When a part is missing, or is not of the expected form.
    """
    names = tuple(stored["covariance"]["names"])
    values = {**stored["camera"], **(stored["collimator"] or {})}
    return Calibration(
        model=stored["model"],
        camera=stored_camera(stored),
        collimator=stored_collimator(stored["collimator"]),
        rotations=np.array([view["rotation"] for view in stored["views"]], np.float64),
        centres=np.array([view["centre_mm"] for view in stored["views"]], np.float64),
        parameter_names=names,
        values=np.array([values[name] for name in names], np.float64),
        covariance=np.array(stored["covariance"]["matrix"], np.float64),
        residuals_px=[],
        weights=[],
        rms_px=stored["rms_px"],
        mean_px=stored["mean_px"],
        variance_factor=stored["variance_factor"],
        degrees_of_freedom=stored["degrees_of_freedom"],
        views=tuple(
            ViewSummary(view["name"], view["n"], view["rms_px"], view["mean_px"]) for view in stored["views"]
        ),
        converged=stored["converged"],
        iterations=stored["iterations"],
        birge_ratio=stored["disagreement"],
        coverage_factor=stored["coverage_factor"],
        left_out_rms_px=stored["left_out_rms_px"],
        budget=stored["budget"],
        notes=tuple(stored["notes"]),
        gimbal=GimbalEstimate(**stored["gimbal"]) if stored.get("gimbal") else None,
        budget_rows=tuple(BudgetRow(**row) for row in stored["budget_rows"]),
        not_included=tuple(stored["not_included"]),
        remarks=tuple(stored.get("remarks", ())),
        coverage_factors=stored.get("coverage_factors", {}),
    )


def stored_camera(stored: Mapping[str, Any]) -> CameraModel:
    """Return the camera that results.json states.

    stored: ``calibration`` of results.json.
    Raises KeyError, TypeError, ValueError: When a value is missing, or is not of the expected form.
    """
    width, height = stored["image_size"]
    values = stored["camera"]
    lens = {name: value for name, value in values.items() if name not in PINHOLE}
    return CameraModel(
        values["fx"], values["fy"], values["cx"], values["cy"], (width, height), distortion=lens
    )


def stored_collimator(values: Mapping[str, float] | None) -> Collimator | None:
    """Return the collimator that results.json states.

    values: ``calibration.collimator`` of results.json.
    Returns: Its ``reference`` is None, because results.json does not contain it; None for the planar model.
    Raises KeyError: When a value is missing.
    """
    if values is None:
        return None
    aberrations = {name: value for name, value in values.items() if name not in CENTRE}
    return Collimator(values["x"], values["y"], values["r"], aberrations=aberrations)
