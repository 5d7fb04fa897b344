"""Projection uncertainty over the sensor, at infinity."""

from dataclasses import replace

import numpy as np
import pytest

from calib.engine import CalibrationOptions, calibrate
from calib.model.camera import CameraModel
from calib.uncertainty.projection_uncertainty import camera_difference, projection_uncertainty, sensor_grid

CAMERA = CameraModel(3345.0, 3345.0, 640.0, 360.0, (1280, 720), {"k1": 0.06, "k2": -0.9})


def covariance(**sigmas):
    return np.diag([sigmas.get(name, 0.0) ** 2 for name in CAMERA.parameter_names])


def test_a_shift_of_the_principal_point_is_nearly_a_turn_and_hardly_counts():
    shifted = projection_uncertainty(CAMERA, covariance(cx=1.0))
    assert shifted.worst_px < 0.05
    scaled = projection_uncertainty(CAMERA, covariance(fx=1.0, fy=1.0))
    assert scaled.worst_px == pytest.approx(639.5 / 3345.0, rel=0.2)


def test_focal_error_grows_from_the_middle_to_the_corner():
    found = projection_uncertainty(CAMERA, covariance(fx=1.0), points_across=33)
    middle = found.sigma_px[found.sigma_px.shape[0] // 2, 16]
    assert middle < 0.01
    assert found.sigma_px[0, 0] == pytest.approx(found.worst_px, rel=0.05)


def test_pixels_become_arc_seconds_by_the_focal_length():
    found = projection_uncertainty(CAMERA, covariance(fx=1.0, fy=1.0))
    ratio = found.sigma_arcsec[:, 1:-1] / found.sigma_px[:, 1:-1]
    assert np.nanmedian(ratio) == pytest.approx(206265 / 3345, rel=0.03)


def test_the_map_is_the_scatter_of_repeated_calibrations(bench):
    runs = [
        calibrate(
            bench.views(np.random.default_rng([71, i]), 0.05), CalibrationOptions("spherical", loss="l2")
        )
        for i in range(16)
    ]
    stated = projection_uncertainty(runs[0].camera, runs[0].camera_covariance, 9).sigma_px
    truth = replace(runs[0].camera).with_values(
        np.array([bench.truth[name] for name in runs[0].camera.parameter_names])
    )
    off = np.array([camera_difference(truth, run.camera, 9).offset_px for run in runs])
    # Two components share the trace; the larger eigenvalue is between half and all of it.
    scatter = np.sqrt((off**2).sum(axis=3).mean(axis=0))
    assert np.median(scatter / stated) == pytest.approx(1.15, abs=0.3)


def test_a_turned_camera_does_not_differ_from_itself():
    assert camera_difference(CAMERA, CAMERA).worst_px < 1e-9
    moved = replace(CAMERA, cx=CAMERA.cx + 5.0)
    assert camera_difference(CAMERA, moved).worst_px < 0.3
    longer = replace(CAMERA, fx=3355.0, fy=3355.0)
    assert camera_difference(CAMERA, longer).rms_px == pytest.approx(10 / 3345 * 424, rel=0.15)


def test_the_grid_spans_the_sensor():
    grid = sensor_grid((1280, 720), 17)
    assert grid.shape == (10, 17, 2)
    assert grid[0, 0].tolist() == [0, 0]
    assert grid[-1, -1].tolist() == [1279, 719]


def test_beyond_the_fold_of_the_lens_there_is_no_number():
    folded = CameraModel(500.0, 500.0, 640.0, 360.0, (1280, 720), {"k1": -0.6})
    found = projection_uncertainty(folded, np.eye(5) * 1e-4)
    assert np.isnan(found.sigma_px[0, 0])
    assert np.isfinite(found.worst_px)
