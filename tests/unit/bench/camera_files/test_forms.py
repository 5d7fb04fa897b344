"""The forms of camera files, as their programs write them: the rays of each camera are those of OpenCV."""

import contextlib
import gzip
import io
import json
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from camera_oracle import D5, D14, FISHEYE, FLAT_K, FOCAL_AND_CENTRE, SIZE, K, off_px
from hypothesis import given
from hypothesis import strategies as st

from bench.base.failure import Failure
from bench.camera_files.reader import NotACamera, parse_camera


def read(data, name=None, lens=None, image_size=None):
    return parse_camera(data if isinstance(data, bytes) else data.encode(), Path("f"), name, lens, image_size)


def file_storage(kind, content):
    """A file of cv2.FileStorage."""
    storage = cv2.FileStorage(f".{kind}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in content.items():
        storage.write(name, np.array(value) if isinstance(value, list) else value)
        storage.writeComment("as the sample does for its flags")
    return storage.releaseAndGetString()


def sample(coefficients, **more):
    """What OpenCV's sample calibration.cpp writes: points of 12 views make it long."""
    points = np.random.default_rng(1).uniform(0, 700, (12, 108)).tolist()
    return {
        "calibration_time": "Wed 06 May 2026 11:23:41 AM", "nframes": 12, "image_width": 1280, "image_height": 720,
        "board_width": 9, "board_height": 6, "square_size": 20.0, "aspectRatio": 1.0, "flags": 2, **more,
        "camera_matrix": K, "distortion_coefficients": [[value] for value in coefficients],
        "avg_reprojection_error": 0.21, "per_view_reprojection_errors": [[0.2]] * 12,
        "extrinsic_parameters": [[0.0] * 6] * 12, "image_points": points, "grid_points": points,
    }  # fmt: skip


#: interactive-calibration: the size is an element of two numbers there.
INTERACTIVE = file_storage(
    "xml",
    {
        "calibrationDate": "Wed", "framesCount": 12, "cameraResolution": "1280 720", "cameraMatrix": K,
        "cameraMatrix_std_dev": [[0.1]] * 4, "dist_coeffs": [D5], "dist_coeffs_std_dev": [[0.1]] * 5,
        "avg_reprojection_error": 0.2,
    },
).replace('"1280 720"', "1280 720")  # fmt: skip


def in_flow(value):
    return f"!!opencv-matrix\n   rows: 1\n   cols: {len(value)}\n   dt: d\n   data: {value}\n"


def opencv_yaml(coefficients, more=""):
    return (
        f"%YAML:1.0\n---\nimage_width: 1280\nimage_height: 720\n{more}"
        f"camera_matrix: {in_flow(FLAT_K)}distortion_coefficients: {in_flow(coefficients)}"
    )


#: OpenCV 2.4's camera_calibration.cpp.
OPENCV_2 = (
    "%YAML:1.0\ncalibration_Time: x\nnrOfFrames: 25\nimage_Width: 1280\nimage_Height: 720\nboard_Width: 9\n"
    "board_Height: 6\nsquare_Size: 50.\nFixAspectRatio: 1.\nflagValue: 14\n"
    f"Camera_Matrix: {in_flow(FLAT_K)}Distortion_Coefficients: {in_flow(D5)}Avg_Reprojection_Error: 0.2\n"
)


def npz(size=None, **arrays):
    """np.savez of OpenCV's tutorial for Python; poses of unlike shapes are objects, as pickles."""
    poses = np.empty(2, object)
    poses[:] = [np.zeros((3, 1)), np.zeros(3)]
    file = io.BytesIO()
    np.savez(file, **{"mtx": np.array(K), "dist": np.array([D5]), "rvecs": poses, "tvecs": poses, **arrays})
    return file.getvalue()


def npz_that_claims(shape):
    """np.savez whose camera matrix claims another shape than it has numbers."""
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode()
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("mtx.npy", b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head)
    return file.getvalue()


def ros_yaml(coefficients, model="plumb_bob", matrix=FLAT_K):
    """camera_calibration_parsers."""

    def block(name, rows, columns, data):
        return f"{name}:\n  rows: {rows}\n  cols: {columns}\n  data: {data}\n"

    return (
        "image_width: 1280\nimage_height: 720\ncamera_name: narrow_stereo\n"
        + block("camera_matrix", 3, 3, matrix)
        + (f"distortion_model: {model}\n" if model is not None else "")
        + block("distortion_coefficients", 1, len(coefficients), coefficients)
        + block("rectification_matrix", 3, 3, np.eye(3).ravel().tolist())
        + block(
            "projection_matrix", 3, 4, [700.0, 0.0, 640.0, 0.0, 0.0, 700.0, 360.0, 0.0, 0.0, 0.0, 1.0, 0.0]
        )
    )


def ros_echo(generation, model="plumb_bob", coefficients=D5, more=""):
    """One message, as `rostopic echo -n 1` and `ros2 topic echo --once` print it."""
    time = "    secs: 10\n    nsecs: 5" if generation == 1 else "    sec: 10\n    nanosec: 5"
    lists = {"d": coefficients, "k": FLAT_K, "r": np.eye(3).ravel().tolist(), "p": [0.0] * 12}
    if generation == 1:
        values = "".join(f"{name.upper()}: {value}\n" for name, value in lists.items())
    else:
        values = "".join(f"{name}:\n" + "".join(f"- {v}\n" for v in value) for name, value in lists.items())
    head = f"header:\n  stamp:\n{time}\n  frame_id: cam\nheight: 720\nwidth: 1280\n"
    return f"{head}distortion_model: {model}\n{values}{more}---\n"


def kalibr(coefficients, model="radtan", fx=1050.3, number=0, more=""):
    return (
        f"cam{number}:\n  T_cam_imu:\n  - [1.0, 0.0, 0.0, 0.0]\n  cam_overlaps: [1]\n  camera_model: pinhole\n"
        f"  distortion_coeffs: {coefficients}\n  distortion_model: {model}\n  intrinsics: {[fx, *FOCAL_AND_CENTRE[1:]]}\n"
        f"  resolution: [1280, 720]\n  rostopic: /cam{number}/events\n  timeshift_cam_imu: 5.6e-05\n{more}"
    )


#: kalibr_calibrate_cameras, two cameras.
CHAIN = kalibr(D5[:4]) + kalibr(D5[:4], fx=1051.3, number=1, more="  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, -0.1]\n")


def mrcal(coefficients):
    numbers = ", ".join(map(str, FOCAL_AND_CENTRE + coefficients))
    return (
        f"# generated on 2026-01-01\n{{\n    'lensmodel':  'LENSMODEL_OPENCV{len(coefficients)}',\n\n"
        f"    # intrinsics are fx,fy,cx,cy,distortion0,...\n    'intrinsics': [ {numbers},],\n"
        f"    'valid_intrinsics_region': [\n    [ 1, 2 ],\n    ],\n    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n"
        "    'imagersize': [ 1280, 720,],\n    'icam_intrinsics': 0,\n"
        "    'optimization_inputs': b'P${[},abc'\n                           b'x',\n}\n"
    )


def colmap(model, coefficients, numbers=(1050.3, 1049.1)):
    words = [*numbers, 644.7, 358.4, *coefficients]  # pixel centres lie at half integers
    head = "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
    return f"{head}1 {model} 1280 720 {' '.join(map(str, words))}\n"


SDK4 = {
    "camera_matrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": FLAT_K},
    "distortion_coefficients": {"type_id": "opencv-matrix", "rows": 1, "cols": 5, "dt": "d", "data": D5},
    "image_size": [1280, 720], "n_kept_views": 8, "pattern": {"n_rows": 6}, "selected_views": [1] * 8,
    "overall_rms_reprojection_error": 0.2, "per_view_rms_reprojection_errors": [0.2] * 8, "rvecs": [], "tvecs": [],
}  # fmt: skip
#: Metavision SDK 5, camera-geometry.json
GEOMETRY = {"type": "pinhole", "width": 1280, "height": 720, "K": FLAT_K, "D": D5}
LISTS = {"camera_matrix": K, "dist_coeff": [D5], "image_size": [1280, 720]}
ZEROS = [0.0] * 9

