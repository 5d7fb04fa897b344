"""Errors that all views share: found in the residuals, added to the uncertainty, and only where they can be told."""

from dataclasses import replace

import numpy as np
import pytest

from bench.compare.scenes import star_poses
from calib.engine import CalibrationOptions, calibrate
from calib.errors import PassportContradicted
from calib.fit import fit_model
from calib.model.passport import Passport
from calib.uncertainty.common_errors import COMMON_ERRORS, common_errors
from simulators.world.truth import COLLIMATORS
from tests.support.drawn_benches import NINE, THREE, draw_bench

CERTIFIED = CalibrationOptions(model="radial", passport=Passport.of_radius(255.0, 0.05))


def poses(count):
    return [{"pan": pan, "tilt": tilt} for pan, tilt in star_poses(count)]


def found(collimator, count, seed=1):
    return calibrate(draw_bench(collimator, poses(count), seed).views, CERTIFIED)


def share(calibration, name="fx"):
    return next(
        (row.contribution.get(name, 0.0) for row in calibration.budget_rows if row.name == COMMON_ERRORS), 0.0
    )


def test_they_do_not_average_out_with_the_number_of_views():
    few, many = found("like-bench", 9), found("like-bench", 36)
    assert share(many) > 0.7 * share(few)
    others = [np.sqrt(one.sigma["cy"] ** 2 - share(one, "cy") ** 2) for one in (few, many)]
    assert share(many, "cy") > others[1]
    assert others[1] < 0.7 * others[0]


def test_the_principal_point_lies_within_the_uncertainty():
    within = []
    for seed in range(1, 13):
        bench = draw_bench("like-bench", poses(25), seed)
        result = calibrate(bench.views, CERTIFIED)
        error = result.camera.to_dict()["cy"] - bench.truth.camera.cy
        within.append(abs(error) <= result.coverage_factor * result.sigma["cy"])
        assert share(result, "cy") > 0
    assert np.mean(within) > 0.8


def test_consistent_views_and_few_views_have_none():
    assert share(found("ideal", 9)) == 0.0
    three = calibrate(draw_bench("like-bench", THREE, 1).views, CERTIFIED)
    assert share(three) == 0.0


def test_views_with_a_centre_each_share_no_collimator():
    views = draw_bench("like-bench", NINE, 1).views
    assert COMMON_ERRORS not in calibrate(views, CalibrationOptions(model="planar")).budget


def test_the_size_of_the_displacements_is_found():
    fitted = fit_model(draw_bench("like-bench", poses(25), 1).views, CERTIFIED, "radial")
    errors = common_errors(fitted.bundle, fitted.parameters, fitted.loss)
    # The irregularity of this glass is 7.7 um over all degrees.
    assert 5e-4 < np.sqrt((errors.sigma_mm**2).sum()) < 2e-2
    assert (errors.degrees_of_freedom > 1).all()
    assert np.allclose(errors.covariance, errors.covariance.T)


def test_errors_of_single_views_are_not_taken_for_common_ones():
    # A wandering pupil sees other glass in each view; stray displacements must not add up to a common field.
    fitted = fit_model(draw_bench("S3", poses(16), 2).views, CERTIFIED, "radial")
    errors = common_errors(fitted.bundle, fitted.parameters, fitted.loss)
    at = fitted.bundle.names.index("fx")
    assert np.sqrt(errors.covariance[at, at]) < 0.01 * fitted.parameters.camera.fx


def test_too_few_stars_show_nothing():
    views = draw_bench("like-bench", poses(5), 1).views
    fitted = fit_model(views, CERTIFIED, "radial")
    kept = 8
    few = [
        replace(
            view,
            ids=view.ids[:kept],
            points_px=view.points_px[:kept],
            target_mm=view.target_mm[:kept],
            covariances_px2=view.covariances_px2[:kept],
        )
        for view in views
    ]
    small = replace(
        fitted.bundle, observations=type(fitted.bundle.observations).from_views(few), displacements=None
    )
    bare = replace(fitted.parameters, collimator=replace(fitted.parameters.collimator, aberrations={}))
    bare_bundle = replace(
        small, names=tuple(n for n in small.names if not n.startswith("radial")), prior=None
    )
    assert common_errors(bare_bundle, bare, fitted.loss) is None


def test_the_budget_still_adds_up():
    result = found("like-bench", 16)
    at = list(result.parameter_names).index("fx")
    assert sum(row.contribution.get("fx", 0.0) ** 2 for row in result.budget_rows) == pytest.approx(
        result.covariance[at, at], rel=0.02
    )


def test_one_sentence_says_what_differs_and_that_the_uncertainties_hold_it():
    result = found("like-bench", 9)
    (told,) = (note for note in result.notes if note.startswith("Views differ"))
    assert "errors that the radial model does not describe, and the uncertainties hold them" in told
    assert told not in result.remarks


def test_many_views_before_imperfect_glass_do_not_contradict_a_right_certificate():
    glass = replace(COLLIMATORS["like-bench"], rim_roll_mm=0.0, rim_irregularity_mm=0.0)
    bench = draw_bench(glass, poses(50), 1)
    result = calibrate(bench.views, CERTIFIED)
    assert abs(result.camera.fx - bench.truth.camera.fx) < result.coverage_factor * result.sigma["fx"]


def test_many_views_before_good_glass_contradict_a_wrong_certificate():
    wrong = replace(CERTIFIED, passport=Passport.of_radius(257.0, 0.05))
    with pytest.raises(PassportContradicted, match=r"The passport gives r = 257\.00"):
        calibrate(draw_bench("ideal", poses(25), 1).views, wrong)
