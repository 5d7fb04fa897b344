"""The command `rig`: boards at finite distance, numbers, files, refusals."""

import json
from copy import deepcopy

import cv2
import numpy as np
import pytest
import yaml
from calling import out_of, refusal
from drawn_rig import Drawn

from calib.model.rotation import exp_map, log_map

pytestmark = pytest.mark.usefixtures("calibrated_once")

SIZE = (1280, 720)

BOARD = ("--board", "checkerboard:11x7:20mm", "--image-size", "1280x720")

BOTH = ("{}/left", "{}/right")


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """The truth, and for each camera its folder of point files and its file of intrinsics."""
    rig = Drawn(2, boards=10, sizes=(SIZE, SIZE))
    folder = tmp_path_factory.mktemp("rig")
    rig.write_boards(folder)
    return rig, folder


def test_collimator_and_boards_are_one_adjustment(capsys, drawn):
    rig, folder = drawn
    stars = [folder / "stars-left", folder / "stars-right"]
    rig.write_stars(*stars)
    turned = json.loads(out_of(capsys, "rig", *stars, "--image-size", "1280x720", "--json"))
    boards = ("--boards", folder / "left", folder / "right", *BOARD)
    both = json.loads(out_of(capsys, "rig", *stars, *boards, "--json"))
    assert turned["translation"] is None
    shown = out_of(capsys, "rig", *stars, "--image-size", "1280x720")
    assert "no translation" in shown
    assert len(both["views"]) == 4
    assert len(both["boards"]) == 10
    assert max(both["sigma_arcsec"]) < 0.9 * max(turned["sigma_arcsec"])
    files = [folder / "left.yaml", folder / "right.yaml"]
    words = ("rig", *stars, "--image-size", "1280x720", "--json", "--calibration")
    held = json.loads(out_of(capsys, *words, *files))  # no uncertainty is stated: the true values are held
    assert max(held["sigma_arcsec"]) < 0.5 * max(turned["sigma_arcsec"])
    assert held["cameras"][0]["fx"] == pytest.approx(rig.cameras[0].fx, abs=0.01)
    off = 206265 * log_map(np.array(held["rotation"]) @ rig.rotation.T)
    assert (np.abs(off) < 2.5 * np.array(held["sigma_arcsec"])).all()
    assert "contradicts its views" in refusal(capsys, *words, *files[::-1])
    off = 206265 * log_map(np.array(both["rotation"]) @ rig.rotation.T)
    assert (np.abs(off) < 4.0 * np.array(both["sigma_arcsec"])).all()
    assert (np.abs(np.array(both["translation"]) - rig.translation) < 4.0 * np.array(both["sigma_mm"])).all()


def test_the_files_hold_the_rig_as_other_programs_read_it(capsys, drawn, tmp_path):
    rig, folder = drawn
    files = (folder / "left.yaml", folder / "right.yaml")
    words = ("rig", folder / "left", folder / "right", *BOARD, "--calibration", *files)
    out_of(capsys, *words, "-o", tmp_path / "rig")
    assert sorted(file.name for file in (tmp_path / "rig").iterdir()) == [
        "cam0_camera_info.yaml", "cam1_camera_info.yaml", "extrinsics.json", "kalibr_camchain.yaml",
        "opencv_stereo.yaml", "rig.json",
    ]  # fmt: skip
    held = json.loads((tmp_path / "rig" / "rig.json").read_text())
    t_m = np.array(held["translation"]) / 1000.0
    assert np.abs(np.array(held["translation"]) - rig.translation).max() < 0.5

    (slave,) = json.loads((tmp_path / "rig" / "extrinsics.json").read_text())["T_slave_master"]
    assert slave["tvec"] == pytest.approx(t_m)
    assert exp_map(np.array(slave["rvec"])) == pytest.approx(np.array(held["rotation"]))

    chain = yaml.safe_load((tmp_path / "rig" / "kalibr_camchain.yaml").read_text())
    pose = np.array(chain["cam1"]["T_cn_cnm1"])
    assert pose[:3, 3] == pytest.approx(t_m)
    assert chain["cam0"]["cam_overlaps"] == [1]

    # Rectified by the pair of camera_info, both images show a point in the same row, at a disparity of f B / z.
    point = np.array([[30.0, -20.0, 700.0]])
    both = point, point @ rig.rotation.T + rig.translation
    rows = []
    for name, camera, there in zip(("cam0", "cam1"), rig.cameras, both, strict=True):
        info = yaml.safe_load((tmp_path / "rig" / f"{name}_camera_info.yaml").read_text())
        matrices = [np.array(info[key]["data"]) for key in ("camera_matrix", "distortion_coefficients")]
        turn = np.array(info["rectification_matrix"]["data"]).reshape(3, 3)
        projection = np.array(info["projection_matrix"]["data"]).reshape(3, 4)
        seen = camera.project(there)[None]
        to_pixels = {"R": turn, "P": projection[:, :3]}
        rows.append(cv2.undistortPoints(seen, matrices[0].reshape(3, 3), matrices[1], **to_pixels)[0, 0])
    across = int(abs(projection[1, 3]) > abs(projection[0, 3]))
    assert rows[0][1 - across] == pytest.approx(rows[1][1 - across], abs=1.0)
    assert abs(projection[across, 3] / projection[0, 0]) == pytest.approx(np.linalg.norm(t_m), rel=1e-6)

    stored = cv2.FileStorage(str(tmp_path / "rig" / "opencv_stereo.yaml"), cv2.FILE_STORAGE_READ)
    assert stored.getNode("T").mat().ravel() == pytest.approx(1000.0 * t_m)
    assert "not empty" in refusal(capsys, *words, "-o", tmp_path / "rig", status=2)


