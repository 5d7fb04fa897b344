"""Exports: other readers get the same camera, and what a format cannot carry is refused."""

import ast
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml

from bench.results.exports import FormatCannotCarry, exports, kalibr_camchain, opencv_yaml
from calib.calibration import Calibration, ViewSummary
from calib.model.boresight import Boresight
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.target import StarTarget

LENSES = {
    "none": {},
    "k1k2": {"k1": 0.06, "k2": -0.9},
    "k1k2p1p2": {"k1": 0.06, "k2": -0.9, "p1": 1e-5, "p2": -0.0002},
    "k1k2k3p1p2": {"k1": 0.06, "k2": -0.9, "p1": 1e-5, "p2": -0.0002, "k3": 0.3},
    "rational": {
        "k1": 0.06,
        "k2": -0.9,
        "p1": 1e-5,
        "p2": -0.0002,
        "k3": 0.3,
        "k4": 0.01,
        "k5": 0.02,
        "k6": -0.1,
    },
}
FISHEYES = {
    "fisheye": {"kb1": 0.03, "kb2": -0.02, "kb3": 1e-5, "kb4": 0.004},
    "fisheye, kb1 and kb2": {"kb1": 0.03, "kb2": -0.02},
}
RAYS = np.array([[0.0, 0.0, 1.0], [0.15, -0.1, 1.0], [-0.2, 0.08, 1.1], [0.05, 0.11, 0.9]])


def calibration(lens):
    distortion = {**LENSES, **FISHEYES}[lens]
    camera = CameraModel(3345.06, 3345.27, 642.1, 363.32, (1280, 720), distortion)
    rotations = np.stack([cv2.Rodrigues(np.array(v))[0] for v in ([0.0, 0.1, 0.0], [0.05, 0.0, -0.2])])
    names = (*camera.parameter_names, "x", "y", "r")
    return Calibration(
        model="spherical",
        camera=camera,
        collimator=Collimator(96.0, 144.0, 255.0),
        rotations=rotations,
        centres=np.array([[96.0, 144.0, -255.0]] * 2),
        parameter_names=names,
        values=np.array([*camera.values, 96.0, 144.0, 255.0]),
        covariance=np.diag(np.arange(1.0, len(names) + 1)),
        residuals_px=[],
        weights=[],
        rms_px=0.081,
        mean_px=0.07,
        variance_factor=1.0,
        degrees_of_freedom=100,
        views=(ViewSummary("left", 300, 0.08, 0.07), ViewSummary("right", 310, 0.082, 0.07)),
        converged=True,
        iterations=5,
    )


def by_opencv(matrix, coefficients):
    """Image points of the rays, by OpenCV."""
    image, _ = cv2.projectPoints(
        RAYS, np.zeros(3), np.zeros(3), np.asarray(matrix, float), np.asarray(coefficients, float)
    )
    return image[:, 0]


def by_opencv_fisheye(fx, fy, cx, cy, coefficients):
    """Image points of the rays, by OpenCV's fisheye functions."""
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    image, _ = cv2.fisheye.projectPoints(
        RAYS[:, None], np.zeros((3, 1)), np.zeros((3, 1)), matrix, np.array(coefficients, float)
    )
    return image[:, 0]


