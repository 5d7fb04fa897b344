"""Real recordings of a collimator, against numbers other programs gave.

The recordings are those published with "Camera Calibration using a Collimator System" (ECCV 2024), set data1. Their
corner origin is half a pixel away from OpenCV's. The planar numbers are OpenCV's own, computed here; the spherical
ones those of an independent prototype.
"""

from dataclasses import replace

import numpy as np
import pytest
from jackknife import jackknife

from calib import CalibrationOptions, StarTarget, calibrate
from calib.fit import fit_model
from tests.benchmarks.compared.reference_methods import opencv_planar, published_recipe
from tests.benchmarks.worlds.recordings import SIZE, read

L2 = CalibrationOptions(model="spherical", loss="l2")


@pytest.fixture(scope="module")
def views(collimator_recordings):
    return read(collimator_recordings)


def test_star_ids_and_positions_are_those_of_the_target(views):
    target = StarTarget()
    for view in views:
        assert np.abs(target.positions_mm(view.ids) - view.target_mm).max() < 1e-4


def test_spherical_model_of_all_views(views):
    result = calibrate(views, L2)
    assert result.camera.fx == pytest.approx(2424.5, abs=0.5)
    assert result.collimator.r == pytest.approx(257.0, abs=0.1)
    assert result.rms_px == pytest.approx(0.400, abs=0.001)
    assert result.mean_px == pytest.approx(0.3218, abs=0.0005)
    assert result.degrees_of_freedom == 2 * 8892 - 69


def test_views_left_out_are_predicted_as_the_prototype_found(views):
    for model, expected in (("spherical", 0.436), ("planar", 0.621)):
        result = calibrate(views, CalibrationOptions(model=model, loss="l2"))
        assert result.left_out_rms_px == pytest.approx(expected, abs=0.001)


@pytest.mark.parametrize(("model", "prototype"), [("spherical", 9.37), ("planar", 6.29)])
def test_the_sigmas_of_the_reference_methods_are_those_of_the_jackknife(views, model, prototype):
    fitted = fit_model(views, replace(L2, model=model), model)
    at = fitted.bundle.names.index("fx")
    assert np.sqrt(jackknife(fitted)[at, at]) == pytest.approx(prototype, abs=0.02)
    assert 0.7 < np.sqrt(fitted.uncertainty.covariance[at, at]) / prototype < 1.3


def test_the_joint_adjustment_predicts_left_out_views_better_than_the_published_model(views):
    result = calibrate(views, CalibrationOptions())
    assert result.left_out_rms_px < 0.15
    assert result.rms_px < 0.22
    assert 2390 < result.camera.fx < 2405


def test_the_reference_methods_are_opencvs_and_the_published_one(views):
    opencv_s, published = opencv_planar(views, L2), published_recipe(views, L2)
    ours = calibrate(views, replace(L2, model="planar"))
    assert opencv_s.rms_px == pytest.approx(ours.rms_px, abs=1e-6)
    assert opencv_s.camera.values == pytest.approx(ours.camera.values, abs=0.01)
    assert opencv_s.left_out_rms_px == pytest.approx(0.621, abs=0.001)
    # Noise is all that their uncertainties know of.
    assert opencv_s.sigma["fx"] < 1.5
    assert published.sigma["fx"] < 1.0
    assert published.camera.fx == pytest.approx(2423.5, abs=1.5)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("size", [2, 3])
def test_every_subset_ends_in_the_same_minimum_from_many_starts(views, size):
    from calib.adjustment.initialization import initialized, spherical_starts
    from calib.adjustment.levenberg_marquardt import refine
    from calib.adjustment.loss import Loss
    from calib.model.homography import view_homography

    rng = np.random.default_rng(size)
    for _ in range(100):
        subset = [views[i] for i in rng.choice(20, size, replace=False)]
        bundle, start = initialized(subset, L2.distortion, None)
        h = np.array([view_homography(view) for view in subset])
        ends = [refine(bundle, s, Loss("l2")).cost for s in spherical_starts(h, SIZE, ("k1", "k2"))]
        assert refine(bundle, start, Loss("l2")).cost <= min(ends) * (1 + 1e-6)
