"""The collimator "like-real" against the recordings it is to resemble: the statistics of their residuals, side by side."""

from dataclasses import replace

import numpy as np
import pytest

from calib.beam import visible_disc
from calib.calibrate import CalibrationOptions, calibrate
from calib.view import View
from simulators.optics import picture as optics
from simulators.world.truth import COLLIMATORS, CameraTruth, OpticsTruth, Truth

SIZE = (2448, 2048)
CAMERA = CameraTruth(2412.0, 2411.4, 1220.0, 1007.0, k1=-0.0895, k2=0.106, width=SIZE[0], height=SIZE[1])
STAR_SIGMA_PX = 0.007

#: Least and most of each figure, as a share of that of the recordings.
BANDS = {
    "spherical_rms": (0.85, 1.12),
    "field_rms": (0.85, 1.2),
    "planar_rms": (0.9, 1.2),
    "spherical_left_out": (0.85, 1.12),
    "field_left_out": (0.85, 1.2),
    "planar_left_out": (0.6, 1.1),
    "outer_tenth": (0.8, 1.1),
    "drift_x": (0.7, 1.3),
    "drift_y": (0.7, 1.5),
    "drift_z": (0.35, 1.2),
    "disc_x": (0.8, 1.1),
    "disc_y": (0.9, 1.2),
}


def seen(name, ids, points_px):
    covariances = np.tile(np.eye(2), (len(ids), 1, 1))
    return View(name, SIZE, ids, points_px, np.asarray(optics.TARGET.positions_mm(ids)), covariances)


def recorded(folder, number):
    rows = np.loadtxt(folder / f"image{number}.txt")
    return seen(str(number), rows[:, 4].astype(np.int64), rows[:, :2] - 0.5)


def simulated(drawn):
    """Views of one such collimator, the camera turned as widely as in the recordings."""
    rng = np.random.default_rng(drawn)
    own = replace(
        COLLIMATORS["like-real"], x=95.2, y=136.9, r=256.0, half_angle_deg=12.1, glass_seed=drawn + 1
    )
    truth = Truth(CAMERA, own, OpticsTruth(mounting_deg=(0.0, 0.0, 0.0)))
    half_rim = 0.5 * own.rim * 55.0 / optics.TARGET.pitch_mm
    views = []
    for number in range(20):
        pose = {"pan": rng.uniform(-22, 22), "tilt": rng.uniform(-16, 16), "roll": rng.normal(76, 9)}
        rotation = optics.pose_rotation(pose, truth.optics)
        ids, points = optics.star_centres(truth, rotation, border_px=20.0, clearance=-half_rim)
        if len(ids) >= 200:
            views.append(seen(str(number), ids, points + rng.normal(0.0, STAR_SIGMA_PX, points.shape)))
    return views


def figures(views):
    """Statistics of the residuals by name."""
    discs = [visible_disc(view) for view in views]
    spherical, field, planar = (
        calibrate(views, CalibrationOptions(model=model, loss="l2"))
        for model in ("spherical", "field", "planar")
    )
    squares = np.concatenate([(residual**2).sum(axis=1) for residual in spherical.residuals_px])
    rho = np.concatenate(
        [
            np.linalg.norm(v.target_mm - d.centre_mm, axis=1) / d.radius_mm
            for v, d in zip(views, discs, strict=True)
        ]
    )
    drift = planar.centres / spherical.collimator.r
    places = np.array([disc.centre_mm for disc in discs])
    return {
        "spherical_rms": spherical.rms_px,
        "field_rms": field.rms_px,
        "planar_rms": planar.rms_px,
        "spherical_left_out": spherical.left_out_rms_px,
        "field_left_out": field.left_out_rms_px,
        "planar_left_out": planar.left_out_rms_px,
        "outer_tenth": squares[rho > 0.9].sum() / squares.sum(),
        **{f"drift_{axis}": drift[:, k].std() for k, axis in enumerate("xyz")},
        **{f"disc_{axis}": np.corrcoef(drift[:, k], places[:, k])[0, 1] for k, axis in enumerate("xy")},
        "focal_gap": planar.camera.fx / field.camera.fx - 1.0,
    }


@pytest.fixture(scope="module")
def real(reference_data):
    return figures([recorded(reference_data / "collimator_real", number) for number in range(1, 21)])


@pytest.fixture(scope="module")
def drawn():
    several = [figures(simulated(number)) for number in range(4)]
    return {name: np.mean([one[name] for one in several]) for name in several[0]}


@pytest.mark.slow
@pytest.mark.parametrize("name", BANDS)
def test_residuals_are_those_of_the_recordings(real, drawn, name):
    least, most = BANDS[name]
    assert least < drawn[name] / real[name] < most


@pytest.mark.slow
def test_free_centres_make_the_focal_length_short_by_a_like_amount(real, drawn):
    assert -0.028 < drawn["focal_gap"] < -0.009
    assert -0.028 < real["focal_gap"] < -0.009
