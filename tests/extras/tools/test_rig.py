"""The command `rig`: boards at finite distance, clocks of two cameras; numbers, files, refusals."""

import json
from copy import deepcopy

import cv2
import numpy as np
import pytest
import yaml
from calling import out_of, refusal
from drawn_rig import BOARD as CORNERS_MM
from drawn_rig import Drawn

from calib.model.rotation import exp_map, log_map
from drivers.camera.formats.event_conversion import convert

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
        (("{}/left", "{}/moved", *BOARD), "do not fit one rig", 1),
        ((*BOTH, *BOARD[:2], "--calibration", "{}/left.yaml", "{}/small.yaml"), "640 x 480", 1),
        ((*BOTH, *BOARD, "--calibration", "{}/left.yaml", "{}/small.yaml"), "640 x 480", 2),
        ((*BOTH, *BOARD, "--calibration", "{}/left.yaml", "{}/two.yaml"), "cam0, cam1", 2),
    ],
)
def test_wrong_input_is_one_error_and_writes_nothing(capsys, drawn, tmp_path, words, fault, status):
    _, folder = drawn
    (folder / "blank").mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "blank" / "board-0.png"), np.full((720, 1280), 90, np.uint8))
    (folder / "other").mkdir(exist_ok=True)
    (folder / "moved").mkdir(exist_ok=True)
    for at, file in enumerate(sorted((folder / "right").iterdir())):
        (folder / "other" / f"x{file.name}").write_bytes(file.read_bytes())
        later = sorted((folder / "right").iterdir())[at - 1]  # recorded one board later than the first camera
        (folder / "moved" / file.name).write_bytes(later.read_bytes())
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


# ---------------------------------------------------------------- clocks of two cameras

SENSOR = (400, 300)

PERIOD_US, PERIODS = 4000, 6

OFFSET_US, GAIN = 1700.0, 60e-6

WORDS = ("--board", "checkerboard:11x7:20mm")


def flickering(view, clock, edges_us, path):
    """Write a recording of a board under a lamp that flickers: white paper sends events, and the sync signal edges."""
    whole = np.kron((np.add.outer(range(8), range(12)) + 1) % 2, np.full((40, 40), 255)).astype(np.uint8)
    sheet = cv2.copyMakeBorder(whole, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
    to_image, _ = cv2.findHomography(CORNERS_MM * 2.0 + 79.5, view.points_px)
    rows, columns = np.nonzero(cv2.warpPerspective(sheet, to_image, SENSOR, borderValue=0) > 127)
    edges = np.round(clock(np.asarray(edges_us, float))).astype(np.int64)
    n, up = len(rows), np.arange(len(edges)) % 2 == 0
    later = np.tile(np.sort((np.arange(n) * 997) % 300), len(edges))  # pixels fire one after the other
    np.savez(
        path.with_suffix(".npz"),
        t=np.repeat(edges, n) + 20 + later,
        x=np.tile(columns, len(edges)).astype(np.uint16),
        y=np.tile(rows, len(edges)).astype(np.uint16),
        p=np.repeat(up, n).astype(np.uint8),
        trigger_t=edges,
        trigger_value=up.astype(np.uint8),
        trigger_id=np.zeros(len(edges), np.uint8),
        size=np.array(SENSOR),
    )
    convert(path.with_suffix(".npz"), path, "raw")
    path.with_suffix(".npz").unlink()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Recordings of both cameras; those of the folder `alone` under another lamp."""
    rig, folder = Drawn(5, boards=4, sizes=(SENSOR, SENSOR), sigma_px=0.0), tmp_path_factory.mktemp("sync")
    lamp = 2000 + PERIOD_US // 2 * np.arange(2 * PERIODS)
    clocks = {"left": lambda t: t, "alone": lambda t: 1.01 * t}
    clocks["right"] = lambda t: t + OFFSET_US + GAIN * (t - lamp.mean())
    for name, views in {"left": rig.views[0], "right": rig.views[1], "alone": rig.views[1]}.items():
        (folder / name).mkdir()
        for view in views[: 2 if name == "alone" else None]:
            flickering(view, clocks[name], lamp, folder / name / f"{view.name}.raw")
    return folder


def test_the_offset_of_the_clocks_comes_from_the_trigger_edges(capsys, folder, tmp_path):
    words = ("rig", folder / "left", folder / "right", *WORDS, "--sync", "-o", tmp_path / "rig")
    answer = json.loads(out_of(capsys, *words, "--json"))
    held = json.loads((tmp_path / "rig" / "rig.json").read_text())
    assert held["clocks"] == answer["clocks"]
    assert len(answer["clocks"]["recordings"]) == 4
    for recording in answer["clocks"]["recordings"]:
        assert recording["offset_us"] == pytest.approx(OFFSET_US, abs=3.0 * recording["sigma_us"])
        assert recording["period_us"] == pytest.approx(PERIOD_US, abs=1.0)
        assert recording["edges"] == PERIODS
    assert answer["clocks"]["rate_ppm"] == pytest.approx(60.0, abs=3.0 * answer["clocks"]["sigma_rate_ppm"])
    shown = out_of(capsys, *words[:-2])
    assert "second - first = 1700" in shown
    assert "whole periods" in shown
    assert "Clock of" not in out_of(capsys, *words[:-3])


def test_recordings_that_are_not_synchronised_are_one_error(capsys, folder, tmp_path):
    words = ("rig", folder / "left", folder / "alone", *WORDS, "--sync", "-o", tmp_path / "new")
    assert "do not belong together" in refusal(capsys, *words)
    (tmp_path / "pictures").mkdir()
    cv2.imwrite(str(tmp_path / "pictures" / "board-0.png"), np.zeros((300, 400), np.uint8))
    words = ("rig", folder / "left", tmp_path / "pictures", *WORDS, "--sync", "-o", tmp_path / "new")
    assert "RAW recordings only" in refusal(capsys, *words, status=2)
    assert not (tmp_path / "new").exists()
