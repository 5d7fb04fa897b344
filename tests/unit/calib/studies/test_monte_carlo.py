"""Monte Carlo studies of the stated uncertainties."""

import monte_carlo
import numpy as np
import pytest
from monte_carlo_runs import run_monte_carlo, z_of_all
from paper_camera import NARROW, POSES

from calib import CalibrationOptions, Passport, calibrate
from calib.errors import NotConverged

EXACT = Passport(("x", "y", "r"), NARROW.collimator.values, np.eye(3) * 1e-8)
L2 = CalibrationOptions("spherical", loss="l2")


def test_one_seed_gives_one_result():
    study = run_monte_carlo(NARROW, POSES, L2, 3, 5)
    assert np.array_equal(study.values, run_monte_carlo(NARROW, POSES, L2, 3, 5).values)
    assert not np.array_equal(study.values, run_monte_carlo(NARROW, POSES, L2, 3, 6).values)
    assert 0.3 < z_of_all(study) < 3


def test_stars_that_are_grossly_wrong_are_left_out_whatever_the_loss():
    plain, robust = (
        run_monte_carlo(NARROW, POSES, CalibrationOptions("spherical", loss=loss), 4, 5, outliers=0.02)
        for loss in ("l2", "huber")
    )
    clean = run_monte_carlo(NARROW, POSES, L2, 4, 5)
    assert (plain.sigmas < 4 * clean.sigmas).all()
    assert (robust.sigmas < 1.5 * clean.sigmas).all()
    assert z_of_all(robust) < 3


def test_runs_without_a_calibration_are_kept_with_their_reason(monkeypatch):
    outcomes = iter([NotConverged("The second view is upside down.", remedy="Turn it."), None, None])

    def sometimes(views, options):
        if (error := next(outcomes)) is not None:
            raise error
        return calibrate(views, options)

    monkeypatch.setattr(monte_carlo, "calibrate", sometimes)
    study = run_monte_carlo(NARROW, POSES, L2, 3, 5)
    assert len(study.values) == 2
    assert [why for why in study.failed if "upside down" in why] == list(study.failed) != []


def test_a_study_without_any_calibration_is_refused_with_the_first_reason():
    with pytest.raises(NotConverged, match=r"None of the 2 .*same pose"):
        run_monte_carlo(NARROW, POSES[:1] * 2, L2, 2, 5)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("loss", "outliers"), [("l2", 0), ("huber", 0), ("huber", 0.02), ("cauchy", 0.02)])
def test_two_sigma_intervals_cover_as_often_as_they_should(loss, outliers):
    options = CalibrationOptions("spherical", loss=loss)
    study = run_monte_carlo(NARROW, POSES, options, 500, 17, outliers=outliers)
    low, high = study.coverage_band
    assert not study.failed
    assert all(low <= share <= high for share in study.coverage.values())
    assert 0.95 < z_of_all(study) < 1.05
    # With half the sigmas the same study fails.
    halved = np.abs(study.values - study.truth) <= study.sigmas
    assert (halved.mean(axis=0) < low).all()
