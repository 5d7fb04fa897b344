"""The refinement reaches the one optimum, from near and far, robustly."""

from dataclasses import replace

import numpy as np
import pytest
from made_views import shifted

from calib import CalibrationOptions, CameraModel, Collimator, calibrate
from calib.adjustment.bundle import Bundle, Observations
from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.rotation import exp_map
from calib.uncertainty.covariance import covariance_at_optimum

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "x", "y", "r")


def start_of(bench, rng, spread):
    s = 1 + spread * rng.uniform(-1, 1, 7)
    camera = CameraModel(
        bench.fx * s[0], bench.fy * s[0], bench.cx * s[1], bench.cy * s[2], bench.size, {"k1": 0.0, "k2": 0.0}
    )
    turns = exp_map(0.1 * spread * rng.standard_normal((3, 3))) @ bench.rotations
    return AdjustmentParameters(
        camera, Collimator(97 * s[3], 140 * s[4], 255 * s[5]), turns, np.zeros((3, 3))
    )


@pytest.mark.parametrize("loss", [Loss("l2"), Loss("huber", 2.0), Loss("cauchy", 3.0)])
def test_the_optimum_does_not_depend_on_the_start(bench, loss):
    rng = np.random.default_rng(8)
    bundle = Bundle(Observations.from_views(bench.views(rng, 0.05)), NAMES)
    ends = [refine(bundle, start_of(bench, rng, spread), loss) for spread in (0.0, 0.1, 0.2)]
    assert all(end.converged for end in ends)
    sigma = np.sqrt(np.diag(covariance_at_optimum(bundle, ends[0].parameters, loss).covariance))
    for end in ends[1:]:
        assert np.abs((end.parameters.values(NAMES) - ends[0].parameters.values(NAMES)) / sigma).max() < 1e-3


def test_robust_losses_resist_wrong_stars_where_least_squares_does_not(bench):
    rng = np.random.default_rng(10)
    views = bench.views(rng, 0.05)
    every = slice(None, None, 25)
    views = [shifted(view, every, rng.uniform(-8, 8, view.points_px[every].shape)) for view in views]
    bundle = Bundle(Observations.from_views(views), NAMES)
    off = {}
    for loss in (Loss("l2"), Loss("huber", 2.0), Loss("cauchy", 3.0)):
        end = refine(bundle, start_of(bench, rng, 0.0), loss)
        off[loss.name] = abs(end.parameters.camera.fx - bench.fx)
    assert off["l2"] > 20
    assert off["huber"] < 8
    assert off["cauchy"] < 8


@pytest.mark.parametrize("loss", [Loss("l2"), Loss("huber", 1.5), Loss("cauchy", 1.5)])
def test_weights_and_slopes_are_derivatives_of_the_cost(loss):
    lengths, h = np.array([0.1, 0.7, 1.4, 1.7, 5.0]), 1e-4
    cost = np.array([[loss.costs(np.array([e + d])).sum() for d in (-h, 0.0, h)] for e in lengths])
    assert np.allclose(loss.weights(lengths) * lengths, (cost[:, 2] - cost[:, 0]) / (2 * h), rtol=1e-6)
    assert np.allclose(loss.second_derivatives(lengths), (cost @ [1, -2, 1]) / h**2, atol=1e-5)


def test_a_start_that_cannot_be_projected_does_not_converge(bench):
    rng = np.random.default_rng(11)
    bundle = Bundle(Observations.from_views(bench.views(rng, 0.05)), NAMES)
    behind = start_of(bench, rng, 0.0).after_step(NAMES, np.zeros(9), np.tile([np.pi, 0, 0], (3, 1)))
    assert not refine(bundle, behind, Loss("l2")).converged


def test_where_rounding_hides_the_last_steps_the_optimum_is_reached_all_the_same(make_bench):
    bench, sigma_px = make_bench(half_angle_deg=5.0), 1e-6
    for seed in range(8):
        views = [
            replace(view, covariances_px2=view.covariances_px2 * (sigma_px / 1e-2) ** 2)
            for view in bench.views(np.random.default_rng(seed), sigma_px)
        ]
        result = calibrate(views, CalibrationOptions("spherical"))
        assert result.camera.fx == pytest.approx(bench.fx, abs=5 * result.sigma["fx"])
