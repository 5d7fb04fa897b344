"""Boards in front of the simulated camera, as OpenCV's finders see them in pictures of event counts."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.boards.board import Board
from calib.boards.detect import detect_board
from calib.events.event_image import make_images
from calib.events.flicker import flicker_from_events
from drivers.camera.evt3 import Evt3Decoder
from simulators.config import bench_config
from simulators.optics import scene
from simulators.pixels.sensor_stream import CameraState, SensorStream
from simulators.world.board import BoardState
from simulators.world.world import LightState, World

LENS = {"focus_distance_m": 1.3, "f_number": 4}
CHECKER = {"kind": "checkerboard", "columns": 11, "rows": 7, "pitch_mm": 20}
SCREEN = {**CHECKER, "pixel_mm": 0.25, "fill": 0.85, "refresh_hz": 120}
PRINT = {**CHECKER, "surface": "print"}
CIRCLES = {"kind": "circles", "columns": 9, "rows": 6, "pitch_mm": 25}
ASYMMETRIC = {"kind": "asymmetric-circles", "columns": 5, "rows": 9, "pitch_mm": 16}
DOTS = {"kind": "blinking-dots", "columns": 7, "rows": 5, "pitch_mm": 30, "dot_mm": 8}
SECTORS = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY


def truth_of(board, number=1, **sections):
    """Truth of a bench with a board at one of its placements."""
    board = {"anywhere": {"distance_mm": 1350, "tilt_deg": 30}, **board}
    truth = bench_config({"board": board, "lens": LENS, **sections}).truth_for(1)
    return replace(truth, board=truth.board.in_state(BoardState(number)))


def counted(truth, frames=18):
    """Picture of a recording of 36 ms: events of a pixel, 8 bit."""
    world = World(truth, clock=lambda: 100.0)
    world.set_light(LightState(output=True, sync=True))
    stream = SensorStream(world, CameraState(trigger_in=True), {})
    words = np.frombuffer(b"".join(stream.next_frame() for _ in range(frames)), "<u2")
    count = np.zeros((720, 1280))
    for events, _ in Evt3Decoder(1280, 720).decode(words):
        np.add.at(count, (events.y, events.x), 1)
    top = max(float(np.quantile(count, 0.95)), 4.0)
    return np.uint8(np.clip(255 * count / top, 0, 255))


def blobs():
    """OpenCV's detector of dark blobs."""
    chosen = cv2.SimpleBlobDetector.Params()
    chosen.minArea, chosen.maxArea, chosen.minDistBetweenBlobs = 100.0, 20_000.0, 10.0
    chosen.filterByCircularity = False
    return cv2.SimpleBlobDetector.create(chosen)


def found(grey, board):
    """Points as OpenCV finds them, or None."""
    size = (board["columns"], board["rows"])
    if board["kind"] == "checkerboard":
        ok, points = cv2.findChessboardCornersSB(grey, size, flags=SECTORS)
    else:
        if board["kind"] == "blinking-dots":
            grey = 255 - cv2.GaussianBlur(grey, (0, 0), 1.5)
        else:
            grey = cv2.medianBlur(grey, 5)
        grid = (
            cv2.CALIB_CB_ASYMMETRIC_GRID
            if board["kind"] == "asymmetric-circles"
            else cv2.CALIB_CB_SYMMETRIC_GRID
        )
        ok, points = cv2.findCirclesGrid(
            grey, size, flags=grid | cv2.CALIB_CB_CLUSTERING, blobDetector=blobs()
        )
    return points.reshape(-1, 2).astype(float) if ok else None


def errors(points, true):
    """Errors of points in the order of the true ones; OpenCV may begin at any end of a board."""
    nearest = np.linalg.norm(true[:, None] - points[None], axis=2).argmin(axis=1)
    assert len(set(nearest)) == len(true)
    return points[nearest] - true


