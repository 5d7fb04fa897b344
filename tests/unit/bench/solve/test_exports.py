"""Exports: other readers get the same camera, and what a format cannot carry is refused."""

import ast
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from exported_camera import FISHEYES, LENSES, calibration

from bench.camera_files.reader import parse_camera
from bench.solve.exports import NOT_WRITTEN, FormatCannotCarry, exports, kalibr_camchain, opencv_yaml
from calib.model.result_parts import Boresight
from calib.target import StarTarget

RAYS = np.array([[0.0, 0.0, 1.0], [0.15, -0.1, 1.0], [-0.2, 0.08, 1.1], [0.05, 0.11, 0.9]])


def by_opencv(fx, fy, cx, cy, coefficients, *, fisheye=False):
    """Image points of the rays, by OpenCV."""
    matrix, none = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), np.zeros((3, 1))
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    return project(RAYS[:, None], none, none, matrix, np.array(coefficients, float))[0][:, 0]


def pinhole(matrix):
    return matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]


# What each format states, by readers that nobody here wrote: is it a fisheye, fx, fy, cx, cy, and its coefficients.


def of_file_storage(data, extension):
    storage = file_storage(data, extension)
    matrix, lens = (storage.getNode(name).mat() for name in ("camera_matrix", "distortion_coefficients"))
    return storage.getNode("fisheye_model").real() == 1, *pinhole(matrix), lens.ravel()


def of_ros(data):
    info = yaml.safe_load(data)
    model, lens = info["distortion_model"], info["distortion_coefficients"]["data"]
    shapes = {name: (m["rows"], m["cols"], len(m["data"])) for name, m in info.items() if isinstance(m, dict)}
    assert shapes == {
        "camera_matrix": (3, 3, 9),
        "distortion_coefficients": (1, len(lens), len(lens)),
        "rectification_matrix": (3, 3, 9),
        "projection_matrix": (3, 4, 12),
    }
    assert len(lens) == {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}[model]
    matrix = np.reshape(info["camera_matrix"]["data"], (3, 3))
    np.testing.assert_array_equal(np.reshape(info["projection_matrix"]["data"], (3, 4))[:, :3], matrix)
    return model == "equidistant", *pinhole(matrix), lens


def of_kalibr(data):
    camera = yaml.safe_load(data)["cam0"]
    assert camera["camera_model"] == "pinhole"
    fisheye = {"equidistant": True, "radtan": False}[camera["distortion_model"]]
    return fisheye, *camera["intrinsics"], camera["distortion_coeffs"]


def of_mrcal(data):
    model = ast.literal_eval(data.decode())
    fx, fy, cx, cy, *lens = model["intrinsics"]
    assert (model["lensmodel"], model["imagersize"]) == (f"LENSMODEL_OPENCV{len(lens)}", [1280, 720])
    return False, fx, fy, cx, cy, lens


def of_colmap(data):
    """Its pixels lie half a pixel further."""
    number, model, width, height, *values = data.decode().splitlines()[-1].split()
    assert (number, width, height) == ("1", "1280", "720")
    assert len(values) == {"OPENCV": 8, "FULL_OPENCV": 12, "OPENCV_FISHEYE": 8}[model]
    fx, fy, cx, cy, *lens = map(float, values)
    return model == "OPENCV_FISHEYE", fx, fy, cx - 0.5, cy - 0.5, lens


def of_geometry(data):
    content = json.loads(data)
    assert (content["type"], content["width"], content["height"]) == ("pinhole", 1280, 720)
    return False, *pinhole(np.reshape(content["K"], (3, 3))), content["D"]


READERS = {
    "opencv.yaml": lambda data: of_file_storage(data, ".yml"),
    "ros_camera_info.yaml": of_ros,
    "kalibr_camchain.yaml": of_kalibr,
    "mrcal.cameramodel": of_mrcal,
    "colmap_cameras.txt": of_colmap,
    "metavision.json": lambda data: of_file_storage(data, ".json"),
    "camera-geometry.json": of_geometry,
}
NOT_IN = dict.fromkeys(FISHEYES, ("mrcal.cameramodel", "metavision.json", "camera-geometry.json")) | {
    "rational": ("camera-geometry.json",)
}
"""Formats without a lens."""
NEARLY = {"kalibr_camchain.yaml": ("k1k2k3p1p2", "rational")}
"""Lenses that a format carries with other coefficients."""


