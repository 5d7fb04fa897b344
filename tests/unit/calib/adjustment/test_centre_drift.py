"""The drift of the centre is measured, and a note warns of it."""

from dataclasses import replace

import numpy as np
import pytest

from calib.adjustment.centre_drift import centre_drift
from calib.engine import CalibrationOptions, calibrate
from calib.fit import fit_model

POSES = ((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (-3, -2, 60), (3, 0, 130), (0, 1, 75))
L2 = CalibrationOptions(loss="l2")


def wandering(bench, sigma_mm, seed):
    rng = np.random.default_rng(seed)
    centres = np.array(bench.centre) + rng.normal(scale=sigma_mm, size=(6, 3))
    return bench.views(rng, 0.02, poses=POSES, centres=centres)


def test_centre_drift_is_measured_in_shares_of_the_radius(bench):
    found = [
        centre_drift(one.bundle, one.parameters, one.loss)
        for one in (fit_model(wandering(bench, 0.5, seed), L2, "spherical") for seed in range(5))
    ]
    assert np.sqrt(np.mean(np.square(found), axis=0))[:2] == pytest.approx(0.5 / 255, rel=0.4)


def test_it_does_not_matter_in_which_unit_the_stars_covariances_are(bench):
    views = wandering(bench, 0.5, 7)
    scaled = [replace(view, covariances_px2=1e-4 * view.covariances_px2) for view in views]
    found = [
        centre_drift(one.bundle, one.parameters, one.loss)
        for one in (fit_model(views, L2, "spherical"), fit_model(scaled, L2, "spherical"))
    ]
    assert found[1] == pytest.approx(found[0], rel=1e-3)


def test_a_note_warns_of_a_drift_that_biases(bench):
    warned = calibrate(wandering(bench, 0.5, 1), L2)
    assert any("The centre moves by" in note and "% of r" in note for note in warned.notes)
    assert warned.coverage_factor > 2.1


def test_a_steady_centre_is_not(bench):
    assert calibrate(wandering(bench, 0.0, 2), L2).notes == ()
