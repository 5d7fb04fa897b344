"""The check by the gimbal's angles, and the time that images take."""

import numpy as np
import pytest

from bench.compare.methods import bench_time_s, gimbal_ratio_error
from bench.compare.spec import ColumnConfig
from calib.model.camera import CameraModel
from calib.view import View

SIZE = (1280, 720)
TRUE = CameraModel(3345.0, 3345.0, 640.0, 360.0, SIZE, {"k1": 0.06, "k2": -0.9})
POSES = ((-6.0, 2.0), (6.0, 2.0), (0.0, -3.0))


def views_and_readings():
    """Stars of three poses: the camera is turned by pan about Y, which carries tilt about X."""
    across = np.linspace(-0.3, 0.3, 41)
    stars = np.array([[x, y, 1.0] for y in across for x in across])
    views, readings = [], []
    for pan, tilt in POSES:
        p, t = np.radians([pan, tilt])
        about_y = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
        about_x = np.array([[1, 0, 0], [0, np.cos(t), -np.sin(t)], [0, np.sin(t), np.cos(t)]])
        points = TRUE.project(stars @ (about_y @ about_x))
        seen = np.flatnonzero(((points > 0) & (points < np.array(SIZE) - 1)).all(axis=1))
        unit = np.tile(np.eye(2), (len(seen), 1, 1))
        views.append(View(f"pose {pan}", SIZE, seen, points[seen], stars[seen, :2], unit))
        readings.append({"pan_deg": pan, "tilt_deg": tilt})
    return views, readings


def test_the_true_camera_turns_as_the_gimbal_says():
    assert gimbal_ratio_error(TRUE, *views_and_readings()) == pytest.approx(0.0, abs=1e-9)


def test_a_camera_that_is_two_per_cent_too_long_turns_two_per_cent_too_little():
    long = CameraModel(1.02 * TRUE.fx, 1.02 * TRUE.fy, 640.0, 360.0, SIZE, {"k1": 0.06, "k2": -0.9})
    assert gimbal_ratio_error(long, *views_and_readings()) == pytest.approx(-0.02, abs=0.002)


def test_a_board_has_no_gimbal():
    views, _ = views_and_readings()
    assert gimbal_ratio_error(TRUE, views, ()) is None


def test_images_of_stars_take_seconds_and_boards_minutes():
    stars = bench_time_s(ColumnConfig(name="a", method="starbench", images=3))
    board = bench_time_s(ColumnConfig(name="a", method="checkerboard", images=20))
    moving = bench_time_s(ColumnConfig(name="a", method="reconstruction", images=20))
    assert stars == pytest.approx(10.1)
    assert stars < moving < board == 400.0