@pytest.mark.parametrize("lens", [*LENSES, *FISHEYES])
@pytest.mark.parametrize("name", READERS)
def test_every_format_that_has_a_lens_holds_the_same_camera(name, lens):
    wanted = calibration(lens)
    files = exports(wanted, camera_name="evk4_00050423")
    if name in NOT_IN.get(lens, ()):
        assert name not in files
        reasons = [line for line in files["not-written.txt"].decode().splitlines() if line.startswith(name)]
        assert len(reasons) == 1
        assert f"cannot represent {'a fisheye lens' if lens in FISHEYES else 'k4'}" in reasons[0]
        return
    fisheye, *camera = READERS[name](files[name])
    assert fisheye is (lens in FISHEYES)
    if lens not in NEARLY.get(name, ()):
        image = by_opencv(*camera, fisheye=fisheye)
        np.testing.assert_allclose(image, wanted.camera.project(RAYS), atol=1e-9)


def file_storage(data, extension):
    storage = cv2.FileStorage(data.decode(), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    assert storage.isOpened(), extension
    return storage


def test_opencv_reads_covariance_and_rms_and_the_head_that_it_demands():
    wanted = calibration("k1k2")
    data = opencv_yaml(wanted, "camera")
    assert data.startswith(b"%YAML:1.0\n---\n")
    storage = file_storage(data, ".yml")
    assert (storage.getNode("image_width").real(), storage.getNode("image_height").real()) == (1280, 720)
    np.testing.assert_array_equal(storage.getNode("parameter_covariance").mat(), wanted.covariance)
    assert storage.getNode("avg_reprojection_error").real() == 0.081


def test_opencv_extrinsics_take_target_points_into_the_camera_frame():
    wanted = calibration("k1k2")
    storage = file_storage(opencv_yaml(wanted, "camera"), ".yml")
    rows = storage.getNode("extrinsic_parameters").mat()
    point = np.array([100.0, 150.0, 0.0])
    for row, rotation, centre in zip(rows, wanted.rotations, wanted.centres, strict=True):
        np.testing.assert_allclose(
            cv2.Rodrigues(row[:3])[0] @ point + row[3:], rotation @ (point - centre), atol=1e-9
        )


def test_numbers_in_yaml_stay_numbers_and_sizes_whole():
    # YAML 1.1 takes 1e-05 for a word: a dot must stand in it
    files = exports(calibration("k1k2p1p2"), camera_name="c")
    assert yaml.safe_load(files["ros_camera_info.yaml"])["distortion_coefficients"]["data"][2] == 1e-5
    camera = yaml.safe_load(files["kalibr_camchain.yaml"])["cam0"]
    assert camera["distortion_coeffs"][2] == 1e-5
    assert all(isinstance(v, float) for v in camera["intrinsics"] + camera["distortion_coeffs"])
    assert camera["resolution"] == [1280, 720]
    assert all(isinstance(v, int) for v in camera["resolution"])
    assert isinstance(camera["rostopic"], str)


@pytest.mark.parametrize("lens", ["k1k2k3p1p2", "rational"])
def test_kalibr_gets_four_coefficients_that_project_as_the_lens_does(lens):
    wanted = calibration(lens).camera
    text = kalibr_camchain(calibration(lens), "c")
    assert text.startswith(b"# Kalibr's radtan has no k3.")
    _, fx, fy, cx, cy, coefficients = of_kalibr(text)
    assert coefficients == [float(f"{value:.12g}") for value in coefficients]  # alike on any processor
    corners = wanted.rays(
        np.array([[0.0, 0.0], [1279.0, 0.0], [0.0, 719.0], [1279.0, 719.0], [640.0, 360.0]])
    )
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    image, _ = cv2.projectPoints(corners, np.zeros(3), np.zeros(3), matrix, np.array(coefficients))
    np.testing.assert_allclose(image[:, 0], wanted.project(corners), atol=0.05)


@pytest.mark.parametrize("lens", ["k1k2k3p1p2", "rational"])
def test_a_lens_kalibr_cannot_carry_is_refused_and_told(lens, monkeypatch):
    wide = {**LENSES[lens], "k3": 40.0}
    monkeypatch.setitem(LENSES, lens, wide)
    with pytest.raises(FormatCannotCarry, match=r"radtan cannot represent k3.*k1 k2 p1 p2"):
        kalibr_camchain(calibration(lens), "c")
    files = exports(calibration(lens), camera_name="c")
    assert "kalibr_camchain.yaml" not in files
    assert files["not-written.txt"].startswith(b"kalibr_camchain.yaml: Kalibr's radtan cannot represent k3")


def test_metavision_s_json_describes_the_target_that_was_seen():
    own = StarTarget(squares_x=30, squares_y=40, pitch_mm=2.5, tag_square=(13, 18))
    for given, expected in (({}, (72, 50, 144.5 / 36_000)), ({"target": own}, (40, 30, 0.0025))):
        written = exports(calibration("k1k2"), camera_name="c", **given)
        pattern = json.loads(written["metavision.json"])["pattern"]
        assert (pattern["n_rows"], pattern["n_cols"]) == expected[:2]
        assert pattern["square_width"] == pattern["square_height"] == pytest.approx(expected[2])


def test_metavision_s_json_is_not_written_for_views_of_several_targets():
    files = exports(calibration("k1k2"), camera_name="c", target=None)
    assert "metavision.json" not in files
    assert b"the views show several" in files["not-written.txt"]


def test_metavision_s_json_holds_the_places_of_the_target_in_metres():
    wanted = calibration("k1k2")
    intrinsics = json.loads(exports(wanted, camera_name="c")["metavision.json"])
    assert (intrinsics["n_kept_views"], intrinsics["selected_views"]) == (2, [1, 1])
    assert intrinsics["image_size"] == [1280, 720]
    translation = intrinsics["tvecs"][0]["data"]
    np.testing.assert_allclose(
        np.multiply(translation, 1000), -wanted.rotations[0] @ wanted.centres[0], atol=1e-9
    )


def test_a_serial_number_of_any_letters_leaves_every_file_readable():
    files = exports(calibration("k1k2"), camera_name="evk4_a\\b\n2 c:\u00fc-1")
    storage = file_storage(files["opencv.yaml"], ".yml")
    camera_name = storage.getNode("camera_name").string()
    assert camera_name.isascii()
    assert camera_name.replace("_", "a").isalnum()
    assert yaml.safe_load(files["ros_camera_info.yaml"])["camera_name"] == camera_name
    assert yaml.safe_load(files["kalibr_camchain.yaml"])["cam0"]["rostopic"] == f"/{camera_name}/events"
    assert json.loads(files["metavision.json"])["camera_name"] == camera_name
    assert len(files["colmap_cameras.txt"].decode().splitlines()) == 3
    for format_name, read in READERS.items():
        assert read(files[format_name])[1] == 3345.06


def test_the_boresight_is_a_transform_as_ros_publishes_it():
    turned = cv2.Rodrigues(np.array([0.02, -0.5, 0.1]))[0]
    boresight = Boresight(turned, np.eye(3), np.ones(3), turned.T[:, 2], np.eye(2), np.ones(2))
    assert Boresight.from_dict(json.loads(json.dumps(boresight.to_dict()))).to_dict() == boresight.to_dict()
    assert "boresight.yaml" not in exports(calibration("k1k2"), camera_name="c")
    files = exports(replace(calibration("k1k2"), boresight=boresight), camera_name="cam 1")
    content = yaml.safe_load(files["boresight.yaml"])
    assert (content["frame_id"], content["child_frame_id"]) == ("flange", "cam_1_optical_frame")
    x, y, z, w = (content["rotation"][name] for name in "xyzw")
    # The camera's z in the flange.
    ahead = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    np.testing.assert_allclose(ahead, turned.T @ [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("further", "written"),
    [
        ({"s1": 0.004, "s4": 0.002}, {"opencv.yaml": 12, "mrcal.cameramodel": 12, "metavision.json": 12}),
        ({"s1": 0.004, "tauX": 0.02}, {"opencv.yaml": 14, "metavision.json": 14}),
    ],
)
def test_a_thin_prism_and_a_tilted_sensor_are_written_whole_or_not_at_all(monkeypatch, further, written):
    monkeypatch.setitem(LENSES, "prism", {**LENSES["k1k2p1p2"], **further})
    known = calibration("prism")
    files = exports(known, camera_name="cam")
    assert set(files) == {*written, NOT_WRITTEN}
    for name in written:
        camera = parse_camera(files[name], Path(name)).camera
        assert camera.project(RAYS) == pytest.approx(known.camera.project(RAYS), abs=1e-9)
