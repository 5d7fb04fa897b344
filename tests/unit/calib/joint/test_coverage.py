"""Drawn benches: errors of the joint adjustment are as large as its covariance, map and boresight state."""

from dataclasses import dataclass

import numpy as np
import pytest

from calib import Calibration, CalibrationOptions, Passport, calibrate, projection_uncertainty
from calib.model.camera import CameraModel
from calib.model.gimbal_readings import GimbalReadings
from calib.model.rotation import log_map
from calib.uncertainty.projection_uncertainty import camera_difference
from simulators.world.truth import Truth
from tests.support.drawn_benches import NINE, THREE, GimbalErrors, draw_bench

CERTIFICATE_SIGMA_MM, SCALE_SIGMA = 0.05, 2e-4
BENCHES = 12


@dataclass(frozen=True)
class Drawn:
    result: Calibration
    truth: Truth
    camera_from_head: np.ndarray

    @property
    def errors(self):
        """Errors of fx, fy, cx, cy."""
        true = self.truth.camera
        return self.result.estimates[:4] - [true.fx, true.fy, true.cx, true.cy]

    @property
    def true_camera(self):
        true = self.truth.camera
        lens = {name: getattr(true, name) for name in ("k1", "k2", "p1", "p2", "k3")}
        return CameraModel(true.fx, true.fy, true.cx, true.cy, self.result.camera.image_size, lens)


def drawn(seed, profile):
    """A bench whose readings and certificate are each as wrong as stated."""
    rng = np.random.default_rng((seed, 77))
    bench = draw_bench(profile, THREE, seed, errors=GimbalErrors(0.002, SCALE_SIGMA))
    certified = bench.truth.collimator.r + CERTIFICATE_SIGMA_MM * rng.standard_normal()
    options = CalibrationOptions(
        passport=Passport.of_radius(certified, CERTIFICATE_SIGMA_MM),
        gimbal=GimbalReadings(tuple(bench.readings_deg), 0.002, SCALE_SIGMA, 0.001, None, "drawn"),
    )
    return Drawn(calibrate(bench.views, options), bench.truth, bench.camera_from_head)


@pytest.fixture(scope="module")
def benches():
    return [drawn(seed, ("like-bench", "ideal")[seed % 2]) for seed in range(BENCHES)]


@pytest.mark.slow
def test_the_covariance_holds_for_all_parameters_of_the_camera_together(benches):
    """The errors of fx, fy, cx, cy in the metric of their covariance: a chi-square with four degrees of freedom."""
    covariances = [bench.result.camera_covariance[:4, :4] for bench in benches]
    errors = [bench.errors for bench in benches]
    squares = [e @ np.linalg.solve(c, e) for e, c in zip(errors, covariances, strict=True)]
    assert 1.2 < np.mean(squares) < 6.5


@pytest.mark.slow
def test_the_map_is_as_large_as_the_errors_of_the_directions(benches):
    ratios = []
    for bench in benches:
        stated = projection_uncertainty(bench.result.camera, bench.result.camera_covariance)
        off = camera_difference(bench.result.camera, bench.true_camera).offset_px
        ratios.append(np.nanmean((off**2).sum(axis=2)) / np.nanmean(2.0 * stated.sigma_px**2))
    assert 0.15 < np.mean(ratios) < 1.1


def boresight_errors(bench):
    """Errors of the rotation about the camera's axes, and of the ray through the middle along its x and y, degrees."""
    boresight = bench.result.boresight
    turn = log_map((boresight.rotation @ bench.camera_from_head.T)[None])[0]
    width, height = bench.true_camera.image_size
    ray = bench.true_camera.rays(np.array([[(width - 1) / 2, (height - 1) / 2]]))[0]
    sight = boresight.rotation @ (boresight.sight - bench.camera_from_head.T @ ray)
    return np.degrees(turn), np.degrees(sight)[:2]


@pytest.mark.slow
def test_the_boresight_lies_within_u_of_how_the_camera_is_mounted(benches):
    boresights = [bench.result.boresight for bench in benches]
    errors = [boresight_errors(bench) for bench in benches]
    turns = np.array([turn / own.expanded_deg for (turn, _), own in zip(errors, boresights, strict=True)])
    both = zip(errors, boresights, strict=True)
    sights = np.array([ray / own.sight_expanded_deg for (_, ray), own in both])
    for over in (turns, sights):
        assert (np.abs(over) < 1.6).all()
        assert np.mean(np.abs(over) < 1.0) > 0.85
        assert np.sqrt((4.0 * over**2).mean()) > 0.4


@pytest.mark.slow
def test_an_angle_to_a_face_of_the_mount_has_the_u_of_the_ray_and_of_the_face(benches):
    boresight = benches[0].result.boresight
    straight, own = boresight.angle_to(boresight.sight, 0.0)
    assert straight == pytest.approx(0.0, abs=1e-6)
    assert own >= boresight.sight_expanded_deg.max() - 1e-9
    square, wider = boresight.angle_to(np.cross(boresight.sight, [0.0, 1.0, 0.0]), np.radians(1.0))
    assert square == pytest.approx(90.0)
    assert 2.0 < wider < 2.5


@pytest.mark.slow
def test_one_axis_alone_or_a_wrong_sign_gives_no_boresight():
    bench = draw_bench("ideal", NINE, 4)
    turned = [view for view, pose in zip(bench.views, NINE, strict=True) if pose["tilt"] == 0.0]
    along = [pose for pose in bench.readings_deg if pose["tilt_deg"] == 0.0]
    wrong = [{**pose, "pan_deg": -pose["pan_deg"]} for pose in bench.readings_deg]
    for views, readings in ((turned, along), (bench.views, wrong)):
        options = CalibrationOptions(gimbal=GimbalReadings(tuple(readings), 0.002, 0.0, 0.0, None, "drawn"))
        assert calibrate(views, options).boresight is None
    assert calibrate(bench.views, CalibrationOptions()).boresight is None