BROWN = {
    **{f"OpenCV's sample in {kind}": (file_storage(kind, sample(D5)), D5) for kind in ("yml", "xml", "json")},
    **{f"OpenCV, {count} coefficients": (opencv_yaml(D14[:count]), D14[:count]) for count in (8, 12, 14)},
    "OpenCV, four, not a fisheye": (opencv_yaml(D5[:4], "fisheye_model: 0\n"), D5[:4]),
    "OpenCV 2.4": (OPENCV_2, D5),
    "byte-order mark and line ends of Windows": ("\ufeff" + opencv_yaml(D5).replace("\n", "\r\n"), D5),
    "interactive-calibration": (INTERACTIVE, D5),
    "lists in JSON": (json.dumps(LISTS) + "\n\n", D5),
    "K and D": (json.dumps({"K": K, "D": D5, "width": 1280, "height": 720}), D5),
    "ROS": (ros_yaml(D5), D5),
    "ROS plumb_bob with 8, zeros": (ros_yaml([*D5, *ZEROS[:3]]), D5),
    "ROS rational with 8": (ros_yaml(D14[:8], "rational_polynomial"), D14[:8]),
    "ROS without a model": (ros_yaml(D5, None), D5),
    "ROS 2 topic echo": (ros_echo(2, "rational_polynomial", D14[:8]), D14[:8]),
    "Kalibr": (kalibr(D5[:4]), D5[:4]),
    "Metavision SDK 4": ("\ufeff" + json.dumps(SDK4), D5),
    "Metavision SDK 5": (json.dumps(GEOMETRY), D5),
    **{f"mrcal with {count}": (mrcal(D14[:count]), D14[:count]) for count in (4, 5, 8, 12)},
    "COLMAP OPENCV": (colmap("OPENCV", D5[:4]), D5[:4]),
    "COLMAP RADIAL": (colmap("RADIAL", D5[:2], (1050.3,)), D5[:2]),
}  # fmt: skip


