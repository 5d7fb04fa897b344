"""The command `check`, on views made here, and what `rig` and `convert` refuse."""

import json
import re

import cv2
import numpy as np
import pytest
from calling import out_of, refusal

from tests.unit.bench.commands import test_engine_commands

points = test_engine_commands.points
pytestmark = pytest.mark.usefixtures("calibrated_once")


CAMERA_INFO = """
image_width: 1280
image_height: 720
camera_name: mine
camera_matrix: {{rows: 3, cols: 3, data: [{f}, 0, {cx}, 0, {f}, {cy}, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [{k1}, {k2}, 0, 0, 0]}}
"""


@pytest.fixture
def camera_info(points, tmp_path):
    """The true camera of the points as ROS writes it; with a longer lens, if one wishes."""

    def write(longer=1.0):
        true = points[1].camera
        lens = {name: true.distortion.get(name, 0.0) for name in ("k1", "k2")}
        text = CAMERA_INFO.format(f=longer * true.fx, cx=true.cx, cy=true.cy, **lens)
        (tmp_path / "camera_info.yaml").write_text(text)
        return tmp_path / "camera_info.yaml"

    return write


def test_a_camera_that_did_not_change_is_right_within_u(capsys, points, camera_info):
    shown = out_of(capsys, "check", points[0], "--image-size", "1280x720", "--calibration", camera_info())
    assert shown.startswith("RIGHT within U")
    assert "can stay unseen" in shown
    assert "states no uncertainty" in shown


def test_a_calibration_is_not_checked_by_its_own_views(capsys, points, camera_info, tmp_path):
    words = ("check", tmp_path, "--image-size", "1280x720", "--calibration", camera_info())
    assert "the same views" in refusal(capsys, *words, status=2)


def test_a_lens_that_became_longer_is_told_with_its_place_and_cause(capsys, points, camera_info):
    words = ["check", points[0], "--image-size", "1280x720", "--calibration", camera_info(longer=1.01)]
    answer = json.loads(out_of(capsys, *words, "--json", status=1))
    assert (answer["right"], answer["cause"]) == (False, "scale")
    assert max(region["normalised"] for region in answer["regions"]) > 1
    assert "NOT RIGHT" in (shown := out_of(capsys, *words, status=1))
    assert "change of scale" in shown


def test_one_view_without_a_known_collimator_says_what_it_can_see(capsys, points, camera_info, tmp_path):
    words = ["check", points[0] / "view1.csv", "--image-size", "1280x720", "--calibration"]
    shown = out_of(capsys, *words, camera_info())
    assert shown.startswith(
        "One view without a known collimator: judged is only what no other pose explains."
    )
    assert "RIGHT as far as" in shown
    assert "seen from: scale" in shown
    answer = json.loads(out_of(capsys, *words, camera_info(), "--json"))
    assert (answer["one_view"], answer["right"]) == (True, True)
    assert answer["seen_from"]["scale"] > 0.001
    true = points[1].camera  # a file without a size, as OpenCV's tutorial writes it
    np.savez(tmp_path / "calib.npz", mtx=true.matrix, dist=true.coefficients[:5])
    assert "RIGHT as far as" in out_of(capsys, *words, tmp_path / "calib.npz")


LENSES = {
    "tangential": ("plumb_bob", [-0.21, 0.11, 4e-4, -6e-4, 0.0]),
    "fisheye": ("equidistant", [-0.03, 0.011, -0.006, 0.002]),
}


@pytest.mark.parametrize(("model", "lens"), LENSES.values(), ids=LENSES)
def test_a_right_camera_is_right_by_views_of_a_board_whatever_lens_it_has(capsys, tmp_path, model, lens):
    matrix, noise = np.array([[1050.0, 0, 644.0], [0, 1049.0, 357.0], [0, 0, 1]]), np.random.default_rng(3)
    board_mm = np.array([(x, y, 0.0) for y in range(6) for x in range(9)]) * 30.0
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    for number in range(8):
        turn = np.array([0.4 * np.sin(number), 0.4 * np.cos(number), 0.05 * number])
        shift = np.array([50.0 * np.cos(2 * number) - 120, 25.0 * np.sin(2 * number) - 75, 560.0])
        seen = project(board_mm[:, None], turn, shift, matrix, np.array(lens))[0].reshape(-1, 2)
        rows = np.column_stack([seen + 0.5 + noise.normal(0, 0.02, seen.shape), board_mm[:, :2], range(54)])
        np.savetxt(tmp_path / f"board{number}.csv", rows, fmt=["%.6f"] * 4 + ["%d"])
    stated = tmp_path / "camera_info.yaml"
    stated.write_text(
        f"image_width: 1280\nimage_height: 720\ncamera_matrix: {{data: {matrix.ravel().tolist()}}}\n"
        f"distortion_model: {model}\ndistortion_coefficients: {{data: {lens}}}\n"
    )
    points = sorted(tmp_path.glob("*.csv"))
    words = ["check", *points, "--image-size", "1280x720", "--board", "checkerboard:9x6:30mm"]
    assert out_of(capsys, *words, "--calibration", stated).startswith("RIGHT")


def test_a_rig_without_a_common_pose_is_refused_before_any_calibration(capsys, points, tmp_path, monkeypatch):
    for file in points[0].iterdir():
        (tmp_path / f"other-{file.name}").write_bytes(file.read_bytes())
    monkeypatch.setattr("bench.solve.solution.calibrate", lambda *_: pytest.fail("calibrated"))
    message = refusal(capsys, "rig", points[0], tmp_path, "--image-size", "1280x720")
    assert re.search("view1.*view5 and other-view1", message)