def sdk_file(path, rotation, translation_mm, times=1):
    rvec, tvec = log_map(rotation[None])[0].tolist(), (translation_mm / 1000.0).tolist()
    slave = {"camera": "right", "rvec": rvec, "tvec": tvec}
    path.write_text(json.dumps({"T_slave_master": [slave] * times}))
    return path


def test_a_stated_rig_is_right_until_a_camera_moves(capsys, drawn, tmp_path):
    rig, folder = drawn
    words = ("rig", folder / "left", folder / "right", *BOARD, "--stated")
    still = sdk_file(tmp_path / "extrinsics.json", rig.rotation, rig.translation)
    shown = out_of(capsys, *words, still)
    assert "RIGHT within U" in shown
    assert "states no uncertainty" in shown
    check = json.loads(out_of(capsys, *words, still, "--json"))["stated"]
    assert check["right"]
    assert check["arcsec"] < 600.0

    turned = exp_map(np.radians([[0.0, 1.0, 0.0]]))[0] @ rig.rotation
    shown = out_of(capsys, *words, sdk_file(tmp_path / "turned.json", turned, rig.translation), status=1)
    assert "NOT RIGHT" in shown
    moved = sdk_file(tmp_path / "moved.json", rig.rotation, rig.translation + np.array([0.0, 5.0, 0.0]))
    assert "NOT RIGHT" in out_of(capsys, *words, moved, status=1)


def test_a_rig_of_an_earlier_day_is_right_with_both_uncertainties(capsys, drawn, tmp_path):
    _, folder = drawn
    words = ("rig", folder / "left", folder / "right", *BOARD)
    out_of(capsys, *words, "-o", tmp_path / "rig")
    check = json.loads(out_of(capsys, *words, "--stated", tmp_path / "rig" / "rig.json", "--json"))["stated"]
    assert check["has_covariance"]
    assert check["normalised"] < 1e-3


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ("{}", "it has no 'vector_deg'"),
        ('{"T_slave_master": []}', "0 cameras"),
        ('{"T_slave_master": [{"rvec": [0, 0, 0]}]}', "it has no 'tvec'"),
        ('{"T_slave_master": [{"rvec": [0, 0, 1e999], "tvec": [0, 0, 0]}]}', "does not hold a rig"),
        ('{"T_slave_master": [{"rvec": [0, 0, 0], "tvec": [0, 0, 1e30]}]}', "is not a distance on a rig"),
        (
            '{"vector_deg": [0, 0, 0], "translation": null, "pose_covariance": [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]}',
            "its covariance is impossible",
        ),
    ],
)
def test_a_file_without_a_rig_is_refused(capsys, drawn, tmp_path, content, fault):
    _, folder = drawn
    (tmp_path / "bad.json").write_text(content)
    stated = ("--stated", tmp_path / "bad.json")
    message = refusal(capsys, "rig", folder / "left", folder / "right", *BOARD, *stated, status=2)
    assert fault in message
    assert "Known are rig.json" in message


