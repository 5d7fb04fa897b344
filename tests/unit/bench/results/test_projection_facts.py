"""The worst corner and the part of the sensor that stars support."""

import numpy as np
import pytest

from bench.results.results_content import projection_facts
from calib.model.camera import CameraModel

CAMERA = CameraModel(3345.0, 3345.0, 639.5, 359.5, (1280, 720), {"k1": 0.0})
COVARIANCE = np.diag([1.0, 1.0, 1e-6, 1e-6, 1e-8])


def test_the_worst_corner_has_px_and_microradians_with_the_factor():
    stars = np.stack(np.meshgrid(np.arange(300, 990, 40.0), np.arange(100, 620, 40.0)), axis=-1).reshape(
        -1, 2
    )
    found = projection_facts(CAMERA, COVARIANCE, 2.0, [stars])
    worst = found["worst_corner"]
    assert worst["corner"] in {"top left", "top right", "bottom left", "bottom right"}
    # at the corner, a px is 1/f of the tangent, less the cosine squared of 12.4 degrees
    assert worst["expanded_urad"] == pytest.approx(1e6 * worst["expanded_px"] / 3345.0, rel=0.06)
    assert worst["expanded_px"] > found["median"]["expanded_px"]
    once = projection_facts(CAMERA, COVARIANCE, 1.0, [stars])
    assert worst["expanded_px"] == pytest.approx(2 * once["worst_corner"]["expanded_px"])
    supported = found["supported"]
    assert 0.4 < supported["share"] < 0.75
    assert supported["expanded_px"] < worst["expanded_px"]


def test_stars_at_one_place_support_little_and_no_stars_nothing():
    found = projection_facts(CAMERA, COVARIANCE, 2.0, [np.array([[640.0, 360.0]])])
    assert found["supported"]["share"] == pytest.approx(
        np.pi * found["supported"]["reach_px"] ** 2 / (1280 * 720), rel=0.01
    )
    assert projection_facts(CAMERA, COVARIANCE, 2.0, [])["supported"] is None
