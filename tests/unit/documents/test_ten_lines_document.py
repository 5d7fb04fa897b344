"""The page for those who have views already: its code runs, in order, and finds the camera."""

import re
from pathlib import Path

import numpy as np

from calib import CameraModel, Collimator, ExpectedBench, StarTarget, predicted_view

TEXT = (Path(__file__).parents[3] / "docs" / "ten-lines.md").read_text(encoding="utf-8")
CAMERA = CameraModel(3345.0, 3345.0, 639.5, 359.5, (1280, 720), {"k1": -0.1, "k2": 0.0})
POSES = {
    "left": {"pan_deg": -3, "tilt_deg": 2},
    "right": {"pan_deg": 3},
    "down": {"tilt_deg": -2, "roll_deg": 90},
}


def test_every_block_of_code_runs_and_the_camera_is_within_u(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("points").mkdir()
    noise = np.random.default_rng(1)
    bench = ExpectedBench(CAMERA, Collimator(*StarTarget().tag_centre_mm, 255.0), half_angle_deg=12.0)
    for name, pose in POSES.items():
        view = predicted_view(bench, pose, name)[0]
        points_px = view.points_px + noise.normal(0.0, 0.02, view.points_px.shape)
        np.savetxt(Path("points", f"{name}.txt"), np.column_stack([points_px, view.target_mm, view.ids]))
    names = {}
    first, *others = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    assert len([line for line in first.splitlines() if line]) <= 10
    for block in (first, *others):
        exec(compile(block, "ten-lines.md", "exec"), names)
    assert "± " in capsys.readouterr().out
    for result in (names["result"], names["known"]):
        assert abs(result.camera.fx - CAMERA.fx) < result.coverage_factor * result.sigma["fx"]