@pytest.mark.parametrize(("text", "coefficients"), BROWN.values(), ids=BROWN)
def test_the_rays_of_a_camera_file_are_those_of_opencv(text, coefficients):
    camera = read(text).camera
    assert camera.image_size == SIZE
    matrix = [K[0], [0.0, 1050.3, 357.9], K[2]] if "RADIAL" in str(text) else K
    padded = [*coefficients, *ZEROS[: max(0, 4 - len(coefficients))]]
    assert off_px(camera, padded, matrix=matrix) < 1e-6


FISHEYES = {
    "OpenCV": opencv_yaml(FISHEYE, "fisheye_model: 1\n"),
    "ROS": ros_yaml(FISHEYE, "equidistant"),
    "ROS 2 topic echo": ros_echo(2, "equidistant", FISHEYE),
    "Kalibr": kalibr(FISHEYE, "equidistant"),
    "COLMAP": colmap("OPENCV_FISHEYE", FISHEYE),
}


@pytest.mark.parametrize("text", FISHEYES.values(), ids=FISHEYES)
def test_the_rays_of_a_fisheye_file_are_those_of_opencv(text):
    assert off_px(read(text).camera, FISHEYE, fisheye=True) < 1e-6


def test_a_fisheye_of_colmap_without_coefficients_is_equidistant():
    assert off_px(read(colmap("FISHEYE", [])).camera, [0.0] * 4, fisheye=True) < 1e-6


