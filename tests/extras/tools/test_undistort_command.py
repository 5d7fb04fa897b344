"""`starbench undistort`: tables in a new folder, a preview whose board has straight lines, and nothing after a fault."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from board_photographs import photograph
from calling import call

from calib.model.camera import CameraModel

SIZE = (400, 300)
CAMERAS = {
    "brown": CameraModel(330.0, 331.0, 198.0, 152.0, SIZE, {"k1": -0.25, "k2": 0.06}),
    "fisheye": CameraModel(280.0, 281.0, 201.0, 148.0, SIZE, {"kb1": -0.05, "kb2": 0.01, "kb3": 0, "kb4": 0}),
}
BOARD = "checkerboard:9x6:20mm"


@pytest.fixture(params=CAMERAS)
def calibrated(request, tmp_path):
    """A camera, its camera_info and a photograph of a board."""
    camera = CAMERAS[request.param]
    lens = camera.fisheye_coefficients if camera.is_fisheye else camera.coefficients[:5]
    content = {
        "image_width": SIZE[0],
        "image_height": SIZE[1],
        "distortion_model": "equidistant" if camera.is_fisheye else "plumb_bob",
        "camera_matrix": {"rows": 3, "cols": 3, "data": camera.matrix.ravel().tolist()},
        "distortion_coefficients": {"rows": 1, "cols": len(lens), "data": lens.tolist()},
    }
    (tmp_path / "info.yaml").write_text(yaml.safe_dump(content))
    board = photograph(camera, (9, 6), (8.0, -6.0, 3.0), (0.0, 0.0, 175.0))
    cv2.imwrite(str(tmp_path / "board.png"), board.astype(np.uint8))
    return camera, tmp_path


def say(capsys, *words, status=0):
    captured = call(capsys, "undistort", *words, status=status)
    return captured.err if status else captured.out


def test_a_board_is_straight_in_the_image_that_the_tables_give(capsys, calibrated):
    camera, folder = calibrated
    words = (folder / "info.yaml", "-o", folder / "new", "--preview", folder / "board.png")
    answer = json.loads(say(capsys, *words, "--json"))
    with np.load(folder / "new" / "undistort.npz") as file:
        tables = dict(file)
    # a stranger's way from the same tables: remap with the pair, find the corners again
    picture = cv2.imread(str(folder / "board.png"), cv2.IMREAD_GRAYSCALE)
    flat = cv2.remap(picture, tables["map_x"], tables["map_y"], cv2.INTER_LINEAR)
    preview = cv2.imread(str(folder / "new" / "preview.png"), cv2.IMREAD_GRAYSCALE)
    assert preview.shape == (SIZE[1], 2 * SIZE[0] + 8)
    assert np.corrcoef(preview[:, -SIZE[0] :].ravel(), flat.ravel())[0, 1] > 0.999
    whole, corners = cv2.findChessboardCornersSB(flat, (9, 6))
    assert whole
    rows = corners.reshape(6, 9, 2)
    off = [np.linalg.svd(row - row.mean(axis=0), compute_uv=False)[-1] / 3.0 for row in rows]
    assert max(off) < 0.1
    info = yaml.safe_load((folder / "new" / "camera_info.yaml").read_text())
    projection = np.reshape(info["projection_matrix"]["data"], (3, 4))
    assert np.array_equal(projection, tables["projection_matrix"])
    for of_file in (tables, answer):
        assert np.array_equal(projection[:, :3], of_file["new_camera_matrix"])
        assert np.array_equal(np.reshape(info["camera_matrix"]["data"], (3, 3)), of_file["camera_matrix"])
    assert np.array_equal(tables["camera_matrix"], camera.matrix)
    assert np.array_equal(tables["distortion"], info["distortion_coefficients"]["data"])
    assert tables["rays"][150, 200] == pytest.approx(camera.rays(np.array([[200.0, 150.0]]))[0], abs=1e-6)


def test_the_example_of_the_page_moves_events(capsys, calibrated, monkeypatch):
    camera, folder = calibrated
    say(capsys, folder / "info.yaml", "-o", folder / "cam7-tables")
    page = (Path(__file__).parents[3] / "docs" / "extras" / "tools" / "undistort.md").read_text()
    example = page.partition("```python\n")[2].partition("```")[0].replace("640", "399").replace("360", "299")
    monkeypatch.chdir(folder)
    names = {}
    exec(example, names)
    rays = camera.rays(np.column_stack([names["x"], names["y"]]).astype(float))
    with np.load("cam7-tables/undistort.npz") as tables:
        moved = rays @ tables["new_camera_matrix"].T
    seen = np.column_stack([names["new_x"], names["new_y"]])
    assert seen == pytest.approx(moved[:, :2] / moved[:, 2:], abs=1e-2)


def test_the_tables_use_a_thin_prism_and_a_tilted_sensor_and_no_file_drops_them(capsys, tmp_path):
    lens = [-0.25, 0.06, 1e-3, -1e-3, 0.0, 0.0, 0.0, 0.0, 0.004, -0.003, 0.006, 0.002, 0.02, -0.01]
    camera = CAMERAS["brown"]
    content = {"K": camera.matrix.tolist(), "D": lens, "image_size": SIZE}
    (tmp_path / "cal.json").write_text(json.dumps(content))
    shown = say(capsys, tmp_path / "cal.json", "-o", tmp_path / "new")
    assert "undistort.npz, not-written.txt" in shown
    assert "cannot represent s1, s2, s3, s4, tauX, tauY" in (tmp_path / "new" / "not-written.txt").read_text()
    with np.load(tmp_path / "new" / "undistort.npz") as file:
        rays = file["rays"][::20, ::20].reshape(-1, 3).astype(float)
    pixels = np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), axis=-1)[::20, ::20].reshape(-1, 2)
    seen = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.matrix, np.array(lens))[0].reshape(-1, 2)
    assert np.abs(seen - pixels).max() < 1e-4  # the tables are float32


def test_the_arrays_of_opencvs_tutorial_get_tables_with_an_image_size(capsys, tmp_path):
    camera = CAMERAS["brown"]
    np.savez(tmp_path / "calib.npz", mtx=camera.matrix, dist=[camera.coefficients[:5]])
    words = (tmp_path / "calib.npz", "-o", tmp_path / "new")
    assert "--image-size" in say(capsys, *words, status=2)
    say(capsys, *words, "--image-size", "400x300")
    with np.load(tmp_path / "new" / "undistort.npz") as tables:
        assert tables["rays"][150, 200] == pytest.approx(camera.rays(np.array([[200.0, 150.0]]))[0], abs=1e-6)
        assert np.array_equal(tables["camera_matrix"], camera.matrix)


def test_a_fault_is_one_clear_error_and_nothing_is_written(capsys, tmp_path, calibrated):
    _, folder = calibrated
    cv2.imwrite(str(folder / "small.png"), np.full((30, 40), 128, np.uint8))
    (folder / "events.csv").write_text("1 2 3 4\n")
    faults = [
        (2, "This picture has 40 x 30 px, the camera 400 x 300 px", "info.yaml", "--preview", "small.png"),
        (2, "There is no picture in this file", "info.yaml", "--preview", "events.csv"),
        (2, "2", "info.yaml", "--keep", "2"),
        (2, "400 x 300 px", "info.yaml", "--image-size", "640x480"),
    ]
    for status, text, file, *words in faults:
        here = [folder / word if word.endswith((".png", ".csv")) else word for word in words]
        message = say(capsys, folder / file, "-o", folder / "new", *here, status=status)
        assert text in message
        assert not (folder / "new").exists()


def test_one_photograph_of_a_board_checks_a_calibration(capsys, calibrated):
    _, folder = calibrated
    words = ["check", str(folder / "board.png"), "--board", BOARD, "--calibration"]
    text = (folder / "info.yaml").read_text()
    changed = text.replace("-0.25", "-0.2").replace("-0.05", "0.02")
    (folder / "other.yaml").write_text(changed)
    for name, status, verdict in (("info.yaml", 0, "RIGHT as far"), ("other.yaml", 1, "NOT RIGHT: after")):
        assert verdict in call(capsys, *words, folder / name, status=status).out
