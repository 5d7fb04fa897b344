"""Drawn benches: errors of the joint adjustment are as large as it states, in its values, covariance and map."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from calib import Calibration, CalibrationOptions, Passport, calibrate, projection_uncertainty
from calib.joint.knowledge import STEADY
from calib.model.camera import CameraModel
from calib.model.gimbal_readings import GimbalReadings
from calib.uncertainty.projection_uncertainty import camera_difference
from simulators.world.truth import Truth
from tests.support.drawn_benches import NINE, THREE, GimbalErrors, draw_bench

CERTIFICATE_SIGMA_MM, SCALE_SIGMA = 0.05, 2e-4
BENCHES = 12


@dataclass(frozen=True)
class Drawn:
    result: Calibration
    truth: Truth

    @property
    def errors(self):
        """Errors of fx, fy, cx, cy."""
        true = self.truth.camera
        return self.result.values[:4] - [true.fx, true.fy, true.cx, true.cy]

    @property
    def expanded(self):
        """U of fx, fy, cx, cy."""
        found = self.result
        return np.array(
            [found.sigma[name] * found.coverage_factors[name] for name in ("fx", "fy", "cx", "cy")]
        )

    @property
    def true_camera(self):
        true = self.truth.camera
        lens = {name: getattr(true, name) for name in ("k1", "k2", "p1", "p2", "k3")}
        return CameraModel(true.fx, true.fy, true.cx, true.cy, self.result.camera.image_size, lens)


def drawn(seed, profile):
    """A bench with readings and a certificate, each as wrong as it states."""
    rng = np.random.default_rng((seed, 77))
    bench = draw_bench(profile, THREE, seed, errors=GimbalErrors(0.002, SCALE_SIGMA))
    certified = bench.truth.collimator.r + CERTIFICATE_SIGMA_MM * rng.standard_normal()
    options = CalibrationOptions(
        passport=Passport.of_radius(certified, CERTIFICATE_SIGMA_MM),
        gimbal=GimbalReadings(tuple(bench.readings_deg), 0.002, SCALE_SIGMA, 0.001, None, "drawn"),
    )
    return Drawn(calibrate(bench.views, options), bench.truth)


@pytest.fixture(scope="module")
def benches():
    return [drawn(seed, ("like-bench", "ideal")[seed % 2]) for seed in range(BENCHES)]


def test_errors_of_the_camera_lie_within_u_and_fill_it(benches):
    over = np.array([one.errors / one.expanded for one in benches])
    assert (np.abs(over) < 1.6).all()
    assert np.mean(np.abs(over) < 1.0) > 0.85
    rms = np.sqrt((4.0 * over**2).mean(axis=0))
    assert (rms > 0.5).all()
    assert (rms < 1.4).all()


def test_the_covariance_holds_for_all_parameters_of_the_camera_together(benches):
    """The errors of fx, fy, cx, cy in the metric of their covariance: a chi-square with four degrees of freedom."""
    squares = [
        float(one.errors @ np.linalg.solve(one.result.camera_covariance[:4, :4], one.errors))
        for one in benches
    ]
    assert 1.5 < np.mean(squares) < 6.5


def test_the_map_is_as_large_as_the_errors_of_the_directions(benches):
    ratios = []
    for one in benches:
        stated = projection_uncertainty(one.result.camera, one.result.camera_covariance)
        off = camera_difference(one.result.camera, one.true_camera).offset_px
        ratios.append(np.nanmean((off**2).sum(axis=2)) / np.nanmean(2.0 * stated.sigma_px**2))
    assert 0.15 < np.mean(ratios) < 1.1


def test_a_focal_length_that_drifts_from_pose_to_pose_is_named_with_its_size():
    views = draw_bench("like-bench", NINE, 31).views
    middle = np.array([639.5, 359.5])
    drifting = [
        replace(view, points_px=middle + (1.0 + 1e-4 * k) * (view.points_px - middle))
        for k, view in enumerate(views)
    ]
    steady, moved = (
        next(one for one in calibrate(some, CalibrationOptions()).witnesses if one.name == STEADY)
        for some in (views, drifting)
    )
    assert steady.fault_probability < 0.1
    assert moved.fault_probability > 0.9
    assert moved.expected - steady.expected == pytest.approx(8e-4, rel=0.2)
