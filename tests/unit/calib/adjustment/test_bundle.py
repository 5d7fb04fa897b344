"""The stacked residuals, their derivatives, and the reduced normal equations."""

from dataclasses import replace

import numpy as np
import pytest

from calib import CameraModel, Collimator
from calib.adjustment.bundle import Bundle, Observations
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "x", "y", "r")


def parameters_near(bench, rng, n=3):
    camera = CameraModel(3300.0, 3310.0, 640.0, 360.0, bench.size, {"k1": 0.1, "k2": -0.5})
    turns = bench.rotations[:n]
    shifts = 0.3 * rng.standard_normal((n, 3))
    return AdjustmentParameters(camera, Collimator(97.5, 140.0, 254.0), turns, shifts)


def test_the_reduced_information_is_that_of_the_whole_system(bench):
    rng = np.random.default_rng(7)
    bundle = Bundle(Observations.from_views(bench.views(rng, 0.05)), NAMES)
    parameters = parameters_near(bench, rng)
    equations = bundle.equations(parameters, Loss("l2"))
    whole = np.zeros((9 + 9, 9 + 9))
    for i, normal in enumerate(equations.normal):
        at = [*range(9), *range(9 + 3 * i, 12 + 3 * i)]
        whole[np.ix_(at, at)] += normal
    information = equations.eliminated().information.sum(axis=0)
    assert np.allclose(np.linalg.inv(information), np.linalg.inv(whole)[:9, :9], rtol=1e-5)


def test_a_star_counts_by_its_covariance(bench):
    view = bench.views()[0]
    covariances = np.tile(np.array([[0.04, 0.01], [0.01, 0.09]]), (len(view), 1, 1))
    observations = Observations.from_views([replace(view, covariances_px2=covariances)])
    whitened = observations.whitening @ covariances @ observations.whitening.transpose(0, 2, 1)
    assert np.allclose(whitened, np.eye(2))


BROWN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
LENSES = [BROWN, ("k2", "p2", "k6"), ("kb1", "kb2", "kb3", "kb4"), ()]


def slopes(bundle, parameters):
    """(G + L, N, 2) weighted residuals by each shared parameter and by each local one of all views, by differences."""
    shared, depth = len(bundle.names), 6 if bundle.free_centres else 3
    slopes_px = []
    for k in range(shared + depth):
        size = np.zeros(shared + depth)
        size[k] = 1e-4 if k < shared + 3 else 1e-2
        ends = [
            bundle.weighted_residuals(
                parameters.after_step(
                    bundle.names,
                    sign * size[:shared],
                    np.tile(sign * size[shared:], (len(bundle.observations.slices), 1)),
                )
            )
            for sign in (1.0, -1.0)
        ]
        slopes_px.append((ends[1] - ends[0]) / (2.0 * size[k]))
    return np.array(slopes_px)


@pytest.mark.parametrize("free_centres", [False, True])
@pytest.mark.parametrize("lens", LENSES)
def test_the_equations_are_the_sums_over_the_derivatives_of_all_stars(bench, lens, free_centres):
    rng = np.random.default_rng(16)
    names = ("fy", *lens, "fx", "cy", "r", "x", "cx")
    obs = Observations.from_views(bench.views(rng, 0.05))
    bundle = Bundle(obs, names, free_centres=free_centres)
    near = parameters_near(bench, rng)
    camera = replace(near.camera, distortion={name: 0.1 * rng.normal() for name in lens})
    parameters = replace(near, camera=camera)

    equations = bundle.equations(parameters, Loss("l2"))

    jacobian, residuals = slopes(bundle, parameters), bundle.weighted_residuals(parameters)
    for i, rows in enumerate(obs.slices):
        own = jacobian[:, rows].reshape(len(jacobian), -1)
        along = np.linalg.norm(own, axis=1)
        assert np.abs((equations.normal[i] - own @ own.T) / np.outer(along, along)).max() < 1e-5
        pull = own @ residuals[rows].reshape(-1)
        assert np.abs((equations.right[i] - pull) / along).max() < 1e-5 * np.linalg.norm(residuals[rows])


def test_the_derivatives_with_distorted_glass_are_those_of_differences(bench):
    rng = np.random.default_rng(18)
    bundle = Bundle(Observations.from_views(bench.views(rng, 0.05)), (*NAMES, "radial"))
    near = parameters_near(bench, rng)
    parameters = replace(near, collimator=replace(near.collimator, aberrations={"radial": 0.8}))
    expected = slopes(bundle, parameters).transpose(0, 2, 1)
    _, slope = bundle.linearised(parameters)
    error, size = (np.linalg.norm(by, axis=(1, 2)) for by in (slope - expected, expected))
    assert (error / size).max() < 1e-5


@pytest.mark.parametrize("loss", [Loss("huber", 1.0), Loss("cauchy", 1.0)])
def test_a_robust_cost_curves_as_its_differences_do(bench, loss):
    rng = np.random.default_rng(18)
    bundle = Bundle(Observations.from_views(bench.views(rng, 0.05)), NAMES[:4])
    parameters = parameters_near(bench, rng)
    outside = np.linalg.norm(bundle.weighted_residuals(parameters), axis=1) > 1.0
    assert outside.any()

    equations = bundle.equations(parameters, loss)

    def cost(step):
        return bundle.costs(parameters.after_step(NAMES[:4], step, np.zeros((3, 3))), loss).sum()

    for i in range(4):
        step = 0.1 * np.eye(4)[i]
        assert equations.right[:, i].sum() == pytest.approx((cost(-step) - cost(step)) / 0.2, rel=1e-3)
    plain = bundle.equations(parameters, loss, curved=False)
    assert np.array_equal(plain.normal, bundle.equations(parameters, Loss("l2")).normal)
    assert np.array_equal(plain.right, equations.right)
    curved, straight = (np.diagonal(of.normal, axis1=1, axis2=2) for of in (equations, plain))
    assert (curved < straight).all()


@pytest.mark.parametrize("lens", LENSES)
def test_the_projection_is_that_of_the_camera(bench, lens):
    rng = np.random.default_rng(17)
    obs = Observations.from_views(bench.views(rng, 0.05))
    near = parameters_near(bench, rng)
    camera = replace(near.camera, distortion={name: 0.1 * rng.normal() for name in lens})
    parameters = replace(near, camera=camera)
    residuals_px = Bundle(obs, NAMES[:4]).residuals_px(parameters)
    for i, rows in enumerate(obs.slices):
        points = (obs.target[rows] - parameters.centres[i]) @ parameters.rotations[i].T
        assert np.allclose(residuals_px[rows], obs.points_px[rows] - camera.project(points), atol=1e-9)
    behind = replace(parameters, collimator=Collimator(97.5, 140.0, -254.0))
    assert np.isnan(Bundle(obs, NAMES[:4]).residuals_px(behind)).all()
