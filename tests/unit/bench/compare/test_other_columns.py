"""Columns of other kinds: one image by angles, a moving camera, recorded data; and repetitions that fail."""

import json

import numpy as np
import pytest

from bench.base.errors import ScriptError
from bench.compare import methods, scenes
from bench.compare.methods import data_digest, read_data
from bench.compare.page import PAPER_NAMES, PAPER_TABLE_1, images_plot, render_page
from bench.compare.run_comparison import Task, compare, row_key, run_task
from bench.compare.scenes import finding_key, recordings_key
from bench.compare.spec import ComparisonConfig, read_spec
from bench.compare.table import data_rows, summarise, table_rows, table_text
from calib.errors import CalibrationError, TooFewStars
from calib.model.camera import CameraModel
from calib.model.rotation import exp_map
from calib.studies.reference_methods import calibrate_by_angles
from calib.target import StarTarget
from calib.view import View

TRUE = CameraModel(3345.06, 3345.27, 642.1, 363.32, (1280, 720), {"k1": 0.06, "k2": -0.9})
CENTRE_MM, R_MM = (97.0, 140.0), 255.0
SMALL = CameraModel(400.0, 401.0, 171.0, 131.0, (346, 260), {"k1": -0.1, "k2": 0.05, "p1": 0.0, "p2": 0.0})
TRUTH = {**TRUE.to_dict(), "p1": 0.0, "p2": 0.0, "k3": 0.0, "width": 1280, "height": 720}
BOARD_DATA = {"image_size": [346, 260], "origin": "centre", "board": True, "pitch_mm": 40.0}


def spec(*columns, **more):
    return ComparisonConfig(format="starbench/comparison/1", name="Test", columns=list(columns), **more)


def star_view(noise_px, seed=1, turn=(0.02, -0.03, 0.1)):
    target = StarTarget()
    position = target.positions_mm(target.ids)
    rays = np.column_stack([position - CENTRE_MM, np.full(len(position), R_MM)]) @ exp_map(np.array(turn)).T
    points = TRUE.project(rays) + noise_px * np.random.default_rng(seed).normal(size=(len(position), 2))
    inside = ((points > 5) & (points < np.array(TRUE.image_size) - 6)).all(axis=1)
    covariances = np.tile(noise_px**2 * np.eye(2), (int(inside.sum()), 1, 1))
    return View("one", TRUE.image_size, target.ids[inside], points[inside], position[inside], covariances)


def test_one_image_by_angles_gives_the_camera_that_made_it():
    found = calibrate_by_angles(star_view(1e-9), R_MM, CENTRE_MM)
    for name, value in TRUE.to_dict().items():
        off = 2e-4 * abs(value) if "k" in name else 1e-3
        assert found.camera.to_dict()[name] == pytest.approx(value, abs=off)
    assert found.rms_px < 1e-6


def test_the_sigmas_of_one_image_are_its_scatter():
    results = [calibrate_by_angles(star_view(0.05, seed), R_MM, CENTRE_MM) for seed in range(16)]
    for name in ("fx", "cx", "k1"):
        scatter = np.std([each.camera.to_dict()[name] for each in results], ddof=1)
        assert 0.55 < scatter / results[0].sigma[name] < 1.5


def test_a_longer_collimator_and_a_longer_camera_give_the_same_image():
    found = calibrate_by_angles(star_view(1e-9), 1.01 * R_MM, CENTRE_MM)
    assert found.camera.fx == pytest.approx(1.01 * TRUE.fx, rel=2e-3)
    assert found.rms_px < 0.02


def test_an_image_of_few_stars_is_refused():
    view = star_view(0.01)
    stars = (getattr(view, n)[:9] for n in ("ids", "points_px", "target_mm", "covariances_px2"))
    with pytest.raises(TooFewStars, match="9 stars; one image needs 20"):
        calibrate_by_angles(View("one", view.image_size, *stars), R_MM, CENTRE_MM)


def test_a_moving_camera_shares_its_recordings_among_ways_to_read_them():
    both, published, faster = spec(
        {"name": "a", "method": "reconstruction", "images": 5},
        {"name": "b", "method": "reconstruction", "images": 5, "motion": {"two_sided": False}},
        {"name": "c", "method": "reconstruction", "images": 5, "motion": {"speed_px_s": 2000}},
    ).columns
    assert recordings_key(both) == recordings_key(published) != recordings_key(faster)
    assert finding_key(both) != finding_key(published)


@pytest.fixture
def table(tmp_path):
    """A table of 12 views of a 6 x 3 board, and its description."""
    rng = np.random.default_rng(2)
    column, row = (each.ravel() for each in np.meshgrid(np.arange(6), np.arange(3)))
    place = 40.0 * np.column_stack([column - 2.5, row - 1.0, np.zeros(18)])
    lines = ["time,view,x,y,column,row"]
    for number in range(12):
        turn = exp_map(rng.uniform(-0.5, 0.5, 3))
        position = np.array([*rng.uniform(-60, 60, 2), rng.uniform(450, 600)])
        points = SMALL.project(place @ turn.T + position) + 0.05 * rng.normal(size=(18, 2))
        lines += [
            f"{number},{number},{x},{y},{c},{r}" for (x, y), c, r in zip(points, column, row, strict=True)
        ]
    file = tmp_path / "views.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


def data_column(path, **more):
    data = BOARD_DATA | {"path": str(path)}
    return {"name": "real", "method": "zhang", "images": 6, "lens": "k1k2p1p2", "data": data} | more


