"""Covariances: of parameters, of projections, and by cross validation."""

from dataclasses import replace

import numpy as np
import pytest
from jackknife import jackknife
from made_views import shifted
from scipy import stats
from slow_cases import first_quick

from calib import CalibrationOptions, CameraModel, calibrate
from calib.errors import DegenerateViews
from calib.fit import fit_model
from calib.model.result_parts import COVERAGE
from calib.uncertainty.covariance import leave_one_out, predicted_residuals, without_pose
from calib.uncertainty.projection_uncertainty import camera_difference, projection_uncertainty, sensor_grid


def with_outliers(view, share, rng):
    """A view of which some share of the stars is wrong by 2 px, 1 sigma per axis."""
    wrong = rng.random(len(view)) < share
    return shifted(view, wrong, 2.0 * rng.standard_normal((int(wrong.sum()), 2)))


def z_scores(bench, options, runs, seed, outliers=0.0):
    """Errors over their stated sigmas, and over U, of calibrations that differ in the noise of the stars."""
    z, over = [], []
    for i in range(runs):
        rng = np.random.default_rng([seed, i])
        views = [with_outliers(view, outliers, rng) for view in bench.views(rng, 0.05)]
        result = calibrate(views, options)
        names = result.parameter_names
        off = result.estimates - [bench.truth[name] for name in names]
        z.append(off / np.sqrt(np.diag(result.covariance)))
        over.append(off / [result.U[name] for name in names])
    return np.array(z), np.array(over)


def in_the_band(z):
    """Mean squares of z within 4 sigma of 1, were the sigmas right."""
    return np.abs((z**2).mean(axis=0) - 1) < 4 * np.sqrt(2 / len(z))


@pytest.mark.parametrize(
    "options", first_quick([CalibrationOptions("spherical"), CalibrationOptions(model="planar", loss="l2")])
)
def test_sigmas_are_those_of_repeated_calibrations(bench, options):
    z, _ = z_scores(bench, options, 20, 12)
    assert in_the_band(z).all()
    assert not in_the_band(2.5 * z).any()


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("loss", "outliers"), [("l2", 0), ("huber", 0), ("huber", 0.02), ("cauchy", 0.02)])
def test_two_sigma_intervals_cover_as_often_as_they_should(make_bench, loss, outliers):
    """Of 500 calibrations by JCGM 101:2008, within what 999 of 1000 such studies show; with half the sigmas they do not."""
    bench, options = make_bench(half_angle_deg=4.5), CalibrationOptions("spherical", loss=loss)
    z, over = z_scores(bench, options, 500, 17, outliers)
    low, high = np.array(stats.binom.interval(0.999, len(z), COVERAGE)) / len(z)
    covered = (np.abs(over) <= 1.0).mean(axis=0)
    assert ((low <= covered) & (covered <= high)).all()
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.05)
    assert ((np.abs(over) <= 0.5).mean(axis=0) < low).all()


def test_the_variance_factor_shows_star_covariances_that_are_too_small(bench):
    rng = np.random.default_rng(15)
    views = [replace(v, covariances_px2=v.covariances_px2 / 4) for v in bench.views(rng, 0.05)]
    honest = calibrate(bench.views(np.random.default_rng(15), 0.05), CalibrationOptions("spherical"))
    bold = calibrate(views, CalibrationOptions("spherical"))
    assert honest.variance_factor == pytest.approx(1.0, abs=0.1)
    assert bold.variance_factor == pytest.approx(4 * honest.variance_factor, rel=1e-6)
    assert bold.sigma["fx"] == pytest.approx(honest.sigma["fx"], rel=1e-6)


def test_more_parameters_than_measurements_are_refused(bench):
    def corners(view):
        ends = (np.argmax, np.argmin)
        keep = np.unique([end(view.points_px @ sign) for end in ends for sign in ([1, 1], [1, -1])])
        return view.part(np.isin(np.arange(len(view)), keep))

    few = [corners(view) for view in bench.views()[:2]]
    with pytest.raises(DegenerateViews, match="16 measurements cannot determine 21 parameters"):
        calibrate(few, CalibrationOptions("spherical", distortion="rational"))


# ---------------------------------------------------------------- projections

