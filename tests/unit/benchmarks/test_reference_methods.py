"""Reference methods on the same points."""

import numpy as np
import pytest

from calib.engine import CalibrationOptions, calibrate
from tests.benchmarks.compared.reference_methods import opencv_planar, published_recipe, starbench_result
from tests.unit.calib.conftest import Bench, FisheyeBench

POSES = ((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (-3, -2, 60))


@pytest.fixture
def bench():
    return Bench()


@pytest.mark.parametrize("distortion", ["k1k2", "k1k2k3p1p2"])
def test_opencv_is_asked_for_the_same_coefficients(bench, distortion):
    views = bench.views(np.random.default_rng(81), 0.02, poses=POSES)
    options = CalibrationOptions(model="planar", distortion=distortion, loss="l2")
    theirs, own = opencv_planar(views, options), calibrate(views, options)
    assert theirs.camera.parameter_names == own.camera.parameter_names
    assert theirs.camera.fx == pytest.approx(own.camera.fx, abs=0.2 * own.sigma["fx"])
    assert theirs.sigma["fx"] == pytest.approx(own.sigma["fx"], rel=0.15)
    assert theirs.rms_px == pytest.approx(own.rms_px, rel=1e-3)


@pytest.mark.parametrize("distortion", [("kb1",), ("kb1", "kb2")])
def test_a_fisheye_lens_is_asked_of_opencv_s_fisheye_calibration(distortion):
    bench = FisheyeBench(fx=1200.0, fy=1201.0, half_angle_deg=25.0)
    bench.bent = (0.03, -0.05 * (len(distortion) > 1), 0.0, 0.0)
    views = bench.views(poses=POSES)
    options = CalibrationOptions(model="planar", distortion=distortion, loss="l2")
    theirs, own = opencv_planar(views, options), calibrate(views, options)
    assert theirs.name == "OpenCV, planar (fisheye)"
    assert theirs.camera.parameter_names == own.camera.parameter_names
    assert theirs.camera.values == pytest.approx(own.camera.values, rel=1e-4)
    assert theirs.camera.distortion["kb1"] == pytest.approx(0.03, abs=1e-4)
    assert not theirs.sigma


def test_on_ideal_data_the_published_recipe_is_our_spherical_model(bench):
    views = bench.views(np.random.default_rng(82), 0.05, poses=POSES)
    own = starbench_result(calibrate(views, CalibrationOptions("spherical", loss="l2")))
    published = published_recipe(views, CalibrationOptions())
    assert published.camera.values == pytest.approx(own.camera.values, rel=1e-6)
    assert published.sigma["r"] == pytest.approx(own.sigma["r"], rel=1e-3)
    assert published.left_out_rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.2)
    assert own.name == "Starbench, spherical model"
