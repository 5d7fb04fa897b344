"""Draws all plots of a report as SVG. Matplotlib is imported here and below, so that text alone needs none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.report import calibration_tables
from bench.report.choice import PLOTS
from bench.report.plots import (
    coverage,
    deviations_from_truth,
    residual_cloud,
    residual_vectors,
    uncertainty_contours,
)
from bench.report.view_picture import ViewPicture
from calib.model.camera import PINHOLE, CameraModel
from calib.uncertainty.projection_uncertainty import camera_difference, projection_uncertainty


def report_plots(results: Mapping[str, Any], views: Sequence[ViewPicture]) -> dict[str, str]:
    """Draw all plots of a report.

    Parameters
    ----------
    results
        Content of results.json.
    views
        The poses that entered the calibration.

    Returns
    -------
    dict
        SVG by name; a plot without data is empty.
    """
    plots = dict.fromkeys(PLOTS, "")
    compared = results.get("comparison") or []
    if compared:
        names = [row["name"] for row in compared]
        plots["truth"] = deviations_from_truth(names, [row["error_sigmas"] for row in compared])
    camera = results["calibration"]["camera"]
    if views:
        plots["uncertainty"] = _uncertainty_plot(results)
    if any(len(view.detected) for view in views):
        width, height = results["calibration"]["image_size"]
        centre = (camera["cx"], camera["cy"])
        plots["vectors"] = residual_vectors(views, (width, height))
        plots["cloud"] = residual_cloud(views, centre)
        plots["coverage"] = coverage(views, (width, height), centre)
    return plots


def _uncertainty_plot(results: Mapping[str, Any]) -> str:
    """Draw the projection uncertainty that follows from the camera's covariance; empty if there is no covariance.

    If halves of the poses were calibrated separately, the plot also shows the difference between their projections.
    """
    calibration = results["calibration"]
    values, covariance = dict(calibration["camera"]), calibration["covariance"]
    names = [name for name in values if name in covariance["names"]]
    if names != list(values):
        return ""
    at = [covariance["names"].index(name) for name in names]
    matrix = np.array(covariance["matrix"])[np.ix_(at, at)]
    size = tuple(calibration["image_size"])
    found = projection_uncertainty(_camera(values, size), matrix)
    difference = None
    if cameras := (results.get("halves") or {}).get("cameras"):
        first, second = (_camera(half, size) for half in cameras)
        difference = camera_difference(first, second)
    return uncertainty_contours(found, calibration_tables.coverage_factor(calibration), difference)


def _camera(values: Mapping[str, float], image_size: tuple[int, int]) -> CameraModel:
    """Return the camera model for a camera of results.json."""
    lens = {name: value for name, value in values.items() if name not in PINHOLE}
    fx, fy, cx, cy = (values[name] for name in PINHOLE)
    return CameraModel(fx, fy, cx, cy, image_size, lens)
