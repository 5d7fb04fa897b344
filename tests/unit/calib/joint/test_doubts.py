"""Statements have heavy tails: agreeing data make doubt less probable, and U follows a moved statement without a step."""

from dataclasses import replace

import numpy as np
import pytest

from calib import CalibrationOptions, Passport, calibrate
from calib.joint.adjust import adjust
from calib.joint.doubts import Unstated, prior_odds
from calib.joint.knowledge import CERTIFICATE, WRONG
from calib.joint.prior import NO_FAULT
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.target_focus import CertifiedLength
from tests.benchmarks.worlds.catalogue import WORLDS
from tests.benchmarks.worlds.knowledge import options_for, views_of

POSES = ((-5.0, 2.0), (5.0, 2.5), (0.5, -2.5))
ANGLES = tuple({"pan_deg": pan, "tilt_deg": tilt} for pan, tilt in POSES)
READINGS = GimbalReadings(ANGLES, 0.002, 2e-4, 0.001, ParallaxBound(0.0, 0.01, 0.0, 1.0), "drawn")


def certified(r_mm, sigma_mm=0.05):
    passport = Passport.of_radius(r_mm, sigma_mm, length=CertifiedLength.SEEN)
    return CalibrationOptions("joint", passport=passport, gimbal=READINGS)


@pytest.fixture
def views(bench):
    return bench.views(np.random.default_rng(5), 0.02, POSES)


@pytest.fixture
def optimum(views):
    return adjust(views, certified(255.0))


def test_the_small_matrices_give_the_likelihood_and_the_camera_of_the_whole_solution(optimum):
    there = Unstated(optimum.marginal, optimum.eta)
    camera = slice(0, len(optimum.marginal.problem.bench.layout.pose.camera))
    for name, witness in there.witnesses.items():
        for doubts in (NO_FAULT, *(((name, doubt),) for doubt in witness.doubts)):
            whole = optimum.marginal.solve(optimum.eta, doubts)
            assert there.value(doubts) == pytest.approx(whole.value, abs=1e-4)
            values, sigmas = there.camera(doubts)
            assert sigmas == pytest.approx(np.sqrt(np.diag(whole.covariance)[camera]), rel=1e-4)
            found = (optimum.state.shared + whole.step)[camera]
            assert values == pytest.approx(found, rel=0.0, abs=1e-3)


def test_wider_errors_are_less_probable_and_as_if_nobody_had_stated_it_is_the_end(optimum):
    for witness in optimum.marginal.problem.knowledge.witnesses.values():
        widths = [
            float(np.trace(np.linalg.inv(own) @ doubt.covariance))
            for own, doubt in ((witness.covariance, doubt) for doubt in witness.doubts.values())
        ]
        assert widths == sorted(widths)
        *ladder, last = [doubt.odds for doubt in witness.doubts.values()]
        assert ladder == sorted(ladder, reverse=True)
        assert list(witness.doubts)[-1] == WRONG
        assert last >= 1e-3


def test_data_that_agree_make_doubt_less_probable(optimum):
    there = Unstated(optimum.marginal, optimum.eta)
    doubts = ((CERTIFICATE, WRONG),)
    log = 0.5 * (there.value(NO_FAULT) - there.value(doubts))
    assert log < 0.0
    assert prior_odds(there.witnesses, doubts) * np.exp(log) < 1e-3


@pytest.mark.slow
def test_a_certificate_two_sigma_from_what_the_others_say_moves_u_without_a_step():
    """Poses of a hand. The certificate is right, and its doubt decides how large U is."""
    bench = WORLDS["S2"](950, 3, 1, 0)
    options, expanded = options_for(bench, "cr"), []
    for moved_mm in (0.0, -0.1):
        values = options.passport.values + moved_mm
        passport = replace(options.passport, values=values, length=CertifiedLength.SEEN)
        result = calibrate(views_of(bench), replace(options, passport=passport))
        expanded.append(result.coverage_factors["fx"] * result.sigma["fx"])
        assert abs(result.camera.fx - bench.camera.values["fx"]) < expanded[-1]
    assert max(expanded) / min(expanded) < 1.2
