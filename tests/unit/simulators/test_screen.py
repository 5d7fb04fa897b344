"""The checkerboard on a screen: its corners where OpenCV projects and finds them."""

import cv2
import numpy as np
import pytest

from drivers.camera.evt3 import Evt3Decoder
from simulators.config import bench_config
from simulators.errors import SimulationMisuse
from simulators.optics import scene
from simulators.pixels.biases import FACTORY
from simulators.pixels.sensor_stream import CameraState, SensorStream
from simulators.world.truth import CameraTruth, OpticsTruth, ScreenTruth, Truth
from simulators.world.world import AxisMotion, LightState, World

CAMERA = CameraTruth(fx=420.0, fy=421.0, cx=159.0, cy=91.0, k1=-0.1, k2=0.05, width=320, height=180)
TURN_DEG = tuple(np.degrees([0.2, -0.3, 0.1]).tolist())
MIDDLE = (5.0, -3.0, 300.0)


def screen(middle_mm=MIDDLE):
    return Truth(
        camera=CAMERA,
        screen=ScreenTruth(7, 4, 20.0, middle_mm, TURN_DEG),
        optics=OpticsTruth(mounting_deg=(0.0, 0.0, 0.0)),
    )


def test_corners_lie_where_opencv_projects_them():
    x, y = np.meshgrid(20.0 * np.arange(7) - 60.0, 20.0 * np.arange(4) - 30.0)
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(28)])
    matrix = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1.0]])
    distortion = np.array([CAMERA.k1, CAMERA.k2, 0.0, 0.0])
    expected, _ = cv2.projectPoints(points, np.radians(TURN_DEG), np.array(MIDDLE), matrix, distortion)
    np.testing.assert_allclose(scene.corners(screen(), {}), expected.reshape(-1, 2), atol=1e-9)


def test_opencv_refines_the_rendered_corners_to_their_true_places():
    picture = scene.picture(screen(), {})
    true = scene.corners(screen(), {})
    eight_bit = np.uint8(np.round(255 * picture))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    start = (true + 0.4).astype(np.float32).reshape(-1, 1, 2)
    found = cv2.cornerSubPix(eight_bit, start, (5, 5), (-1, -1), criteria).reshape(-1, 2)
    assert np.abs(found - true).max() < 0.12  # the refinement's own, of either sign
    assert np.abs((found - true).mean(axis=0)).max() < 0.02
    assert picture.min() >= 0.0
    assert picture.max() <= 1.0 + 1e-6


def test_the_screen_is_dark_around_the_board():
    corners = scene.corners(screen(), {})
    assert scene.picture(screen(), {})[:, : int(corners[:, 0].min()) - 40].max() == 0.0


def test_a_board_behind_the_camera_is_refused():
    with pytest.raises(SimulationMisuse):
        scene.picture(screen((5.0, -3.0, -300.0)), {})


def test_the_camera_streams_the_board_that_its_station_puts_before_it():
    camera = {"fx": 420, "fy": 421, "cx": 159, "cy": 91, "k1": -0.1, "k2": 0.05, "width": 320, "height": 180}
    section = {
        "columns": 7,
        "rows": 4,
        "square_mm": 20,
        "position_mm": [5, -3, 300],
        "turn_deg": [10, -15, 6],
    }
    truth = bench_config({"camera": camera, "screen": section, "noise": "none"}).truth
    world = World(truth)
    world.set_axis("pan", AxisMotion.resting(2.0, 12_800))
    world.set_light(LightState(output=True))
    stream = SensorStream(world, CameraState(dict(FACTORY)), {})
    words = np.frombuffer(b"".join(stream.next_frame() for _ in range(10)), "<u2")
    shown = scene.picture(truth, {"pan": 2.0})
    fired = np.zeros(shown.shape, bool)
    for events, _ in Evt3Decoder(320, 180).decode(words):
        fired[events.y, events.x] = True
    assert fired[shown > 0.9].mean() > 0.99
    assert not fired[shown < 0.02].any()
    corners = scene.corners(truth, {"pan": 2.0})
    assert corners.shape == (28, 2)
    assert ((corners > 0) & (corners < [320, 180])).all()
