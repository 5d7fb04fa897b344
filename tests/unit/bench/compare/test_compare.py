"""Comparisons of methods: specifications, resuming, statistics, one repetition, the check by the gimbal's angles."""

import json

import numpy as np
import pytest
from calling import refusal

from bench.base.errors import ScriptError, UsageError
from bench.compare.methods import bench_time_s, compare_with_truth, gimbal_ratio_error
from bench.compare.page import render_page
from bench.compare.run_comparison import ROWS, Task, compare, row_key, run_task
from bench.compare.scenes import recordings_key, star_poses
from bench.compare.spec import ColumnConfig, ComparisonConfig, read_spec, shipped_names
from bench.compare.table import parameter_rows, summarise, table_rows, table_text
from calib.model.camera import CameraModel
from calib.view import View

TRUE = CameraModel(3345.06, 3345.27, 642.1, 363.32, (1280, 720), {"k1": 0.06, "k2": -0.9})


def spec(**more):
    columns = [
        {"name": "ours", "method": "starbench", "images": 3},
        {"name": "Zhang", "method": "zhang", "images": 3},
        {"name": "board", "method": "checkerboard", "images": 3},
    ]
    return ComparisonConfig(format="starbench/comparison/1", name="Test", columns=columns, **more)


def row(fx_error=1.0, sigma=1.0, **more):
    camera = TRUE.to_dict() | {"fx": 3345.06 + fx_error}
    off = abs(fx_error)
    return {
        "views": 3, "missed": [], "images_cpu_s": 2.0, "solve_cpu_s": 0.1,
        "camera": camera, "sigma": {"fx": sigma, "cx": 0.1}, "k": 2.0, "model": "radial", "rms_px": 0.02,
        "mean_px": 0.01, "left_out_px": None, "gimbal_ratio_error": None,
        "errors": {name: camera[name] - value for name, value in TRUE.to_dict().items()},
        "direction_rms_urad": 10.0 * off, "direction_worst_urad": 20.0 * off, "centre_urad": 1.0,
        "corner_urad": 20.0 * off, "covered": {"fx": off <= 2 * sigma}, **more,
    }  # fmt: skip


@pytest.mark.parametrize("name", shipped_names())
def test_included_specifications_are_valid_and_share_their_recordings(name):
    read = read_spec(name).value
    keys = {recordings_key(column) for column in read.columns}
    assert len(keys) < len(read.columns)
    assert read.repetitions >= 10


def test_every_fault_of_a_specification_is_named_at_its_place(tmp_path):
    file = tmp_path / "spec.yaml"
    file.write_text(
        "format: starbench/comparison/1\nname: x\nrepetitions: 0\ncolumns:\n"
        "  - {name: a, method: kalibr}\n  - {name: b, method: zhang, images: 1}\n"
    )
    with pytest.raises(ScriptError) as error:
        read_spec(str(file))
    said = str(error.value)
    for place in (":3:14", ":5:23", ":6:5"):
        assert f"{file}{place}" in said
    file.write_text(
        "format: starbench/comparison/1\nname: x\ncolumns:\n  - {name: a, method: zhang}\n  - {name: a, method: recipe}\n"
    )
    with pytest.raises(ScriptError, match="two columns 'a'"):
        read_spec(str(file))


def test_an_unknown_specification_is_refused_with_those_that_exist(capsys):
    assert "table1" in refusal(capsys, "compare", "table7", status=2)


def test_poses_fill_the_range_and_three_are_those_of_the_paper():
    assert star_poses(3) == [(-6.0, 2.0), (6.0, 2.0), (0.0, -3.0)]
    many = np.array(star_poses(25))
    assert (np.abs(many) <= [6.0, 2.5]).all()
    assert (np.ptp(many, axis=0) > [10.0, 4.0]).all()


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


