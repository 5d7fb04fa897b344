"""Leaving one view out."""

import numpy as np
import pytest
from monte_carlo_runs import jackknife

from calib.adjustment.levenberg_marquardt import refine
from calib.engine import CalibrationOptions
from calib.fit import fit_model
from calib.uncertainty.cross_validation import CrossValidation, leave_one_out

POSES = ((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (-3, -2, 60), (3, 0, 130))
L2 = CalibrationOptions(loss="l2")


def test_what_is_left_out_has_no_part_in_the_estimate(bench):
    views = bench.views(np.random.default_rng(101), 0.05, poses=POSES)
    whole = fit_model(views, L2, "spherical")
    left = leave_one_out(whole.bundle, whole.parameters, whole.loss)
    without = fit_model(views[1:], L2, "spherical")
    sigma = np.sqrt(np.diag(without.uncertainty.covariance))
    assert np.abs((left.values[0] - without.parameters.values(whole.bundle.names)) / sigma).max() < 0.02
    assert left.stars.tolist() == [len(view) for view in views]


@pytest.mark.parametrize("model", ["spherical", "planar"])
def test_a_view_that_belongs_is_predicted_to_the_noise_and_one_that_does_not_is_not(bench, model):
    rng = np.random.default_rng(102)
    views = bench.views(rng, 0.02, poses=POSES)
    centre = np.array(bench.centre) + np.array([3.0, 0.0, 0.0])
    views[2] = bench.view("moved", bench.turn(*POSES[2]), rng, 0.02, centre)
    fitted = fit_model(views, L2, model)
    left = leave_one_out(fitted.bundle, fitted.parameters, fitted.loss)
    if model == "spherical":
        assert left.rms_px.argmax() == 2
    assert left.rms_px[2] > 5 * 0.02 * np.sqrt(2)


def test_the_jackknife_of_views_that_agree_is_the_stated_covariance(bench):
    views = bench.views(np.random.default_rng(103), 0.05, poses=POSES)
    fitted = fit_model(views, L2, "spherical", leave_out=True)
    ratio = np.sqrt(np.diag(jackknife(fitted.cross_validation)) / np.diag(fitted.uncertainty.covariance))
    # Four degrees of freedom, and views of unequal weight: a factor of two is agreement.
    assert 0.5 < np.sqrt((ratio**2).mean()) < 2.2
    assert not fitted.uncertainty.inconsistent


def test_totals_weigh_views_by_their_stars():
    left = CrossValidation(np.array([[1.0], [3.0], [2.0]]), np.array([0.1, 0.2, 0.3]), np.array([10, 10, 80]))
    assert left.total_rms_px == pytest.approx(np.sqrt((0.01 * 10 + 0.04 * 10 + 0.09 * 80) / 100))
    assert jackknife(left) == pytest.approx(np.array([[2 / 3 * 2.0]]))


def test_of_many_views_a_step_leads_where_a_refit_without_one_ends(bench):
    rng = np.random.default_rng(104)
    poses = [(*rng.uniform([-5, -2.5], [5, 2.5]), rng.uniform(0, 180)) for _ in range(10)]
    whole = fit_model(bench.views(rng, 0.05, poses=poses), L2, "spherical")
    left = leave_one_out(whole.bundle, whole.parameters, whole.loss)
    sigma = np.sqrt(np.diag(whole.uncertainty.covariance))
    moved = (left.values - whole.parameters.values(whole.bundle.names)) / sigma
    assert np.abs(moved).max() > 0.3
    for i in (0, 7):
        others = [j for j in range(10) if j != i]
        refit = refine(whole.bundle.subset(others), whole.parameters.subset(others), whole.loss).parameters
        assert np.abs((left.values[i] - refit.values(whole.bundle.names)) / sigma).max() < 0.03