def test_the_arrays_of_opencvs_tutorial_are_read_with_a_size_and_no_pickle_is_opened():
    camera_file = read(npz(), image_size=SIZE)
    assert off_px(camera_file.camera, D5) < 1e-6
    assert camera_file.kind == "OpenCV's npz"
    with pytest.raises(NotACamera) as error:
        read(npz())
    assert "size of the image" in error.value.what
    assert "--image-size" in error.value.remedy


@pytest.mark.parametrize("text", [opencv_yaml(D5), ros_yaml(D5), kalibr(D5[:4]), json.dumps(GEOMETRY)])
def test_a_size_that_contradicts_the_file_is_refused(text):
    assert read(text, image_size=SIZE).camera.image_size == SIZE
    with pytest.raises(NotACamera, match="1280 x 720"):
        read(text, image_size=(640, 480))


def test_the_skew_of_a_fisheye_calibration_is_used_and_said():
    matrix = [FLAT_K[0], -0.96635, *FLAT_K[2:]]
    camera_file = read(ros_yaml(FISHEYE, "equidistant", matrix))
    assert off_px(camera_file.camera, FISHEYE, fisheye=True, skew_px=-0.96635) < 1e-6
    assert "-0.96635" in camera_file.remarks[0]


@pytest.mark.parametrize(
    "text", [opencv_yaml(FISHEYE), json.dumps({**SDK4, "distortion_coefficients": FISHEYE})]
)
def test_four_coefficients_without_a_lens_model_are_not_guessed(text):
    with pytest.raises(NotACamera) as error:
        read(text)
    assert "--lens" in error.value.remedy
    assert off_px(read(text, lens="fisheye").camera, FISHEYE, fisheye=True) < 1e-6
    assert off_px(read(text, lens="brown").camera, FISHEYE) < 1e-6


def test_an_option_does_not_override_what_a_file_states():
    with pytest.raises(NotACamera, match="not fisheye"):
        read(ros_yaml(D5), lens="fisheye")


STEREO = file_storage(
    "yml", {"M1": K, "D1": [D5], "M2": [[1051.3, 0, 644.2], *K[1:]], "D2": [D5], "R": np.eye(3).tolist(), "P1": K}
)  # fmt: skip
SEVERAL = {
    "Kalibr": (CHAIN, ("cam0", "cam1"), D5[:4]),
    "OpenCV's stereo sample": (STEREO, ("1", "2"), D5),
    "COLMAP": (
        colmap("OPENCV", D5[:4]) + colmap("OPENCV", D5[:4], (1051.3, 1049.1)).splitlines()[2].replace("1 ", "2 ", 1),
        ("1", "2"), D5[:4],
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "names", "coefficients"), SEVERAL.values(), ids=SEVERAL)
def test_one_camera_of_several_is_named(text, names, coefficients):
    size = SIZE if text is STEREO else None
    for name, fx in zip(names, (1050.3, 1051.3), strict=True):
        matrix = [[fx, *K[0][1:]], *K[1:]]
        assert off_px(read(text, name, image_size=size).camera, coefficients, matrix=matrix) < 1e-6
    with pytest.raises(NotACamera) as error:
        read(text)
    assert f"2 cameras: {', '.join(names)}" in error.value.what
    assert "--camera" in error.value.remedy
    with pytest.raises(NotACamera, match="no camera 'cam7'"):
        read(text, "cam7")


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ("binning_x: 2\nbinning_y: 2\n", "binned"),
        ("roi:\n  x_offset: 10\n  y_offset: 0\n  height: 600\n  width: 800\n  do_rectify: false\n", "region"),
        ("binning_x: 0\nbinning_y: 1\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 720\n  width: 1280\n", None),
    ],
)  # fmt: skip
def test_a_camera_of_binned_or_cropped_images_is_that_of_the_whole_image_and_says_so(more, why):
    camera_file = read(ros_echo(1, more=more))
    assert off_px(camera_file.camera, D5) < 1e-6
    assert [why in remark for remark in camera_file.remarks] == ([True] if why else [])