CAMERA = CameraModel(3345.0, 3345.0, 640.0, 360.0, (1280, 720), {"k1": 0.06, "k2": -0.9})


def covariance(**sigmas):
    return np.diag([sigmas.get(name, 0.0) ** 2 for name in CAMERA.parameter_names])


def test_a_shift_of_the_principal_point_is_nearly_a_turn_and_hardly_counts():
    shifted = projection_uncertainty(CAMERA, covariance(cx=1.0))
    assert shifted.worst_px < 0.05
    scaled = projection_uncertainty(CAMERA, covariance(fx=1.0, fy=1.0))
    assert scaled.worst_px == pytest.approx(639.5 / 3345.0, rel=0.2)


def test_pixels_become_arc_seconds_by_the_focal_length():
    uncertainty = projection_uncertainty(CAMERA, covariance(fx=1.0, fy=1.0))
    ratio = uncertainty.sigma_arcsec[:, 1:-1] / uncertainty.sigma_px[:, 1:-1]
    assert np.nanmedian(ratio) == pytest.approx(206265 / 3345, rel=0.03)


def test_the_map_is_the_scatter_of_repeated_calibrations(bench):
    options = CalibrationOptions("spherical", loss="l2")
    runs = [calibrate(bench.views(np.random.default_rng([71, i]), 0.05), options) for i in range(16)]
    stated = projection_uncertainty(runs[0].camera, runs[0].camera_covariance, 9).sigma_px
    values = np.array([bench.truth[name] for name in runs[0].camera.parameter_names])
    truth = runs[0].camera.with_values(values)
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
    uncertainty = projection_uncertainty(folded, np.eye(5) * 1e-4)
    assert np.isnan(uncertainty.sigma_px[0, 0])
    assert np.isfinite(uncertainty.worst_px)


# ---------------------------------------------------------------- cross validation

POSES = ((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (-3, -2, 60), (3, 0, 130))

L2 = CalibrationOptions(loss="l2")


def test_what_is_left_out_has_no_part_in_the_estimate(bench):
    views = bench.views(np.random.default_rng(101), 0.05, poses=POSES)
    whole = fit_model(views, L2, "spherical")
    left = without_pose(whole.bundle, [0], whole.parameters, whole.loss)
    without = fit_model(views[1:], L2, "spherical")
    sigma = np.sqrt(np.diag(without.uncertainty.covariance))
    names = whole.bundle.names
    off = left.values(names) - without.parameters.values(names)
    assert np.abs(off / sigma).max() < 0.02


@pytest.mark.parametrize("model", ["spherical", "planar"])
def test_a_view_that_belongs_is_predicted_to_the_noise_and_one_that_does_not_is_not(bench, model):
    rng = np.random.default_rng(102)
    views = bench.views(rng, 0.02, poses=POSES)
    centre = np.array(bench.centre) + np.array([3.0, 0.0, 0.0])
    views[2] = bench.view("moved", bench.turn(*POSES[2]), rng, 0.02, centre)
    fitted = fit_model(views, L2, model)
    bundle, parameters, squares = fitted.bundle, fitted.parameters, []
    for i in range(len(views)):
        others = without_pose(bundle, [i], parameters, fitted.loss)
        squares.append((predicted_residuals(bundle, i, parameters, others) ** 2).sum(axis=1))
    rms = np.sqrt([of_view.mean() for of_view in squares])
    if model == "spherical":
        assert rms.argmax() == 2
    assert rms[2] > 5 * 0.02 * np.sqrt(2)
    total = leave_one_out(bundle, parameters, fitted.loss)
    assert total == pytest.approx(np.sqrt(np.concatenate(squares).mean()))


def test_the_jackknife_of_views_that_agree_is_the_stated_covariance(bench):
    views = bench.views(np.random.default_rng(103), 0.05, poses=POSES)
    fitted = fit_model(views, L2, "spherical")
    ratio = np.sqrt(np.diag(jackknife(fitted)) / np.diag(fitted.uncertainty.covariance))
    # Four degrees of freedom, and views of unequal weight: a factor of two is agreement.
    assert 0.5 < np.sqrt((ratio**2).mean()) < 2.2
    assert not fitted.uncertainty.inconsistent
