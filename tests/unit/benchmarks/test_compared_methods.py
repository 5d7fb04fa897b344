"""Comparison of methods, a benchmark: its columns, one repetition, its table, one image by angles, the gimbal's check."""

import argparse
import importlib
import json
from pathlib import Path

import numpy as np
import pytest

from calib.errors import TooFewStars
from calib.model.camera import CameraModel
from calib.model.rotation import exp_map
from calib.target import StarTarget
from calib.view import View
from tests.benchmarks.compared.by_others import calibrate_by_angles
from tests.benchmarks.compared.columns import Column, Screen, read_comparison
from tests.benchmarks.compared.gimbal_check import gimbal_ratio_error
from tests.benchmarks.compared.methods import compare_with_truth, rows_of
from tests.benchmarks.compared.scenes import recordings_key
from tests.benchmarks.compared.summary import table

TRUE = CameraModel(3345.06, 3345.27, 642.1, 363.32, (1280, 720), {"k1": 0.06, "k2": -0.9})


@pytest.mark.parametrize("name", ["table1", "sweep"])
def test_included_comparisons_share_their_recordings(name):
    columns = read_comparison(name).columns
    assert len({recordings_key(column) for column in columns}) < len(columns)
    assert len({column.name for column in columns}) == len(columns)


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


def row(fx_error):
    camera = TRUE.to_dict() | {"fx": TRUE.fx + fx_error}
    return {
        "camera": camera, "sigma": {"fx": 1.0}, "k": 2.0, "rms_px": 0.02, "gimbal_ratio_error": None,
        "errors": {"fx": fx_error}, "direction_rms_urad": 1.0, "direction_worst_urad": 20.0 * abs(fx_error),
        "covered": {"fx": abs(fx_error) <= 2.0},
    }  # fmt: skip


def test_the_table_states_errors_and_coverage_and_names_failures():
    ours, board = Column(name="ours", method="starbench"), Column(name="board", method="checkerboard")
    failed = {"error": "no board"}
    text = table((ours, board), [[row(3.0), row(-1.0), row(1.0), row(-3.0)], [failed] * 4])
    cells = [cell.strip() for cell in text.splitlines()[2].split("|")[1:-1]]
    assert cells[:5] == ["ours", "3", "4 of 4", "2.24", "2"]
    assert cells[7:9] == ["60", "50 %"]
    assert text.endswith("* board, 4 times without a result, such as: no board")


def test_a_group_of_columns_has_a_heading_in_the_table():
    first = Column(name="ours", method="starbench", group="collimator")
    heads = [line.split(" | ")[0] for line in table((first,), [[row(1.0)]]).splitlines()[2:]]
    assert heads == ["| **collimator**", "| ours"]


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


def test_a_board_that_does_not_fit_is_named_in_its_row():
    big = Column(name="board", method="checkerboard", board=Screen(square_mm=90.0))
    assert "does not fit" in rows_of((big,), 1)["board"]["error"]


def test_one_image_needs_a_known_collimator():
    for method, known in (("starbench", False), ("zhang", True)):
        with pytest.raises(ValueError, match="one image is enough with"):
            Column(name="a", method=method, images=1, known_collimator=known)
    column = Column(name="a", method="starbench", images=1, known_collimator=True)
    other = Column(name="a", method="starbench", images=3)
    assert recordings_key(column) != recordings_key(other)


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


def test_a_longer_collimator_and_a_longer_camera_give_the_same_image():
    result = calibrate_by_angles(star_view(1e-9), 1.01 * R_MM, CENTRE_MM)
    assert result.camera.fx == pytest.approx(1.01 * TRUE.fx, rel=2e-3)
    assert result.rms_px < 0.02


def test_an_image_of_few_stars_is_refused():
    view = star_view(0.01)
    stars = (getattr(view, n)[:9] for n in ("ids", "points_px", "target_mm", "covariances_px2"))
    with pytest.raises(TooFewStars, match="9 stars; one image needs 20"):
        calibrate_by_angles(View("one", view.image_size, *stars), R_MM, CENTRE_MM)


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


# ---------------------------------------------------------------- kept repetitions


def test_what_is_ready_is_shown_without_a_measurement(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    repetitions = importlib.import_module("tests.benchmarks.compared.repetitions")
    kept = tmp_path / "table1.jsonl"
    given = argparse.Namespace(repetitions=2, ready=True, kept=kept, jobs=1)
    assert not any(repetitions.repeated("table1", given))
    first, second = repetitions.keys_of("table1", 2)[:2]
    ours = {"Starbench, ideal collimator, 3 images": row(3.0)}
    lines = [{"key": first, "rows": ours}, {"key": [*second[:3], "of another program"], "rows": ours}]
    kept.write_text("".join(json.dumps(line) + "\n" for line in lines))
    rows = repetitions.repeated("table1", given)
    assert [len(of_column) for of_column in rows if of_column] == [1]
    assert " 1 of 1 | 3 |" in table(repetitions.columns_here("table1"), rows)
