"""Plots of the camera: round contours, the distortion curve with its band, the part that stars support."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.record.stored_calibration import camera_covariance, camera_of
from bench.report.distortion_plot import displacement, distortion_curve, field_angles_deg
from bench.report.maps import round_levels, sensor_map
from bench.report.supported import reach_px, star_distance
from calib.uncertainty.projection_uncertainty import sensor_grid


@given(st.floats(0, 1e4), st.floats(1e-6, 1e4))
def test_contours_are_few_round_numbers_between_the_values(lowest, span):
    levels = round_levels(lowest, lowest + span)
    assert len(levels) <= 7
    assert all(lowest < level < lowest + span for level in levels)
    assert levels == sorted(set(levels))
    for step in np.diff(levels) if len(levels) > 2 and lowest * 6 > lowest + span else []:
        assert float(f"{step:.6g}") == pytest.approx(step, rel=1e-3)


def test_a_map_labels_its_contours_with_these_numbers():
    grid = sensor_grid((640, 360), 17)
    svg = sensor_map(grid, 0.03 + grid[..., 0] / 700, "U, px", "u", "U over the sensor")
    labels = {float(text) for text in re.findall(r">(0\.\d+)</text>", svg)}
    assert {0.1, 0.2, 0.5} <= labels
    assert "at most 0.94" in svg


def test_the_distortion_curve_is_brown_s_with_the_propagated_uncertainty(data):
    calibration = data.results["calibration"]
    camera, covariance = (
        camera_of(calibration["camera"], calibration["image_size"]),
        camera_covariance(calibration["camera"], calibration["covariance"]),
    )
    angles = np.linspace(0, 12, 25)
    shown, sigma = displacement(camera, covariance, angles)
    r = np.tan(np.radians(angles))
    k1, k2 = (calibration["camera"][name] for name in ("k1", "k2"))
    focal = (camera.fx + camera.fy) / 2
    np.testing.assert_allclose(shown, focal * (k1 * r**3 + k2 * r**5), atol=1e-8)
    jacobian = np.column_stack([(k1 * r**3 + k2 * r**5) / 2] * 2 + [focal * r**3, focal * r**5])
    at = [0, 1, 4, 5]
    expected = np.sqrt(np.einsum("ni,ij,nj->n", jacobian, covariance[np.ix_(at, at)], jacobian))
    np.testing.assert_allclose(sigma, expected, rtol=1e-4, atol=1e-9)
    svg = distortion_curve(camera, covariance, 2.0, 9.0)
    assert "outermost star" in svg
    assert set(field_angles_deg(camera)) == {"sides", "top, bottom", "corner"}


def test_a_fisheye_lens_is_drawn_against_its_own_ideal():
    values = {"fx": 300.0, "fy": 300.0, "cx": 319.5, "cy": 239.5, **dict.fromkeys(("kb2", "kb3", "kb4"), 0.0)}
    camera = camera_of({**values, "kb1": 0.01}, (640, 480))
    shown, sigma = displacement(camera, np.diag([1e-4] * 8), np.array([0.0, 60.0]))
    theta = np.radians(60.0)
    np.testing.assert_allclose(shown, [0, 300 * 0.01 * theta**3], atol=1e-6)
    assert sigma[1] > 0


def test_stars_support_their_surroundings_only():
    distance = star_distance(np.array([[100.0, 50.0], [-3.0, 1e9]]), (400, 300))
    assert distance.shape == (300, 400)
    assert distance[50, 100] == 0
    assert distance[299, 0] == 0  # outside: the nearest pixel
    assert distance[50, 140] == pytest.approx(40, abs=0.01)
    assert reach_px((400, 300)) == pytest.approx(25.0)