def test_a_principal_point_far_from_the_middle_is_remarked():
    (remark,) = read(ros_yaml(D5, matrix=[262.6, 0.0, 161.0, 0.0, 262.3, 89.5, 0.0, 0.0, 1.0])).remarks
    assert "13 % of the width" in remark


#: What is no longer read, or never was, with names that the refusal lists.
FOREIGN = {
    "openicc": (
        {"fps": 60.0, "intrinsic_type": "FISHEYE", "intrinsics": {"focal_length": 905.25}},
        "fps, intrinsic_type, intrinsics",
    ),
    "april": ("aprilCameraCalibration {\n    names = [ camera0000 ];\n}\n", "no YAML"),
    "a name of two lines": ({**LISTS, "a\nSEALED": 0.1}, r"a\nSEALED"),
    "the matrix under two names": ({**LISTS, "K": K}, "K"),
    "no distortion": ({"K": K, "image_size": SIZE}, "K, image_size"),
    "a list": ("- 1\n- 2\n", "names with values"),
    "empty": ("", "it is empty"),
    "a rig of two": (json.dumps({"cam0": 1, "cam1": {}}), "2 cameras: cam0, cam1"),
    "binary": (b"\x00\x01\x02\x03", "binary"),
    "no UTF-8": ("Brennweite für 3".encode("latin-1"), "UTF-8"),
    "packed": (gzip.compress(b"K: 1"), "an archive"),
    "UTF-16": (opencv_yaml(D5).encode("utf-16"), "UTF-16"),
    "web page": ("<!DOCTYPE html>\n<html><body>Raw</body></html>", "a web page"),
    "zip": (b"PK\x03\x04\x14\x00", "np.savez"),
    "names of npz": (npz(k012=np.array([0.1])), "k012"),
}  # fmt: skip
SPOILT = {
    "plumb_bob with 8": (ros_yaml(D14[:8]), "5 coefficients, but coefficient 6 is 0.01"),
    "decimal commas": (ros_yaml(D5).replace(f"data: {D5}", "data: [-0,1, 0,02, 0,001, 0,0]"), "says 1 x 5 but holds 8 numbers"),
    "four of five": (opencv_yaml(D5).replace(f", {D5[-1]}]", "]"), "distortion_coefficients says 1 x 5 but holds 4 numbers"),
    "six coefficients": (opencv_yaml(D14[:6]), "6 distortion coefficients"),
    "three numbers as matrix": (json.dumps({**GEOMETRY, "K": [1, 2, 3]}), "has 3 numbers"),
    "columns of MATLAB": ({**LISTS, "camera_matrix": np.array(K).T.tolist()}, "it is transposed"),
    "not calibrated": (ros_yaml(ZEROS[:5], matrix=ZEROS), "not calibrated"),
    "not finite": (opencv_yaml([-0.1, float("nan"), 0.0, 0.0, 0.0]), "distortion_coefficients has a value that is not finite"),
    "text in place of a number": ({**LISTS, "dist_coeff": ["a"]}, "dist_coeff is no list of numbers"),
    "no size": (opencv_yaml(D5).replace("image_width: 1280\nimage_height: 720\n", ""), "size of the image"),
    "a height alone": (opencv_yaml(D5).replace("image_width: 1280\n", ""), "not a width and a height"),
    "two sizes": ({**LISTS, "image_width": 640, "image_height": 480}, "two sizes"),
    "a size of three numbers": ({**LISTS, "image_size": [1, 2, 3]}, "not a width and a height"),
    "height first": ({**LISTS, "image_size": [720, 1280]}, "height seems to stand before"),
    "focal lengths in mm": (ros_yaml(D5, matrix=[8.0, 0.0, 644.2, 0.0, 8.0, 357.9, 0.0, 0.0, 1.0]), "focal lengths of 8 and 8 px"),
    "fov of Kalibr": (kalibr([0.9], "fov"), "'fov'"),
    "omni of Kalibr": (kalibr(D5[:4]).replace("pinhole", "omni"), "camera_model is 'omni'"),
    "splines of mrcal": (mrcal(D5).replace("OPENCV5", "SPLINED_STEREOGRAPHIC"), "SPLINED"),
    "another type of camera-geometry.json": ({**GEOMETRY, "type": "kannala"}, "'kannala' is not read"),
    "COLMAP of another model": (colmap("THIN_PRISM_FISHEYE", ZEROS[:8]), "THIN_PRISM_FISHEYE"),
    "COLMAP with a value too few": (colmap("OPENCV", D5[:3]), "has 8 values; camera 1 has 7"),
    "two messages": (ros_echo(2) + ros_echo(2), "2 documents"),
    "a name twice": (opencv_yaml(D5) + "image_width: 3\n", "line 15"),
    "a name in two ways": (opencv_yaml(D5) + "image_Width: 3\n", "image_width"),
    "a name of JSON twice": ('{"type": "pinhole", "type": "pinhole"}', "'type'"),
    "a name of Python twice": (mrcal(D5).replace("'extrinsics'", "'imagersize'"), "twice"),
    "a camera of COLMAP twice": (colmap("OPENCV", D5[:4]) * 2, "twice"),
    "a camera of COLMAP that is not finite": (colmap("OPENCV", D5[:4]) + "2 PINHOLE 9 9 nan 1 1 1", "'2 PINHOLE 9 9 nan 1 1 1'"),
    "a name of XML twice": ("<opencv_storage><K>1</K><K>2</K></opencv_storage>", "twice"),
    "torn YAML": (opencv_yaml(D5)[:-4], "line 14"),
    "torn XML": (file_storage("xml", sample(D5))[:300], "no complete XML"),
    "torn JSON": (json.dumps(LISTS)[:60], "no complete JSON"),
    "torn mrcal": (mrcal(D5)[:200], "no complete dictionary"),
    "torn npz": (npz()[:-100], "np.savez"),
    "npz of too many numbers": (npz_that_claims((10**18,)), "mtx"),
    "large npz": (npz(mtx=np.zeros(3_000_000)), "too large"),
    "entities": ('<!DOCTYPE a [<!ENTITY e "1 1">]><opencv_storage><K>&e;</K></opencv_storage>', "entities"),
    "nested XML": ("<opencv_storage>" + "<a>" * 40_000 + "</a>" * 40_000 + "</opencv_storage>", "nested deeper"),
    "large XML": ("<opencv_storage>" + "<a>" * 400_000, "too large"),
    "nested YAML": ("%YAML:1.0\n---\na: " + "[" * 100_000, "no YAML"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "fact"), [*FOREIGN.values(), *SPOILT.values()], ids=[*FOREIGN, *SPOILT])
def test_what_is_not_read_is_refused_with_its_names_or_the_fact_that_is_wrong(content, fact):
    with pytest.raises(NotACamera) as error:
        read(json.dumps(content) if isinstance(content, dict) else content)
    assert fact in Failure.of(error.value).what
    assert error.value.where == "f"
    assert error.value.remedy
    assert "zero" not in error.value.remedy
    assert error.value.exit_status == 2


@given(st.binary(max_size=400))
def test_any_bytes_are_a_camera_or_refused(data):
    with contextlib.suppress(NotACamera):
        assert np.isfinite(read(data).camera.values).all()


WHOLE = [text.encode() for text, _ in BROWN.values() if len(text) < 10_000] + [npz()]


@given(st.sampled_from(WHOLE), st.data())
def test_a_file_with_a_part_missing_or_a_byte_changed_is_a_camera_or_refused(whole, drawn):
    begin, end = sorted(drawn.draw(st.tuples(*[st.integers(0, len(whole))] * 2)))
    byte = drawn.draw(st.binary(max_size=1))
    with contextlib.suppress(NotACamera):
        camera_file = read(whole[:begin] + byte + whole[end:], image_size=SIZE)
        assert np.isfinite(camera_file.camera.values).all()
