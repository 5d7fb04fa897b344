"""The covariance is the scatter of repeated calibrations."""

from dataclasses import replace

import numpy as np
import pytest

from calib.engine import CalibrationOptions, calibrate
from calib.errors import DegenerateViews
from calib.view import View


def z_scores(bench, options, runs, seed, spoil=None):
    z = []
    for i in range(runs):
        rng = np.random.default_rng([seed, i])
        views = bench.views(rng, 0.05)
        if spoil:
            spoil(views, rng)
        result = calibrate(views, options)
        truth = np.array([bench.truth[name] for name in result.parameter_names])
        z.append((result.values - truth) / np.sqrt(np.diag(result.covariance)))
    return np.array(z)


def in_the_band(z):
    """Mean squares of z within 4 sigma of 1, were the sigmas right."""
    return np.abs((z**2).mean(axis=0) - 1) < 4 * np.sqrt(2 / len(z))


@pytest.mark.parametrize(
    "options", [CalibrationOptions("spherical"), CalibrationOptions(model="planar", loss="l2")]
)
def test_sigmas_are_those_of_repeated_calibrations(bench, options):
    z = z_scores(bench, options, 30, 12)
    assert in_the_band(z).all()
    assert not in_the_band(2.5 * z).any()


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("loss", ["l2", "huber", "cauchy"])
def test_sigmas_hold_over_many_runs(bench, loss):
    z = z_scores(bench, CalibrationOptions("spherical", loss=loss), 400, 13)
    assert in_the_band(z).all()
    assert not in_the_band(2.0 * z).any()
    covered = (np.abs(z) < 2).mean(axis=0)
    assert (np.abs(covered - 0.9545) < 4 * np.sqrt(0.9545 * 0.0455 / len(z))).all()


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_sigmas_hold_when_some_stars_are_bad(bench):
    def spoil(views, rng):
        for view in views:
            bad = rng.random(len(view)) < 0.05
            view.points_px[bad] += 0.5 * rng.standard_normal((bad.sum(), 2))

    z = z_scores(bench, CalibrationOptions("spherical", loss="huber"), 200, 14, spoil)
    assert in_the_band(z).all()


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
        keep = np.unique(
            [f(view.points_px @ sign) for f in (np.argmax, np.argmin) for sign in ([1, 1], [1, -1])]
        )
        return View(
            view.name,
            view.image_size,
            view.ids[keep],
            view.points_px[keep],
            view.target_mm[keep],
            view.covariances_px2[keep],
        )

    few = [corners(view) for view in bench.views()[:2]]
    with pytest.raises(DegenerateViews, match="16 measurements cannot determine 21 parameters"):
        calibrate(few, CalibrationOptions("spherical", distortion="rational"))
