"""Cameras in the form of results.json as camera models: of a result, of its halves, of an earlier result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bench.records.estimates import coverage_factor
from bench.records.results import CameraData
from calib.model.camera import PINHOLE, CameraModel
from calib.uncertainty.projection_uncertainty import camera_difference, projection_uncertainty

Array = NDArray[np.float64]


def camera_of(values: Mapping[str, float], image_size: Sequence[int]) -> CameraModel:
    """Return the camera model for a camera of results.json.

    values: ``fx fy cx cy`` and the coefficients of the lens.
    image_size: Width and height, px.
    """
    lens = {name: value for name, value in values.items() if name not in PINHOLE}
    fx, fy, cx, cy = (values[name] for name in PINHOLE)
    width, height = image_size
    return CameraModel(fx, fy, cx, cy, (width, height), lens)


def camera_covariance(calibration: CameraData) -> Array | None:
    """Return the covariance of the camera's values, without those of the collimator.

    calibration: ``calibration`` of results.json.
    Returns: (K, K) covariance in the order of ``calibration.camera``; None if it is not stated for all of
      them.
    """
    covariance = calibration.get("covariance") or {"names": [], "matrix": []}
    values = list(calibration["camera"])
    if not set(values) <= set(covariance["names"]):
        return None
    at = [covariance["names"].index(name) for name in values]
    return np.array(covariance["matrix"], dtype=np.float64)[np.ix_(at, at)]


def change_maps(then: CameraData, now: CameraData) -> tuple[Array, Array, Array] | None:
    """Return how far two calibrations of a camera project a direction apart, and the expanded uncertainty of that.

    The ratio of the two is the E_n number (ISO 13528): above 1, the change is larger than its expanded uncertainty.
    The uncertainties are taken as independent.

    Returns: (h, w, 2) image points, (h, w) lengths of the change, and (h, w) their expanded uncertainty, px;
      None if a covariance is missing.
    """
    found = []
    for one in (then, now):
        covariance = camera_covariance(one)
        if covariance is None:
            return None
        camera = camera_of(one["camera"], one["image_size"])
        sigma = projection_uncertainty(camera, covariance).sigma_px
        found.append((camera, coverage_factor(one) * sigma))
    difference = camera_difference(found[1][0], found[0][0])
    expanded = np.hypot(found[0][1], found[1][1])
    return difference.grid_px, np.linalg.norm(difference.offset_px, axis=2), expanded
