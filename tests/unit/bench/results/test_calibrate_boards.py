"""`calibrate --board`: photographs of a checkerboard become a planar calibration with a report."""

import json
from functools import cache

import cv2
import numpy as np
import pytest

from bench.commands.cli import main
from calib.model.camera import CameraModel
from calib.model.rotation import exp_map

SIZE = (400, 300)
TRUE = {"fx": 560.0, "fy": 561.5, "cx": 198.0, "cy": 152.0, "k1": -0.1}
CAMERA = CameraModel(560.0, 561.5, 198.0, 152.0, SIZE, {"k1": -0.1, "k2": 0.05})
PLACES = [
    ((0, 0, 5), 0.0),
    ((30, 5, 0), 10.0),
    ((-28, 10, 20), -10.0),
    ((5, 32, 50), 5.0),
    ((8, -30, 80), 0.0),
]


@cache
def rays(cells=4):
    """(cells^2, height * width, 3) rays through places within each pixel."""
    steps = (np.arange(cells) + 0.5) / cells - 0.5
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    places = [np.column_stack([(u + du).ravel(), (v + dv).ravel()]) for dv in steps for du in steps]
    return np.array([CAMERA.rays(each) for each in places])


def photograph(turn_deg, shift_mm, seed):
    """A camera's picture of the board: each pixel asks where its rays meet the board."""
    rotation = exp_map(np.deg2rad(np.array(turn_deg, float)))
    centre = np.array([60.0, 40.0, 0.0]) - rotation.T @ np.array([shift_mm, -shift_mm / 2, 300.0])
    off = rays() @ rotation
    x, y = (centre[i] - off[:, :, i] * centre[2] / off[:, :, 2] for i in (0, 1))
    x, y = x / 20.0, y / 20.0
    inside = (x > -1) & (x < 7) & (y > -1) & (y < 5)
    dark = inside & ((np.floor(x) + np.floor(y)) % 2 == 0)
    image = np.where(dark, 20.0, 200.0).mean(axis=0).reshape(SIZE[::-1])
    return np.uint8(np.clip(image + np.random.default_rng(seed).normal(0, 2, image.shape), 0, 255))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("boards")
    for number, (turn, shift) in enumerate(PLACES):
        cv2.imwrite(str(folder / f"placement{number}.png"), photograph(turn, shift, number))
    cv2.imwrite(str(folder / "nothing.png"), np.full(SIZE[::-1], 90, np.uint8))
    return folder


def say(capsys, *words, status=0):
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    said = capsys.readouterr()
    assert end.value.code == status, said.err
    return said


def test_photographs_of_a_checkerboard_give_the_camera_within_its_uncertainty(folder, tmp_path, capsys):
    out = tmp_path / "out"
    said = say(
        capsys, "calibrate", folder, "--board", "checkerboard:7x5:20mm", "-o", out, "--no-seal", "--json"
    )
    told = json.loads(said.out)
    assert told["model"] == "planar"
    k = told["coverage_factor"]
    for name, true in TRUE.items():
        assert abs(told["camera"][name] - true) <= k * told["sigma"][name]
    assert told["sigma"]["fx"] < 0.5
    (left_out,) = told["skipped"]
    assert "nothing" in left_out
    assert "No checkerboard of 7 x 5 inner corners was found" in left_out
    report = (out / "report.html").read_text()
    assert "calibrated with a flat target at finite distance" in report
    assert "wavefront" not in report
    results = json.loads((out / "results.json").read_text())
    assert results["run"]["board"] == "checkerboard:7x5:20mm"
    assert "points are near" in report.lower()
    pattern = json.loads((out / "exports" / "metavision.json").read_text())["pattern"]
    assert (pattern["n_cols"], pattern["n_rows"]) == (7, 5)


def test_a_comparison_on_a_board_has_no_recipe_for_stars(folder, capsys):
    said = say(capsys, "calibrate", folder, "--board", "checkerboard:7x5:20mm", "--compare")
    assert "OpenCV, planar (Zhang)" in said.out
    assert "no result" not in said.out
    assert "The published recipe is left out: it needs a target at infinity, not a board." in said.out
    assert "points; U with" in said.out


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        (["--model", "field"], "no collimator before it"),
        (["--passport", "some.json"], "no collimator before it"),
        (["--board", "chequers"], "does not describe a board"),
    ],
)
def test_options_that_contradict_a_board_are_refused(folder, capsys, more, reason):
    said = say(capsys, "calibrate", folder, "--board", "checkerboard:7x5:20mm", *more, status=2)
    assert reason in said.err
