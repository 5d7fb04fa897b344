"""Comparison of methods, a benchmark: its columns, one repetition, its table, one image by angles, the gimbal's check."""

import numpy as np
import pytest

from calib import CameraModel, StarTarget, View
from calib.model.rotation import exp_map
from tests.benchmarks.compared.by_others import calibrate_by_angles
from tests.benchmarks.compared.columns import Column
from tests.benchmarks.compared.gimbal_check import gimbal_ratio_error
from tests.benchmarks.compared.methods import compare_with_truth, rows_of

TRUE = CameraModel(3345.06, 3345.27, 642.1, 363.32, (1280, 720), {"k1": 0.06, "k2": -0.9})


def test_a_rotated_camera_is_the_same_camera_and_a_longer_one_is_not():
    same = compare_with_truth(TRUE, TRUE, {"fx": 1.0}, 2.0)
    assert same["direction_worst_urad"] < 1e-3
    assert same["covered"]["fx"]
    longer = CameraModel(3352.06, 3352.27, 642.1, 363.32, (1280, 720), {"k1": 0.06, "k2": -0.9})
    other = compare_with_truth(longer, TRUE, {"fx": 1.0}, 2.0)
    # At a corner, 735 px from the centre, the angle shrinks by 735 / f^2 * 7 px.
    assert other["corner_urad"] == pytest.approx(1e6 * 735 / 3345**2 * 7.0, rel=0.15)
    assert other["errors"]["fx"] == pytest.approx(7.0)
    assert not other["covered"]["fx"]


@pytest.mark.slow
def test_one_repetition_gives_every_method_the_same_images_and_compares_with_the_truth():
    ours, zhang = (Column(name=method, method=method) for method in ("starbench", "zhang"))
    certified = Column(name="certified", method="starbench", passport=True, readings=True)
    rows = rows_of((ours, zhang, certified), 5)
    assert {row["views"] for row in rows.values()} == {3}
    assert len({row["images_cpu_s"] for row in rows.values()}) == 1
    for result in rows.values():
        assert abs(result["errors"]["fx"]) < 10.0
        assert result["direction_rms_urad"] < 400.0
    assert rows["certified"]["sigma"]["fx"] < rows["starbench"]["sigma"]["fx"]


# ---------------------------------------------------------------- one image by angles

CENTRE_MM, R_MM = (97.0, 140.0), 255.0


def star_view(noise_px, seed=1, turn=(0.02, -0.03, 0.1)):
    target = StarTarget()
    position = target.positions_mm(target.ids)
    rays = np.column_stack([position - CENTRE_MM, np.full(len(position), R_MM)]) @ exp_map(np.array(turn)).T
    points = TRUE.project(rays) + noise_px * np.random.default_rng(seed).normal(size=(len(position), 2))
    inside = ((points > 5) & (points < np.array(TRUE.image_size) - 6)).all(axis=1)
    covariances = np.tile(noise_px**2 * np.eye(2), (int(inside.sum()), 1, 1))
    return View("one", TRUE.image_size, target.ids[inside], points[inside], position[inside], covariances)


def test_one_image_by_angles_gives_the_camera_that_made_it():
    camera = calibrate_by_angles(star_view(1e-9), R_MM, CENTRE_MM).camera.to_dict()
    for name, value in TRUE.to_dict().items():
        off = 2e-4 * abs(value) if "k" in name else 1e-3
        assert camera[name] == pytest.approx(value, abs=off)


# ---------------------------------------------------------------- the check by the gimbal

SIZE = (1280, 720)

CAMERA = CameraModel(3345.0, 3345.0, 640.0, 360.0, SIZE, {"k1": 0.06, "k2": -0.9})

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
        points = CAMERA.project(stars @ (about_y @ about_x))
        seen = np.flatnonzero(((points > 0) & (points < np.array(SIZE) - 1)).all(axis=1))
        unit = np.tile(np.eye(2), (len(seen), 1, 1))
        views.append(View(f"pose {pan}", SIZE, seen, points[seen], stars[seen, :2], unit))
        readings.append({"pan_deg": pan, "tilt_deg": tilt})
    return views, readings


@pytest.mark.parametrize(("longer", "error", "within"), [(1.0, 0.0, 1e-9), (1.02, -0.02, 0.002)])
def test_a_camera_that_is_too_long_turns_too_little_beside_the_gimbal(longer, error, within):
    camera = CameraModel(longer * CAMERA.fx, longer * CAMERA.fy, 640.0, 360.0, SIZE, CAMERA.distortion)
    views, readings = views_and_readings()
    assert gimbal_ratio_error(camera, views, readings) == pytest.approx(error, abs=within)
    assert gimbal_ratio_error(camera, views, ()) is None  # a board
