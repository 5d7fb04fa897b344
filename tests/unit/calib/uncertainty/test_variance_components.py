"""Variance components of inconsistent views, from residuals that neighbouring stars share."""

import numpy as np
import pytest
from monte_carlo_runs import jackknife

from calib.diagnosis.gross_stars import part_of
from calib.engine import CalibrationOptions, calibrate
from calib.fit import fit_model
from calib.uncertainty.variance_components import variance_components

L2 = CalibrationOptions(loss="l2")
#: A disc of 5.5 degrees is whole in the frame.
HALF_DEG, RADIUS_MM = 5.5, 255 * np.tan(np.deg2rad(5.5))
POSES = ((-4, 0.5), (0.5, -0.6, 50), (4, 0.3, 100), (-3, -0.5, 150))


def displaced(bench, rng, size_mm, count=3):
    """Views whose target is bent, in each its own way, by a polynomial of the second degree of rms `size_mm`."""
    bend, views = bench.project, []
    for pose in POSES[:count]:
        rows = size_mm * rng.standard_normal((2, 3))

        def project(target_mm, turn, centre, rows=rows):
            u, v = ((target_mm - bench.centre[:2]) / RADIUS_MM).T
            shapes = np.column_stack([24**0.5 * u * v, 6**0.5 * (u**2 - v**2), 12**0.5 * (u**2 + v**2 - 0.5)])
            return bend(target_mm + shapes @ rows.T, turn, centre)

        bench.project = project
        views.append(bench.view(f"pose {pose}", bench.turn(*pose), rng, 0.02))
    bench.project = bend
    return views


def of(views):
    fitted = fit_model(views, L2, "spherical")
    return fitted, variance_components(fitted.bundle, fitted.parameters, fitted.loss)


def test_stars_that_miss_each_on_its_own_show_no_field(bench):
    fitted, found = of(bench.views(np.random.default_rng(111), 0.05, poses=POSES))
    # A star's 0.05 px are 0.004 mm on the target; 300 stars a view tell a field to a tenth of that.
    assert found.sigma_mm[3:].max() < 0.001
    ratio = np.sqrt(np.diag(found.covariance) / np.diag(fitted.uncertainty.covariance))
    assert (np.abs(ratio - 1) < 0.35).all()


def test_a_bent_target_is_found_with_its_degree_and_size(make_bench):
    found = [
        of(displaced(make_bench(half_angle_deg=HALF_DEG), np.random.default_rng([112, i]), 0.005))[1]
        for i in range(8)
    ]
    sizes = np.sqrt(np.mean([one.sigma_mm**2 for one in found], axis=0))
    assert sizes[3] == pytest.approx(0.005, rel=0.4)
    assert sizes[4:].max() < 0.001
    assert all(
        np.allclose(one.covariance, one.field_covariance + one.star_covariance + one.prior_covariance)
        for one in found
    )
    assert all(1 < one.effective_degrees_of_freedom < 40 for one in found)


def test_centres_that_move_along_one_axis_are_separated_from_the_other(make_bench):
    found = []
    for i in range(8):
        bench, rng = make_bench(half_angle_deg=HALF_DEG), np.random.default_rng([115, i])
        centres = np.array(bench.centre) + rng.normal(scale=(0.05, 0.5, 0.05), size=(4, 3))
        found.append(of(bench.views(rng, 0.005, poses=POSES, centres=centres))[1])
    along_x, along_y = np.sqrt(np.mean([one.sigma_mm[:2] ** 2 for one in found], axis=0))
    assert along_y > 4 * along_x


def test_shifts_are_zero_where_each_view_has_its_own_centre_and_rounding_changes_no_sigma(make_bench):
    views = displaced(make_bench(half_angle_deg=HALF_DEG), np.random.default_rng(116), 0.005, 4)
    found = []
    for order in (slice(None), slice(None, None, -1)):
        turned = [part_of(view, np.arange(len(view))[order]) for view in views]
        fitted = fit_model(turned, L2, "planar")
        found.append(variance_components(fitted.bundle, fitted.parameters, fitted.loss))
    assert not found[0].sigma_mm[:2].any()
    one, other = (np.sqrt(np.diag(each.covariance)) for each in found)
    assert one == pytest.approx(other, rel=1e-5)


def test_sigmas_of_three_views_of_a_bent_target_are_those_of_repeated_calibrations(make_bench):
    bench = make_bench(half_angle_deg=HALF_DEG)
    z, by_stars_alone = [], []
    for i in range(16):
        result = calibrate(displaced(bench, np.random.default_rng([113, i]), 0.005), L2)
        off = result.values - [bench.truth[name] for name in result.parameter_names]
        z.append(off / list(result.sigma.values()))
        by_stars_alone.append(off / list(result.budget["stars"].values()))
        assert result.coverage_factor > 2
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    # Sigmas of three views are uncertain themselves: Student's z is wider than 1.
    assert ((rms > 0.6) & (rms < 1.6)).all()
    assert (np.sqrt(np.mean(np.square(by_stars_alone), axis=0)) > 2).all()


@pytest.mark.parametrize("count", [5, 16])
def test_from_five_views_on_sigmas_come_from_the_scores(bench, count):
    rng = np.random.default_rng(114)
    poses = [(*rng.uniform([-5, -2.5], [5, 2.5]), rng.uniform(0, 180)) for _ in range(count)]
    centres = np.array(bench.centre) + rng.normal(scale=1.0, size=(count, 3))
    fitted = fit_model(bench.views(rng, 0.02, poses=poses, centres=centres), L2, "spherical")
    known = fitted.uncertainty
    assert known.inconsistent
    assert sum(known.budget.values()) == pytest.approx(np.diag(known.covariance))
    assert 1 < known.effective_degrees_of_freedom < count - 1
    # The jackknife is larger, the more so the fewer the views.
    ratio = np.sqrt(np.diag(known.covariance) / np.diag(jackknife(fitted.cross_validation)))
    assert 0.3 < np.exp(np.log(ratio).mean()) < 1
    # Correlations are those from before the scores set the sigmas.
    correlation = known.covariance / np.sqrt(np.outer(*[np.diag(known.covariance)] * 2))
    assert (np.linalg.eigvalsh(correlation) > 0).all()
