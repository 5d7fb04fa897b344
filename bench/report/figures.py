"""Draws all plots of a report as SVG. What needs arrays is imported here and below: text alone needs none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.records.estimates import coverage_factor
from bench.records.results import Results
from bench.report.camera_values import camera_covariance, camera_of, change_maps
from bench.report.choice import PLOTS
from bench.report.lens_plot import distortion_curve, field_angles_deg, outermost_deg
from bench.report.maps import sensor_map
from bench.report.plots import (
    coverage,
    deviations_from_truth,
    regions,
    residual_cloud,
    residual_radial,
    residual_vectors,
)
from bench.report.pose_plot import pose_directions, pose_frames
from bench.report.target_words import words_of
from bench.report.view_picture import ViewPicture
from calib.uncertainty.projection_uncertainty import ARCSEC, camera_difference, projection_uncertainty

Array = NDArray[np.float64]

_URAD_PER_ARCSEC = 1e6 / ARCSEC
_WIDE_ANGLE_DEG = 25.0


def report_plots(results: Results, views: Sequence[ViewPicture]) -> dict[str, str]:
    """Draw all plots of a report.

    views: The poses that entered the calibration; without them, only the comparison with the truth is drawn.
    Returns: SVG by name; a plot without data is empty.
    """
    plots = dict.fromkeys(PLOTS, "")
    compared = results.get("comparison") or []
    if compared:
        names = [row["name"] for row in compared]
        plots["truth"] = deviations_from_truth(names, [row["error_sigmas"] for row in compared])
    if not views:
        return plots
    words = words_of(results)
    seen = [view for view in views if len(view.detected)]
    plots |= _camera_plots(results, [view.detected for view in seen])
    plots["poses"], plots["frames"] = pose_directions(results), pose_frames(results["calibration"])
    if seen:
        width, height = results["calibration"]["image_size"]
        camera = results["calibration"]["camera"]
        centre = (camera["cx"], camera["cy"])
        plots["vectors"] = residual_vectors(views, (width, height), words)
        plots["cloud"] = residual_cloud(views)
        plots["radial"] = residual_radial(views, centre)
        plots["coverage"] = coverage(views, (width, height), centre, words)
        plots["regions"] = regions(views, (width, height), words)
    return plots


def _camera_plots(results: Results, stars: Sequence[Array]) -> dict[str, str]:
    """Draw what follows from the values of the camera and their covariance; nothing if there is no covariance."""
    calibration = results["calibration"]
    covariance = camera_covariance(calibration)
    if covariance is None:
        return {}
    camera, k = (
        camera_of(calibration["camera"], calibration["image_size"]),
        coverage_factor(calibration),
    )
    found, points = projection_uncertainty(camera, covariance), np.concatenate(stars) if stars else None
    plots = {
        "uncertainty": sensor_map(
            found.grid_px, k * found.sigma_px, "U of an image point, px", "uncertainty",
            "Uncertainty of an image point over the sensor", stars=points,
        ),
        "distortion": distortion_curve(camera, covariance, k, outermost_deg(camera, stars), words_of(results)),
    }  # fmt: skip
    if max(field_angles_deg(camera).values()) > _WIDE_ANGLE_DEG:  # else it looks as that of the image points
        plots["direction"] = sensor_map(
            found.grid_px, k * _URAD_PER_ARCSEC * found.sigma_arcsec, "U of a direction, \N{MICRO SIGN}rad",
            "direction", "Uncertainty of a direction over the sensor", stars=points,
        )  # fmt: skip
    halves = results.get("halves")
    if halves and (cameras := halves.get("cameras")):
        first, second = (camera_of(half, calibration["image_size"]) for half in cameras)
        difference = camera_difference(first, second)
        plots["halves"] = sensor_map(
            difference.grid_px, np.linalg.norm(difference.offset_px, axis=2), "Difference of the halves, px",
            "halves", "Difference between two halves of the poses", arrows=difference,
        )  # fmt: skip
    return plots | _change_plots(results)


def _change_plots(results: Results) -> dict[str, str]:
    """Draw the change since the last calibration, in px and in units of its expanded uncertainty."""
    previous = results.get("previous")
    then = previous.get("calibration") if previous else None
    maps = change_maps(then, results["calibration"]) if then else None
    if maps is None or then is None:
        return {}
    grid, offset, expanded = maps
    before, now = (camera_of(one["camera"], one["image_size"]) for one in (then, results["calibration"]))
    return {
        "change": sensor_map(
            grid, offset, "Change of an image point, px", "change", "Change since the last calibration",
            arrows=camera_difference(now, before),
        ),
        "change_ratio": sensor_map(
            grid, offset / expanded, "Change / U of the change", "change-ratio",
            "Change since the last calibration over its uncertainty",
        ),
    }  # fmt: skip