def test_boards_that_the_second_camera_saw_upside_down_are_numbered_anew(capsys, drawn, tmp_path):
    rig, folder = drawn
    for file in sorted((folder / "right").iterdir()):
        x, y, across, down, number = np.loadtxt(file, delimiter=",").T
        rows = np.column_stack([1280 - x, 720 - y, 200.0 - across, 120.0 - down, 76 - number])
        np.savetxt(tmp_path / file.name, rows, delimiter=",")
    rig_found = json.loads(out_of(capsys, "rig", folder / "left", tmp_path, *BOARD, "--json"))
    assert len(rig_found["half_turned"]) == 10
    half = np.diag([-1.0, -1.0, 1.0])
    off = 206265 * log_map(np.array(rig_found["rotation"]) @ (half @ rig.rotation).T)
    assert (np.abs(off) < 4.0 * np.array(rig_found["sigma_arcsec"])).all()
    moved_mm = np.array(rig_found["translation"]) - half @ rig.translation
    assert (np.abs(moved_mm) < 4.0 * np.array(rig_found["sigma_mm"])).all()
    shown = out_of(capsys, "rig", folder / "left", tmp_path, *BOARD)
    assert "10 of 10 boards" in shown


def test_the_intrinsics_of_one_chain_are_named(capsys, drawn, tmp_path):
    _, folder = drawn
    words = ("rig", folder / "left", folder / "right", *BOARD)
    out_of(capsys, *words, "-o", tmp_path / "rig")
    chain = tmp_path / "rig" / "kalibr_camchain.yaml"
    given = ("--calibration", chain, chain, "--camera", "cam0", "cam1", "--json")
    answer = json.loads(out_of(capsys, *words, *given))
    stated = yaml.safe_load(chain.read_text())
    assert [camera["fx"] for camera in answer["cameras"]] == pytest.approx(
        [stated[name]["intrinsics"][0] for name in ("cam0", "cam1")], abs=1e-3
    )


@pytest.mark.parametrize(
    ("words", "fault", "status"),
    [
        ((*BOTH, "--boards", "{}/left", "{}/right"), "--boards needs --board", 2),
        ((*BOTH, "--calibration", "{}/left/a.yaml", "{}/right.yaml"), "the same views", 2),
        (("{}/left", "{}/other", *BOARD), "share no pose", 1),
        (("{}/left", "{}/right/../left", *BOARD), "Both cameras have the same views.", 2),
        (("{}/left/board-0.csv", "{}/right/board-0.csv", *BOARD), "Show the board at more angles.", 1),
        ((*BOTH, "--boards", "{}/left", "{}/left", *BOARD), "Both cameras", 2),
        (("{}/left", "{}/blank", *BOARD), "whole board", 1),
        ((*BOTH, *BOARD, "--calibration", "{}/left.yaml", "{}/small.yaml"), "640 x 480", 2),
        ((*BOTH, *BOARD, "--calibration", "{}/left.yaml", "{}/two.yaml"), "cam0, cam1", 2),
    ],
)
def test_wrong_input_is_one_error_and_writes_nothing(capsys, drawn, tmp_path, words, fault, status):
    _, folder = drawn
    (folder / "blank").mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "blank" / "board-0.png"), np.full((720, 1280), 90, np.uint8))
    (folder / "other").mkdir(exist_ok=True)
    for file in (folder / "right").iterdir():
        (folder / "other" / f"x{file.name}").write_bytes(file.read_bytes())
    whole = (folder / "right.yaml").read_text()
    (folder / "small.yaml").write_text(whole.replace("1280", "640").replace("720", "480"))
    camera = {
        "camera_model": "pinhole", "intrinsics": [1, 1, 1, 1], "distortion_model": "radtan",
        "distortion_coeffs": [0, 0, 0, 0], "resolution": [1280, 720],
    }  # fmt: skip
    (folder / "left" / "a.yaml").write_text(whole)
    (folder / "two.yaml").write_text(yaml.safe_dump({"cam0": camera, "cam1": deepcopy(camera)}))
    words = (*(word.format(folder) for word in words), "-o", tmp_path / "new")
    message = refusal(capsys, "rig", *words, status=status)
    assert fault in message
    assert message.count("Error") <= 1
    assert not (tmp_path / "new").exists()
