"""Reference methods on the same points."""

import numpy as np
import pytest

from calib.engine import CalibrationOptions, calibrate
from tests.benchmarks.compared.reference_methods import opencv_planar, published_recipe
from tests.unit.calib.conftest import Bench

POSES = ((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (-3, -2, 60))


@pytest.mark.parametrize("distortion", ["k1k2", "k1k2k3p1p2"])
def test_opencv_is_asked_for_the_same_coefficients(distortion):
    views = Bench().views(np.random.default_rng(81), 0.02, poses=POSES)
    options = CalibrationOptions(model="planar", distortion=distortion, loss="l2")
    theirs, own = opencv_planar(views, options), calibrate(views, options)
    assert theirs.camera.parameter_names == own.camera.parameter_names
    assert theirs.camera.fx == pytest.approx(own.camera.fx, abs=0.2 * own.sigma["fx"])
    assert theirs.sigma["fx"] == pytest.approx(own.sigma["fx"], rel=0.15)


def test_on_ideal_data_the_published_recipe_is_our_spherical_model():
    views = Bench().views(np.random.default_rng(82), 0.05, poses=POSES)
    own = calibrate(views, CalibrationOptions("spherical", loss="l2"))
    published = published_recipe(views, CalibrationOptions())
    assert published.camera.values == pytest.approx(own.camera.values, rel=1e-6)
    assert published.sigma["r"] == pytest.approx(own.sigma["r"], rel=1e-3)
    assert published.left_out_rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.2)
