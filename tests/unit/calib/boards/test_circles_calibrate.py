"""A camera calibrated from photographs of circles is right: no bias by perspective, blur, or the lens."""

import cv2
import numpy as np
import pytest
from circle_photographs import photograph

from calib import CalibrationOptions, calibrate
from calib.boards.board import Board
from calib.boards.detect import detect_board

SIZE = (960, 600)
MATRIX = np.array([[680.0, 0, 484], [0, 681.5, 294], [0, 0, 1]])
TURNS = [(0.5, 0.0), (-0.5, 0.0), (0.0, 0.55), (0.0, -0.55), (0.35, 0.35)]
MILD, STRONG = (-0.1, 0.05, 0, 0, 0), (-0.33, 0.12, 0, 0, -0.02)

CASES = {
    "dark on light": ("circles:9x6:30mm", 0.28, MILD, {}),
    "light on dark": ("circles:9x6:30mm", 0.28, MILD, {"light_on_dark": True, "blur_px": 0.8}),
    "small": ("circles:9x6:30mm", 0.13, MILD, {"blur_px": 0.8}),
    "large": ("circles:9x6:30mm", 0.35, MILD, {"blur_px": 0.8}),
    "blur and gamma": ("circles:9x6:30mm", 0.28, MILD, {"blur_px": 1.2, "gamma": 2.2}),
    "strong distortion": ("circles:9x6:30mm", 0.28, STRONG, {"blur_px": 0.8}),
    "asymmetric": ("asymmetric-circles:4x11:20mm", 0.4, MILD, {"blur_px": 0.8, "light_on_dark": True}),
    "strong tilt": ("circles:7x5:36mm", 0.3, MILD, {"blur_px": 0.8, "steeper": 1.7}),
}
#: All but this one take long together.
QUICK = "small"


def placed(board, turn, rng):
    """A rotation vector and a translation, mm, that show all of the board."""
    turn = np.array([*turn, 0.0]) + 0.03 * rng.normal(size=3)
    middle = np.append(board.points_mm.mean(axis=0), 0.0)
    far = 2.1 * np.ptp(board.points_mm, axis=0).max()
    return turn, np.array([*rng.normal(0, 8, 2), far]) - cv2.Rodrigues(turn)[0] @ middle


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=() if case == QUICK else pytest.mark.slow) for case in CASES]
)
def test_circles_give_the_camera_within_its_uncertainty_and_a_fiftieth_of_a_per_cent(case):
    text, share, lens, optics = CASES[case]
    optics, board, rng = dict(optics), Board.parse(text), np.random.default_rng(3)
    steeper, views = optics.pop("steeper", 1.0), []
    for number, turn in enumerate(TURNS):
        where = placed(board, steeper * np.array(turn), rng)
        lens_of = (MATRIX, np.array(lens, float))
        picture = photograph(board, share * board.pitch_mm, lens_of, where, SIZE, **optics)
        noisy = (picture + 1.5 * rng.normal(size=picture.shape)).clip(0, 255).round()
        views.append(detect_board(noisy, board, name=str(number)))
    answer = calibrate(views, CalibrationOptions(model="planar", distortion="k1k2k3" if lens[4] else "k1k2"))
    truth = dict(zip(("fx", "fy", "cx", "cy"), MATRIX[[0, 1, 0, 1], [0, 1, 2, 2]], strict=True))
    off = {name: answer.values[name] - value for name, value in truth.items()}
    # 32 numbers: three sigma, since one or two of them lie beyond two by chance
    assert {n: e for n, e in off.items() if abs(e) > 3 * answer.sigma[n]} == {}
    assert max(abs(off["fx"]), abs(off["fy"])) < 2e-4 * MATRIX[0, 0]