def test_statistics_are_those_of_the_rows_and_failures_are_named():
    chosen, off = spec(repetitions=4), (3.0, -1.0, 1.0, -3.0)
    failed = {"error": "no board", "images_cpu_s": 1.0}
    rows = {"ours": [row(error) for error in off], "Zhang": [*[row(10.0)] * 3, failed], "board": [failed] * 4}
    summary = summarise(chosen, rows)
    ours, zhang, board = summary["columns"]
    assert ours["parameters"]["fx"]["rms_error"] == pytest.approx(np.sqrt(5.0))
    assert ours["parameters"]["fx"]["spread"] == pytest.approx(np.std(off, ddof=1))
    assert ours["coverage"]["fx"] == 0.5
    assert ours["direction_worst_urad"] == 60.0
    assert (zhang["solved"], zhang["failed"]) == (3, [{"why": "no board", "times": 1}])
    assert board["solved"] == 0
    assert [cells[2] for cells in table_rows(summary)] == ["4 of 4", "3 of 4", "0 of 4"]
    assert "board: 4 without a result: no board" in table_text(summary)
    assert parameter_rows(summary, ("fx",))[0] == ["ours", "3345.1 ± 2.6"]
    page = render_page(summary, rows, TRUE.to_dict())
    assert page.count("<svg class") == 2
    assert "3345.06" in page
    assert "<script" not in page
    json.dumps(summary, allow_nan=False)


def test_a_row_is_found_again_unless_what_it_depends_on_changed():
    column = spec().columns[0]
    key = row_key(column, 1)
    assert key == row_key(column.model_copy(update={"name": "another name"}), 1)
    others = [row_key(column, 2), row_key(column.model_copy(update={"images": 4}), 1)]
    assert key not in others


def test_an_interrupted_comparison_uses_what_is_done_and_drops_a_half_line(tmp_path):
    chosen, told = spec(repetitions=2), []
    folder = tmp_path / "comparison"
    folder.mkdir()
    (folder / "spec.yaml").write_text("x")
    done = [(column, n) for column in chosen.columns for n in range(2)]
    whole = "".join(
        json.dumps({"key": row_key(column, chosen.seed + n), **row(float(n))}) + "\n" for column, n in done
    )
    (folder / ROWS).write_text(whole + '{"key": "half')
    rows = compare(chosen, b"x", folder, do_tasks=no_tasks, on_progress=lambda *words: told.append(words))
    assert told == [(6, 6, None)]
    assert list(rows) == [column.name for column in chosen.columns]
    assert all([one["errors"]["fx"] for one in of_column] == [0.0, 1.0] for of_column in rows.values())
    assert (folder / ROWS).read_text() == whole


def no_tasks(tasks):
    return map(run_task, tasks)


def test_a_folder_with_something_else_is_not_touched(tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(UsageError, match="something else"):
        compare(spec(), b"x", tmp_path, do_tasks=lambda tasks: map(run_task, tasks))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_one_repetition_gives_every_method_the_same_images_and_compares_with_the_truth():
    ours, zhang, _ = spec().columns
    certified = ours.model_copy(update={"name": "certified", "passport": True, "readings": True})
    rows = run_task(Task((ours, zhang, certified), 5))
    first, second, third = rows.values()
    assert first["views"] == second["views"] == 3
    assert first["images_cpu_s"] == second["images_cpu_s"]
    for found in (first, second, third):
        assert abs(found["errors"]["fx"]) < 10.0
        assert found["direction_rms_urad"] < 400.0
    assert third["sigma"]["fx"] < first["sigma"]["fx"]
    json.dumps(rows, allow_nan=False)


def test_a_board_that_does_not_fit_is_named_in_its_row():
    board = spec().columns[2]
    big = board.model_copy(update={"board": board.board.model_copy(update={"square_mm": 90.0})})
    (found,) = run_task(Task((big,), 1)).values()
    assert "does not fit" in found["error"]


def test_one_image_needs_a_known_collimator(tmp_path):
    file = tmp_path / "spec.yaml"

    def read(method, more):
        column = f"{{name: a, method: {method}, images: 1{more}}}"
        file.write_text(f"format: starbench/comparison/1\nname: x\ncolumns:\n  - {column}\n")
        return read_spec(str(file))

    for method, more in (("starbench", ""), ("zhang", ", known_collimator: true")):
        with pytest.raises(ScriptError, match="two images or more"):
            read(method, more)
    (column,) = read("starbench", ", known_collimator: true").value.columns
    assert recordings_key(column) != recordings_key(column.model_copy(update={"known_collimator": None}))


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


def test_images_of_stars_take_seconds_and_boards_minutes():
    stars = bench_time_s(ColumnConfig(name="a", method="starbench", images=3))
    board = bench_time_s(ColumnConfig(name="a", method="checkerboard", images=20))
    moving = bench_time_s(ColumnConfig(name="a", method="reconstruction", images=20))
    assert stars == pytest.approx(10.1)
    assert stars < moving < board == 400.0
