"""Boards in front of the simulated camera: in drawn pictures and in event images, beside OpenCV's finders."""

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


def by_opencv(grey, board):
    """Points as OpenCV's finders locate them."""
    size = (board["columns"], board["rows"])
    if board["kind"] == "checkerboard":
        flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        ok, points = cv2.findChessboardCornersSB(grey, size, flags=flags)
    else:
        symmetric = board["kind"] == "circles"
        grid = cv2.CALIB_CB_SYMMETRIC_GRID if symmetric else cv2.CALIB_CB_ASYMMETRIC_GRID
        chosen = cv2.SimpleBlobDetector.Params()
        chosen.minArea, chosen.maxArea, chosen.minDistBetweenBlobs = 100.0, 20_000.0, 10.0
        chosen.filterByCircularity = False
        blobs = cv2.SimpleBlobDetector.create(chosen)
        ok, points = cv2.findCirclesGrid(grey, size, flags=grid | cv2.CALIB_CB_CLUSTERING, blobDetector=blobs)
    assert ok
    return points.reshape(-1, 2).astype(float)


def errors(points, true):
    """Errors of points in the order of the true ones; a finder may begin at any end of a board."""
    nearest = np.linalg.norm(true[:, None] - points[None], axis=2).argmin(axis=1)
    assert len(set(nearest)) == len(true)
    return points[nearest] - true


@pytest.mark.parametrize("board", [CHECKER, CIRCLES, ASYMMETRIC], ids=lambda board: board["kind"])
def test_in_a_drawn_picture_our_detector_and_opencv_are_right_to_a_tenth_of_a_pixel(board):
    camera = camera_before(board)
    grey = np.uint8(np.clip(250 * camera.picture({}), 0, 255))
    described = Board(board["kind"], board["columns"], board["rows"], float(board["pitch_mm"]))
    for points in (detect_board(grey, described).points_px, by_opencv(grey, board)):
        assert np.sqrt((errors(points, camera.board_corners_px()) ** 2).mean()) < 0.1


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
