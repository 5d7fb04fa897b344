"""Boards in front of the simulated camera: where they are in event images, and where OpenCV projects their points."""

import cv2
import numpy as np
import pytest
from virtual_camera import VirtualCamera

from calib import flicker_from_events, make_images
from calib.boards.board import Board
from calib.boards.detect import detect_board

LENS = {"focus_distance_m": 1.3, "f_number": 4}
CHECKER = {"kind": "checkerboard", "columns": 11, "rows": 7, "pitch_mm": 20}
CIRCLES = {"kind": "circles", "columns": 9, "rows": 6, "pitch_mm": 25}
ASYMMETRIC = {"kind": "asymmetric-circles", "columns": 5, "rows": 9, "pitch_mm": 16}
PLACED = {"position_mm": (6.0, -8.0, 1350.0), "turn_deg": (14.0, -19.0, 11.0)}


def camera_before(board):
    return VirtualCamera({"screen": {**board, **PLACED}, "lens": LENS}, 1)


def errors(points, true):
    """Errors of points in the order of the true ones; a finder may begin at any end of a board."""
    nearest = np.linalg.norm(true[:, None] - points[None], axis=2).argmin(axis=1)
    assert len(set(nearest)) == len(true)
    return points[nearest] - true


@pytest.mark.parametrize("board", [CHECKER, CIRCLES, ASYMMETRIC], ids=lambda board: board["kind"])
def test_in_an_event_image_a_board_is_where_the_truth_puts_it(board):
    camera = camera_before(board)
    seen = camera.capture({}, seed=3)
    t, x, y, p = seen.events
    images = make_images(
        t, x, y, p, seen.image_size, flicker_from_events(t, p), window_us=(0.0, seen.duration_us)
    )
    described = Board(board["kind"], board["columns"], board["rows"], float(board["pitch_mm"]))
    error = errors(detect_board(images.best().image, described).points_px, camera.board_corners_px())
    assert np.sqrt((error**2).mean()) < 0.1
    assert np.abs(error.mean(axis=0)).max() < 0.1


def test_the_points_of_a_drawn_board_lie_where_opencv_projects_them():
    camera = VirtualCamera({"screen": {**CHECKER, **PLACED}, "optics": {"mounting_deg": [0.0, 0.0, 0.0]}}, 1)
    truth = camera.truth()["camera"]
    x, y = np.meshgrid(20.0 * np.arange(11) - 100.0, 20.0 * np.arange(7) - 60.0)
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(77)])
    matrix = np.array([[truth["fx"], 0, truth["cx"]], [0, truth["fy"], truth["cy"]], [0, 0, 1.0]])
    lens = np.array([truth["k1"], truth["k2"], 0.0, 0.0])
    turn, place = np.radians(PLACED["turn_deg"]), np.array(PLACED["position_mm"])
    expected, _ = cv2.projectPoints(points, turn, place, matrix, lens)
    np.testing.assert_allclose(camera.board_corners_px(), expected.reshape(-1, 2), atol=1e-9)