def file_storage(data, extension):
    storage = cv2.FileStorage(data.decode(), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    assert storage.isOpened(), extension
    return storage


@pytest.mark.parametrize("lens", LENSES)
def test_opencv_reads_back_the_same_camera(lens):
    wanted = calibration(lens)
    storage = file_storage(opencv_yaml(wanted, "camera"), ".yml")
    matrix = storage.getNode("camera_matrix").mat()
    coefficients = storage.getNode("distortion_coefficients").mat()
    np.testing.assert_array_equal(
        by_opencv(matrix, coefficients), by_opencv(wanted.camera.matrix, wanted.camera.coefficients)
    )
    np.testing.assert_allclose(by_opencv(matrix, coefficients), wanted.camera.project(RAYS), atol=1e-9)
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


def test_the_opencv_file_begins_as_every_opencv_reads_it():
    assert opencv_yaml(calibration("k1k2"), "camera").startswith(b"%YAML:1.0\n---\n")


@pytest.mark.parametrize(
    ("lens", "model", "count"),
    [("none", "plumb_bob", 5), ("k1k2k3p1p2", "plumb_bob", 5), ("rational", "rational_polynomial", 8)],
)
def test_ros_gets_the_fields_it_demands(lens, model, count):
    wanted = calibration(lens)
    info = yaml.safe_load(exports(wanted, camera_name="evk4_00050423")["ros_camera_info.yaml"])
    assert info["distortion_model"] == model
    assert info["camera_name"] == "evk4_00050423"
    shapes = {name: (m["rows"], m["cols"], len(m["data"])) for name, m in info.items() if isinstance(m, dict)}
    assert shapes == {
        "camera_matrix": (3, 3, 9),
        "distortion_coefficients": (1, count, count),
        "rectification_matrix": (3, 3, 9),
        "projection_matrix": (3, 4, 12),
    }
    matrix = np.reshape(info["camera_matrix"]["data"], (3, 3))
    coefficients = info["distortion_coefficients"]["data"]
    np.testing.assert_allclose(by_opencv(matrix, coefficients), wanted.camera.project(RAYS), atol=1e-9)
    np.testing.assert_array_equal(np.reshape(info["projection_matrix"]["data"], (3, 4))[:, :3], matrix)


def test_small_numbers_stay_numbers_in_yaml():
    # YAML 1.1 takes 1e-05 for a word: a dot must stand in it
    files = exports(calibration("k1k2p1p2"), camera_name="c")
    assert yaml.safe_load(files["ros_camera_info.yaml"])["distortion_coefficients"]["data"][2] == 1e-5
    assert yaml.safe_load(files["kalibr_camchain.yaml"])["cam0"]["distortion_coeffs"][2] == 1e-5


def test_kalibr_gets_floats_and_whole_sizes():
    camera = yaml.safe_load(exports(calibration("k1k2p1p2"), camera_name="c")["kalibr_camchain.yaml"])["cam0"]
    assert all(isinstance(v, float) for v in camera["intrinsics"] + camera["distortion_coeffs"])
    assert camera["resolution"] == [1280, 720]
    assert all(isinstance(v, int) for v in camera["resolution"])
    assert (camera["camera_model"], camera["distortion_model"]) == ("pinhole", "radtan")
    assert isinstance(camera["rostopic"], str)


@pytest.mark.parametrize("lens", ["k1k2k3p1p2", "rational"])
def test_kalibr_gets_four_coefficients_that_project_as_the_lens_does(lens):
    wanted = calibration(lens).camera
    text = kalibr_camchain(calibration(lens), "c")
    assert text.startswith(b"# Kalibr's radtan has no k3.")
    camera = yaml.safe_load(text)["cam0"]
    (fx, fy, cx, cy), coefficients = camera["intrinsics"], camera["distortion_coeffs"]
    matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    corners = wanted.rays(
        np.array([[0.0, 0.0], [1279.0, 0.0], [0.0, 719.0], [1279.0, 719.0], [640.0, 360.0]])
    )
    image, _ = cv2.projectPoints(corners, np.zeros(3), np.zeros(3), np.array(matrix), np.array(coefficients))
    np.testing.assert_allclose(image[:, 0], wanted.project(corners), atol=0.05)


@pytest.mark.parametrize("lens", ["k1k2k3p1p2", "rational"])
def test_a_lens_kalibr_cannot_carry_is_refused_and_told(lens, monkeypatch):
    wide = {**LENSES[lens], "k3": 40.0}
    monkeypatch.setitem(LENSES, lens, wide)
    with pytest.raises(
        FormatCannotCarry, match=r"radtan cannot represent k3.*no other coefficients than k1 k2 p1 p2"
    ):
        kalibr_camchain(calibration(lens), "c")
    files = exports(calibration(lens), camera_name="c")
    assert "kalibr_camchain.yaml" not in files
    assert files["not-written.txt"].startswith(b"kalibr_camchain.yaml: Kalibr's radtan cannot represent k3")


def test_a_lens_that_all_carry_leaves_nothing_to_tell():
    assert "not-written.txt" not in exports(calibration("k1k2"), camera_name="c")
    assert len(exports(calibration("k1k2"), camera_name="c")) == 7


@pytest.mark.parametrize("lens", LENSES)
def test_mrcal_s_text_holds_the_camera_in_opencv_s_order(lens):
    wanted = calibration(lens)
    model = ast.literal_eval(exports(wanted, camera_name="c")["mrcal.cameramodel"].decode())
    fx, fy, cx, cy, *coefficients = model["intrinsics"]
    assert model["lensmodel"] == f"LENSMODEL_OPENCV{len(coefficients)}"
    assert model["imagersize"] == [1280, 720]
    matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    np.testing.assert_allclose(by_opencv(matrix, coefficients), wanted.camera.project(RAYS), atol=1e-9)


@pytest.mark.parametrize(
    ("lens", "model", "count"), [("k1k2p1p2", "OPENCV", 8), ("k1k2k3p1p2", "FULL_OPENCV", 12)]
)
def test_colmap_s_pixels_lie_half_a_pixel_further(lens, model, count):
    wanted = calibration(lens)
    line = exports(wanted, camera_name="c")["colmap_cameras.txt"].decode().splitlines()[-1].split()
    assert line[:4] == ["1", model, "1280", "720"]
    fx, fy, cx, cy, *coefficients = map(float, line[4:])
    assert len(line[4:]) == count
    image = by_opencv([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], coefficients)
    np.testing.assert_allclose(image - 0.5, wanted.camera.project(RAYS), atol=1e-9)


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


@pytest.mark.parametrize("lens", LENSES)
def test_metavision_s_json_is_read_by_opencv_and_by_any_json_reader(lens):
    wanted = calibration(lens)
    data = exports(wanted, camera_name="c")["metavision.json"]
    storage = file_storage(data, ".json")
    matrix, coefficients = (storage.getNode(n).mat() for n in ("camera_matrix", "distortion_coefficients"))
    np.testing.assert_allclose(by_opencv(matrix, coefficients), wanted.camera.project(RAYS), atol=1e-9)
    found = json.loads(data)
    assert (found["n_kept_views"], found["image_size"], found["selected_views"]) == (2, [1280, 720], [1, 1])
    translation = found["tvecs"][0]["data"]
    np.testing.assert_allclose(
        np.multiply(translation, 1000), -wanted.rotations[0] @ wanted.centres[0], atol=1e-9
    )


def test_the_geometry_of_metavision_sdk_5_holds_k_by_rows_and_five_coefficients():
    content = json.loads(exports(calibration("k1k2k3p1p2"), camera_name="c")["camera-geometry.json"])
    lens = LENSES["k1k2k3p1p2"]
    assert content == {
        "type": "pinhole",
        "width": 1280,
        "height": 720,
        "K": [3345.06, 0.0, 642.1, 0.0, 3345.27, 363.32, 0.0, 0.0, 1.0],
        "D": [lens[name] for name in ("k1", "k2", "p1", "p2", "k3")],
    }


@pytest.mark.parametrize("name", ["evk4_a\\b", "evk4_1\n2", "evk4_a b:c", "evk4_\u00fc-1"])
def test_a_serial_number_of_any_letters_leaves_every_file_readable(name):
    files = exports(calibration("k1k2"), camera_name=name)
    storage = file_storage(files["opencv.yaml"], ".yml")
    told = storage.getNode("camera_name").string()
    assert told.isascii()
    assert told.replace("_", "a").isalnum()
    assert yaml.safe_load(files["ros_camera_info.yaml"])["camera_name"] == told
    assert yaml.safe_load(files["kalibr_camchain.yaml"])["cam0"]["rostopic"] == f"/{told}/events"
    assert json.loads(files["metavision.json"])["camera_name"] == told
    assert ast.literal_eval(files["mrcal.cameramodel"].decode())["imagersize"] == [1280, 720]
    assert len(files["colmap_cameras.txt"].decode().splitlines()) == 3


def test_the_same_calibration_gives_the_same_bytes():
    one, two = (exports(calibration("rational"), camera_name="c") for _ in range(2))
    assert one == two


@pytest.mark.parametrize("lens", FISHEYES)
def test_opencv_s_fisheye_functions_see_the_same_camera_in_every_format_that_has_one(lens):
    wanted = calibration(lens)
    image = wanted.camera.project(RAYS)
    files = exports(wanted, camera_name="c")

    storage = file_storage(files["opencv.yaml"], ".yml")
    assert storage.getNode("fisheye_model").real() == 1
    m, d = (storage.getNode(name).mat() for name in ("camera_matrix", "distortion_coefficients"))
    np.testing.assert_allclose(
        by_opencv_fisheye(m[0, 0], m[1, 1], m[0, 2], m[1, 2], d.ravel()), image, atol=1e-9
    )

    ros = yaml.safe_load(files["ros_camera_info.yaml"])
    assert ros["distortion_model"] == "equidistant"
    m = np.reshape(ros["camera_matrix"]["data"], (3, 3))
    coefficients = ros["distortion_coefficients"]["data"]
    assert len(coefficients) == 4
    np.testing.assert_allclose(
        by_opencv_fisheye(m[0, 0], m[1, 1], m[0, 2], m[1, 2], coefficients), image, atol=1e-9
    )

    kalibr = yaml.safe_load(files["kalibr_camchain.yaml"])["cam0"]
    assert (kalibr["camera_model"], kalibr["distortion_model"]) == ("pinhole", "equidistant")
    np.testing.assert_allclose(
        by_opencv_fisheye(*kalibr["intrinsics"], kalibr["distortion_coeffs"]), image, atol=1e-9
    )

    line = files["colmap_cameras.txt"].decode().splitlines()[-1].split()
    assert line[1] == "OPENCV_FISHEYE"
    fx, fy, cx, cy, *coefficients = map(float, line[4:])
    np.testing.assert_allclose(by_opencv_fisheye(fx, fy, cx, cy, coefficients) - 0.5, image, atol=1e-9)


@pytest.mark.parametrize("name", ["mrcal.cameramodel", "metavision.json", "camera-geometry.json"])
def test_a_format_without_fisheye_is_left_out_and_told(name):
    files = exports(calibration("fisheye"), camera_name="c")
    assert name not in files
    (told,) = (text for text in files["not-written.txt"].decode().splitlines() if text.startswith(name))
    assert "cannot represent a fisheye lens" in told


def test_a_lens_of_brown_s_model_is_no_fisheye_to_opencv():
    storage = file_storage(opencv_yaml(calibration("k1k2"), "camera"), ".yml")
    assert storage.getNode("fisheye_model").real() == 0


def test_the_boresight_is_a_transform_as_ros_publishes_it():
    turned = cv2.Rodrigues(np.array([0.02, -0.5, 0.1]))[0]
    found = Boresight(turned, np.eye(3), np.ones(3), turned.T[:, 2], np.eye(2), np.ones(2))
    assert Boresight.from_dict(json.loads(json.dumps(found.to_dict()))).to_dict() == found.to_dict()
    assert "boresight.yaml" not in exports(calibration("k1k2"), camera_name="c")
    files = exports(replace(calibration("k1k2"), boresight=found), camera_name="cam 1")
    content = yaml.safe_load(files["boresight.yaml"])
    assert (content["frame_id"], content["child_frame_id"]) == ("flange", "cam_1_optical_frame")
    x, y, z, w = (content["rotation"][name] for name in "xyzw")
    ahead = [
        2 * (x * z + w * y),
        2 * (y * z - w * x),
        1 - 2 * (x * x + y * y),
    ]  # the camera's z in the flange
    np.testing.assert_allclose(ahead, turned.T @ [0, 0, 1], atol=1e-12)
