"""The page for notebooks, docs/python.md: its code runs, in order, on views drawn here and on a solved run."""

import re
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from solved_run import write_solved_run

from bench.front_door import Pose, Run
from calib import CameraModel, Collimator, ExpectedBench, StarTarget, predicted_view
from calib.view import View

DOCUMENT = Path(__file__).parents[3] / "docs" / "python.md"
VIEWS, TEXT = DOCUMENT.read_text(encoding="utf-8").split("## A run\n")
CAMERA = CameraModel(3345.0, 3345.0, 639.5, 359.5, (1280, 720), {"k1": -0.1, "k2": 0.0})
TURNS = {
    "left": {"pan_deg": -3, "tilt_deg": 2},
    "right": {"pan_deg": 3},
    "down": {"tilt_deg": -2, "roll_deg": 90},
}


@pytest.fixture
def in_a_lab(tmp_path, monkeypatch):
    """A folder with a run at the place that the document names."""
    (tmp_path / "runs").mkdir()
    write_solved_run(tmp_path, model="joint").rename(tmp_path / "runs" / "demo")
    monkeypatch.chdir(tmp_path)
    mpl.use("agg")
    yield tmp_path
    plt.close("all")


def test_every_block_of_code_runs_in_order_and_prints_lines_of_the_shown_form(in_a_lab, capsys):
    """Numbers apart: those of the document come from the demonstration, these from a smaller run."""
    names = {}
    blocks = re.findall(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", TEXT, re.DOTALL)
    assert len(blocks) >= 5
    for block, output in blocks:
        exec(compile(block, str(DOCUMENT), "exec"), names)
        printed = capsys.readouterr().out
        missing = set(re.findall(r"[a-zA-Z]{3,}", output)) - set(re.findall(r"[a-zA-Z]{3,}", printed))
        assert missing <= {"encoder"}, printed  # the stage of the smaller run has none
    for name in re.findall(r'savefig\("(.+?)"\)', TEXT):
        assert (in_a_lab / name).stat().st_size > 10_000


def test_every_attribute_is_explained_where_it_is_defined():
    """The site and `help` show these texts; a page with the same would be a second place."""
    for cls in (Run, Pose, View):
        for name, member in vars(cls).items():
            if isinstance(member, property) and not name.startswith("_"):
                assert member.__doc__, f"{cls.__name__}.{name}"
        for name in (field for field in cls.__dataclass_fields__ if not field.startswith("_")):
            assert re.search(rf"\b{name}\b", cls.__doc__), f"{cls.__name__}.{name}"


def test_ten_lines_calibrate_views_and_the_camera_is_within_u(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("points").mkdir()
    noise = np.random.default_rng(1)
    bench = ExpectedBench(CAMERA, Collimator(*StarTarget().tag_centre_mm, 255.0), half_angle_deg=12.0)
    for name, pose in TURNS.items():
        view = predicted_view(bench, pose, name)[0]
        points_px = view.points_px + noise.normal(0.0, 0.02, view.points_px.shape)
        np.savetxt(Path("points", f"{name}.txt"), np.column_stack([points_px, view.target_mm, view.ids]))
    names = {}
    first, *others = re.findall(r"```python\n(.*?)```", VIEWS, re.DOTALL)
    assert len([line for line in first.splitlines() if line]) <= 10
    for block in (first, *others):
        exec(compile(block, str(DOCUMENT), "exec"), names)
    assert "± " in capsys.readouterr().out
    for result in (names["result"], names["known"]):
        assert abs(result.camera.fx - CAMERA.fx) < result.coverage_factor * result.sigma["fx"]
