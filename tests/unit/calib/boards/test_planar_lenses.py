"""The planar model with the lens options of OpenCV and of MATLAB: the same optimum as OpenCV's, and skew."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from opencv_planar import NO_TANGENTIAL, RADIAL_2, STOP, by_opencv

from calib import CalibrationOptions, View, calibrate
from calib.boards.board import Board
from calib.model.camera import CameraModel, distortion_names
from calib.model.rotation import exp_map
from tests.unit.calib.conftest import FisheyeBench

SIZE = (1280, 720)
BOARD = Board("checkerboard", 9, 6, 25.0)
TRUE = {"k1": -0.21, "k2": 0.13, "p1": 8e-4, "p2": -6e-4, "k3": -0.04, "skew": 1.7}
TURNS_DEG = ((0, 0, 5), (25, 5, 0), (-24, 8, 20), (4, 27, 50), (6, -26, 80), (-18, -17, -30), (17, -15, 10))
OPTIONS = {
    "k1k2": RADIAL_2 | NO_TANGENTIAL,
    "k1k2k3": NO_TANGENTIAL,
    "k1k2p1p2": RADIAL_2,
    "k1k2k3p1p2": 0,
}


@cache
def views(lens, sigma_px=0.0):
    """Return a view of each placement of a board; its points are float32, because OpenCV takes no others."""
    names = distortion_names(lens)
    camera = CameraModel(1105.0, 1102.0, 633.0, 352.0, SIZE, {name: TRUE[name] for name in names})
    rng = np.random.default_rng(3)
    seen_views = []
    for number, turn in enumerate(TURNS_DEG):
        rotation = exp_map(np.deg2rad(np.array(turn, float)))
        middle = np.array([30.0 * (number - 3), 20.0 * (number % 3 - 1), 420.0])
        plane = np.column_stack([BOARD.points_mm - BOARD.points_mm.mean(axis=0), np.zeros(54)])
        points = camera.project(plane @ rotation.T + middle) + sigma_px * rng.normal(size=(54, 2))
        pixels = points.astype(np.float32).astype(float)
        seen_views.append(View(f"placement {number}", SIZE, np.arange(54), pixels, BOARD.points_mm, 0.1))
    return seen_views, camera


@pytest.mark.parametrize("sigma_px", [0.0, 0.1])
@pytest.mark.parametrize("lens", OPTIONS)
def test_the_result_is_that_of_opencv_with_the_same_flags(lens, sigma_px):
    shown, camera = views(lens, sigma_px)
    _, matrix, bent, _ = by_opencv(shown, OPTIONS[lens])
    ours = calibrate(shown, CalibrationOptions("planar", lens, "l2")).camera
    np.testing.assert_allclose(ours.matrix, matrix, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(ours.coefficients[:5], bent[:5], rtol=0, atol=1e-6)
    if not sigma_px:
        np.testing.assert_allclose(ours.values, camera.values, rtol=1e-6, atol=3e-5)  # rounded points


@pytest.mark.parametrize("lens", ["k1k2skew", "k1k2k3p1p2skew"])
def test_skew_is_found_with_an_uncertainty_that_holds(lens):
    shown, camera = views(lens)
    clean = calibrate(shown, CalibrationOptions("planar", lens, "l2"))
    assert clean.camera.skew == pytest.approx(1.7, abs=1e-4)
    np.testing.assert_allclose(clean.camera.values, camera.values, rtol=1e-6, atol=1e-4)
    noisy = calibrate(views(lens, 0.1)[0], CalibrationOptions("planar", lens, "l2"))
    assert abs(noisy.camera.skew - 1.7) < 3 * noisy.sigma["skew"]
    assert 0.01 < noisy.sigma["skew"] < 0.6
    assert noisy.to_dict()["camera"]["skew"] == noisy.camera.skew


def test_a_camera_without_skew_gets_none():
    calibration = calibrate(views("k1k2")[0], CalibrationOptions("planar", "k1k2skew", "l2"))
    assert abs(calibration.camera.skew) < 1e-3


def test_a_fisheye_is_that_of_opencv():
    bench = FisheyeBench(fx=1200.0, fy=1201.0, half_angle_deg=25.0)
    bench.bent = (0.03, -0.05, 0.0, 0.0)
    shown = bench.views(poses=((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (-3, -2, 60)))
    ours = calibrate(shown, CalibrationOptions("planar", ("kb1", "kb2"), "l2")).camera
    of_cv2 = (
        cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_K3") else cv2
    )  # OpenCV 5 has all flags in one place
    held = ("FIX_K3", "FIX_K4", "FIX_SKEW", "RECOMPUTE_EXTRINSIC", "USE_INTRINSIC_GUESS")
    _, matrix, bent, _, _ = cv2.fisheye.calibrate(
        [np.column_stack([view.target_mm, np.zeros(len(view))])[None] for view in shown],
        [view.points_px[None] for view in shown],
        bench.size,
        np.array([[1210.0, 0.0, 645.0], [0.0, 1210.0, 360.0], [0.0, 0.0, 1.0]]),
        np.zeros(4),
        flags=sum(getattr(of_cv2, f"CALIB_{name}") for name in held),
        criteria=STOP,
    )
    np.testing.assert_allclose(ours.matrix, matrix, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(ours.fisheye_coefficients, np.ravel(bent), rtol=1e-3, atol=1e-5)


def test_views_that_a_lens_with_too_few_coefficients_fits_badly_say_which_may_help():
    shown, _ = views("k1k2k3p1p2", 0.01)
    fine = [replace(view, covariances_px2=0.01) for view in shown]
    (note,) = calibrate(fine, CalibrationOptions("planar", "k1k2")).notes
    assert "The lens may need other coefficients (such as k1k2k3p1p2 or fisheye)" in note
    assert calibrate(fine, CalibrationOptions("planar", "k1k2k3p1p2")).notes == ()


def test_a_board_says_that_it_does_not_choose_a_lens():
    shown, _ = views("k1k2")
    unused = CalibrationOptions("planar", "auto").unused
    assert "the choice of a lens model (auto); name the coefficients" in unused
    assert unused in calibrate(shown, CalibrationOptions("planar", "auto")).notes
    assert CalibrationOptions("joint", "auto").unused == ""