@pytest.mark.parametrize("board", [SCREEN, PRINT, CIRCLES, ASYMMETRIC, DOTS], ids=lambda board: board["kind"])
def test_in_a_rendered_picture_opencv_is_right_to_a_twentieth_of_a_pixel(board):
    truth = truth_of(board)
    grey = np.uint8(np.clip(250 * scene.picture(truth, {}), 0, 255))
    error = errors(found(grey, board), scene.corners(truth, {}))
    assert np.sqrt((error**2).mean()) < 0.05


@pytest.mark.parametrize(
    ("board", "rms_px"),
    [
        pytest.param(SCREEN, 0.15, id="screen", marks=pytest.mark.slow),
        pytest.param({**SCREEN, "scan": 0.9}, 0.1, id="screen line by line"),
        pytest.param(PRINT, 0.15, id="print", marks=pytest.mark.slow),
        pytest.param(CIRCLES, 0.1, id="circles"),
        pytest.param(ASYMMETRIC, 0.1, id="asymmetric circles", marks=pytest.mark.slow),
        pytest.param(DOTS, 0.1, id="blinking dots"),
    ],
)
def test_opencv_finds_each_board_where_the_truth_puts_it(board, rms_px):
    truth = truth_of(board)
    points = found(counted(truth), board)
    assert points is not None
    error = errors(points, scene.corners(truth, {}))
    assert np.sqrt((error**2).mean()) < rms_px
    assert np.abs(error.mean(axis=0)).max() < 0.1


def test_a_screen_that_is_drawn_line_by_line_keeps_its_height():
    truth = truth_of({**SCREEN, "scan": 0.9})
    world = World(truth, clock=lambda: 100.0)
    world.set_light(LightState(output=True, sync=True))
    stream = SensorStream(world, CameraState(trigger_in=True), {})
    words = np.frombuffer(b"".join(stream.next_frame() for _ in range(26)), "<u2")
    parts = [events for events, _ in Evt3Decoder(1280, 720).decode(words)]
    t, x, y, p = (np.concatenate([getattr(part, name) for part in parts]) for name in "txyp")
    flicker = flicker_from_events(t, p)
    images = make_images(t, x, y, p, (1280, 720), flicker, window_us=(float(t[0]), float(t[-1])))
    true = scene.corners(truth, {})
    slopes = {}
    for one_phase in (True, False):
        chosen = images.best(one_phase=one_phase)
        error = errors(detect_board(chosen.image, Board("checkerboard", 11, 7, 20.0)).points_px, true)
        slopes[chosen.name] = np.polyfit(true[:, 1], error[:, 1], 1)[0]
    assert abs(slopes["count"]) < 1e-4
    assert abs(slopes["lock-in"]) > 1.5e-4  # its sum is smaller for lines that change early or late


@pytest.mark.slow
def test_a_planar_calibration_by_opencv_gives_the_breathed_camera():
    objects, images, truth = [], [], None
    for number in range(1, 13):
        truth = truth_of({**SCREEN, "hand": {"scatter_mm": 3}}, number)
        points = found(counted(truth), SCREEN)
        if points is None:
            continue
        true = scene.corners(truth, {})
        images.append((errors(points, true) + true).astype(np.float32)[:, None])
        row, column = np.mgrid[:7, :11]
        grid = np.column_stack([20.0 * column.ravel(), 20.0 * row.ravel(), np.zeros(77)])
        objects.append(grid.astype(np.float32)[:, None])
    assert len(images) >= 10
    guess = np.array([[3300.0, 0, 639.5], [0, 3300.0, 359.5], [0, 0, 1.0]])
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    _, matrix, *_, sigma, _, _ = cv2.calibrateCameraExtended(
        objects, images, (1280, 720), guess, None, flags=flags
    )
    breathed = 3345.06 * 1300.0 / (1300.0 - 3345.165 * 4.86e-3)  # f (1 + m), f in mm
    assert abs(matrix[0, 0] - breathed) < 3.5 * sigma[0, 0]
    assert sigma[0, 0] < 0.004 * breathed
    assert abs(breathed - 3345.06) > 2.0 * sigma[0, 0]