def test_recorded_data_are_calibrated_in_two_parts_that_agree(table, tmp_path):
    chosen = spec(data_column(table), data_column(table, name="ours", method="starbench"), repetitions=2)
    done = [run_task(Task(tuple(chosen.columns), n)).values() for n in range(2)]
    rows = {column.name: list(of_column) for column, *of_column in zip(chosen.columns, *done, strict=True)}
    for row in (row for of_column in rows.values() for row in of_column):
        assert "error" not in row
        assert abs(row["camera"]["fx"] - 400.0) < 4.0 * row["sigma"]["fx"]
        assert 0.03 < row["left_out_px"] < 0.15
    assert rows["real"][0]["camera"] != rows["real"][1]["camera"]
    summary = summarise(chosen, rows)
    assert table_rows(summary) == []
    assert [cells[:3] for cells in data_rows(summary)] == [["real", "6", "2 of 2"], ["ours", "6", "2 of 2"]]
    assert "halves" in table_text(summary)
    page = render_page(summary, rows, TRUE.to_dict())
    assert "Recorded data" in page
    assert "SIMULATED" not in page
    assert str(tmp_path) not in page


def test_changed_data_make_new_rows(table):
    column = spec(data_column(table)).columns[0]
    key = row_key(column, 1)
    table.write_text(table.read_text().replace("0,0,", "1,0,", 1))
    assert row_key(column, 1) != key


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "no point files"),
        ("time,view\n1,2\n", "six numbers"),
        ("time,view,x,y,column,row\n1,2,3,4,5,x\n", "six numbers"),
        ("time,view,x,y,column,row\n1,2,3,4,5\n1,2\n", "cannot be read"),
        ("", "six numbers"),
    ],
)
def test_data_that_cannot_be_read_are_named_in_their_row_and_the_rest_goes_on(table, tmp_path, content, said):
    broken = tmp_path / "broken.csv"
    if content is not None:
        broken.write_text(content)
    chosen = spec(data_column(broken), data_column(table, name="good"), repetitions=1)
    rows = compare(chosen, b"x", tmp_path / "out", do_tasks=lambda tasks: map(run_task, tasks))
    assert said in rows["real"][0]["error"]
    assert "error" not in rows["good"][0]


def test_too_few_views_are_named(table):
    column = spec(data_column(table, images=7)).columns[0]
    (row,) = run_task(Task((column,), 1)).values()
    assert row["error"] == "12 views are too few for two subsets of 7"
    assert len(read_data(column.data)) == 12
    assert data_digest(column.data.model_copy(update={"path": "nowhere"})) == "missing"


@pytest.mark.parametrize(
    "wrong",
    [
        "{name: a, method: angles, images: 3}",
        "{name: a, method: checkerboard, images: 3, data: {path: x, image_size: [9, 9]}}",
        "{name: a, method: checkerboard, images: 3, data: {path: x, image_size: [99, 99]}}",
        "{name: a, method: starbench, passport: true, data: {path: x, image_size: [99, 99]}}",
        "{name: a, method: recipe, data: {path: x, image_size: [99, 99], board: true}}",
        "{name: a, method: reconstruction, images: 3, motion: {speed_px_s: 0}}",
        "{name: a, method: reconstruction, images: 3, motion: {angle_deg: 91}}",
        "{name: a, method: zhang, image: 3}",
        "{name: a, method: [zhang]}",
        "{name: a, method: zhang, images: .nan}",
    ],
)
def test_a_column_that_cannot_be_is_named_at_its_line(tmp_path, wrong):
    file = tmp_path / "spec.yaml"
    file.write_text(f"format: starbench/comparison/1\nname: x\ncolumns:\n  - {wrong}\n")
    with pytest.raises(ScriptError, match=r"spec\.yaml:4:"):
        read_spec(str(file))


def test_an_error_is_named_in_its_row_and_the_other_columns_go_on(monkeypatch):
    def record(column, seed):
        raise CalibrationError("The light is off.", where=f"seed {seed}")

    def errors(*columns):
        rows = run_task(Task(tuple(spec(*columns).columns), 3))
        return [row["error"] for row in rows.values()]

    zhang, recipe = {"name": "a", "method": "zhang"}, {"name": "b", "method": "recipe"}
    monkeypatch.setattr(scenes, "record", record)
    assert errors(zhang, recipe) == ["seed 3: The light is off."] * 2
    unexpected = "Unexpected ZeroDivisionError: division by zero"
    monkeypatch.setattr(scenes, "record", lambda *_: 1 / 0)
    assert errors(zhang) == [unexpected]
    monkeypatch.setattr(scenes, "record", lambda *_: scenes.Recordings((), (), (), {"camera": TRUTH}))
    monkeypatch.setattr(methods, "solve", lambda *_: 1 / 0)
    assert errors(zhang) == [unexpected]
    monkeypatch.setattr(methods, "read_data", lambda *_: 1 / 0)
    assert errors(data_column("x")) == [unexpected]


def test_the_paper_is_shown_beside_its_table_only():
    rows = {"a": []}
    summary = summarise(spec({"name": "a", "method": "zhang"}), rows)
    assert "3412.76" in render_page({**summary, "name": "Table 1"}, rows, TRUE.to_dict())
    assert "3412.76" not in render_page(summary, rows, TRUE.to_dict())
    assert all(len(values) == len(PAPER_NAMES) for _, values in PAPER_TABLE_1)


def test_columns_that_differ_in_images_only_become_a_line():
    chosen = spec(*({"name": f"ours, {n} images", "method": "zhang", "images": n} for n in (2, 3, 5)))
    summary = summarise(chosen, {column.name: [] for column in chosen.columns})
    for place, column in enumerate(summary["columns"]):
        column["direction_rms_urad"] = 100.0 / (1 + place)
    drawn = images_plot(summary["columns"])
    assert ">ours<" in drawn
    assert images_plot(summary["columns"][:2]) == ""
    json.dumps(summary, allow_nan=False)
