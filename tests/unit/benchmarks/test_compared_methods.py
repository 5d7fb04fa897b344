"""Comparison of methods, a benchmark: its columns, one repetition, its table, one image by angles, the gimbal's check."""

import numpy as np
import pytest

from calib import CameraModel
from tests.benchmarks.compared.by_others import calibrate_by_angles
from tests.benchmarks.compared.columns import Column
from tests.benchmarks.compared.gimbal_check import gimbal_ratio_error
from tests.benchmarks.compared.methods import compare_with_truth, rows_of
from tests.unit.calib.conftest import Bench

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


def test_one_image_by_angles_gives_the_camera_that_made_it():
    view = Bench().views(np.random.default_rng(1), 1e-9)[0]
    found = calibrate_by_angles(view, 255.0, (97.0, 140.1)).camera.to_dict()
    for name, value in TRUE.to_dict().items():
        off = 2e-4 * abs(value) if "k" in name else 1e-3
        assert found[name] == pytest.approx(value, abs=off)


# ---------------------------------------------------------------- the check by the gimbal


@pytest.mark.parametrize(("longer", "error", "within"), [(1.0, 0.0, 1e-9), (1.02, -0.02, 0.002)])
def test_a_camera_that_is_too_long_turns_too_little_beside_the_gimbal(longer, error, within):
    poses = ((-6.0, 2.0), (6.0, 2.0), (0.0, -3.0))
    readings = [{"pan_deg": -pan, "tilt_deg": -tilt} for pan, tilt in poses]
    views = Bench().views(poses=poses)
    camera = CameraModel(
        longer * TRUE.fx, longer * TRUE.fy, TRUE.cx, TRUE.cy, TRUE.image_size, TRUE.distortion
    )
    assert gimbal_ratio_error(camera, views, readings) == pytest.approx(error, abs=within)
    assert gimbal_ratio_error(camera, views, ()) is None  # a board
