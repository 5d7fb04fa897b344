"""Camera files as other programs write them: the rays are OpenCV's, or the real cause is named with the way on."""

import contextlib
import json
import textwrap
from pathlib import Path

import cv2
import numpy as np
import pytest
from camera_oracle import D5, D14, FISHEYE, FLAT_K, FOCAL_AND_CENTRE, SIZE, K, off_px
from hypothesis import given
from hypothesis import strategies as st

from bench.plan.camera_files import NotACamera, parse_camera, read_camera_file


def opencv_yaml(
    coefficients, first="%YAML:1.0\n---\n", names=("camera_matrix", "distortion_coefficients"), more=""
):
    return (
        f"{first}image_width: 1280\nimage_height: 720\n{more}"
        f"{names[0]}: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: {FLAT_K}\n"
        f"{names[1]}: !!opencv-matrix\n   rows: 1\n   cols: {len(coefficients)}\n   dt: d\n   data: {coefficients}\n"
    )


def opencv_file(kind, coefficients, **more):
    storage = cv2.FileStorage(f".{kind}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in {"image_width": 1280, "image_height": 720, **more}.items():
        storage.write(name, value)
    storage.write("camera_matrix", np.array(K))
    storage.write("distortion_coefficients", np.array(coefficients)[:, None])
    return storage.releaseAndGetString()


def ros_yaml(coefficients, model="plumb_bob", matrix=FLAT_K):
    stated = f"distortion_model: {model}\n" if model else ""
    return (
        f"image_width: 1280\nimage_height: 720\ncamera_name: narrow_stereo\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {matrix}\n{stated}"
        f"distortion_coefficients:\n  rows: 1\n  cols: {len(coefficients)}\n  data: {coefficients}\n"
        f"projection_matrix:\n  rows: 3\n  cols: 4\n  data: {[0.0] * 12}\n"
    )


def ros_echo(generation, model="plumb_bob", coefficients=D5, more=""):
    d, k = ("D", "K") if generation == 1 else ("d", "k")
    times = "    secs: {0}\n    nsecs: 5" if generation == 1 else "    sec: {0}\n    nanosec: 5"
    message = (
        "header:\n  stamp:\n" + times + "\n  frame_id: cam\n"
        f"height: 720\nwidth: 1280\ndistortion_model: {model}\n"
    )
    if generation == 1:
        lists = f"{d}: {coefficients}\n{k}: {FLAT_K}\n"
    else:
        lists = "".join(
            f"{name}:\n" + "".join(f"- {v}\n" for v in values)
            for name, values in ((d, coefficients), (k, FLAT_K))
        )
    return "".join(message.format(second) + lists + more + "---\n" for second in (10, 11))


OST = textwrap.dedent("""\
    # oST version 5.0 parameters


    [image]

    width
    1280

    height
    720

    [narrow_stereo]

    camera matrix
    1050.3 0.000000 644.2
    0.000000 1049.1 357.9
    0.000000 0.000000 1.000000

    distortion
    -0.120000 0.080000 0.000500 -0.000700 -0.020000

    rectification
    1.0 0.0 0.0
    0.0 1.0 0.0
    0.0 0.0 1.0

    projection
    1050.3 0 644.2 0
    0 1049.1 357.9 0
    0 0 1 0
    """)

MRCAL = (
    "# generated on 2026-01-01\n{{\n    'lensmodel':  '{model}',\n\n    # intrinsics are fx,fy,cx,cy,distortion0,...\n"
    "    'intrinsics': [ {numbers},],\n    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n    'imagersize': [ 1280, 720,],\n"
    "    'icam_intrinsics': 0,\n    'optimization_inputs': b'P${{[}},abc'\n                           b'x',\n}}\n"
)


def mrcal(coefficients):
    numbers = ", ".join(map(str, FOCAL_AND_CENTRE + coefficients))
    return MRCAL.format(model=f"LENSMODEL_OPENCV{len(coefficients)}", numbers=numbers)


def colmap(model, coefficients, numbers=("1050.3", "1049.1")):
    words = [*numbers, "644.7", "358.4", *map(str, coefficients)]  # pixel centres lie at half integers
    return f"# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 {model} 1280 720 {' '.join(words)}\n"


JSON_LISTS = {"camera_matrix": K, "dist_coeff": [D5], "image_size": [1280, 720]}
SDK4 = {
    "camera_matrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": FLAT_K},
    "distortion_coefficients": {"type_id": "opencv-matrix", "rows": 1, "cols": 5, "dt": "d", "data": D5},
    "image_size": [1280, 720],
    "n_kept_views": 8,
}
EUROC = (
    f"sensor_type: camera\nresolution: [1280, 720]\ncamera_model: pinhole\nintrinsics: {FOCAL_AND_CENTRE} #fu, fv\n"
    f"distortion_model: radial-tangential\ndistortion_coefficients: {D5[:4]}\n"
)
MC_CALIB = (
    "%YAML:1.0\n---\nnb_camera: 1\ncamera_0:\n   camera_matrix: !!opencv-matrix\n      rows: 3\n      cols: 3\n"
    f"      dt: d\n      data: {FLAT_K}\n   distortion_vector: !!opencv-matrix\n      rows: 1\n      cols: 5\n      dt: d\n"
    f"      data: {D5}\n   distortion_type: 0\n   img_width: 1280\n   img_height: 720\n"
)
ZEROS = [0.0] * 9

BROWN_FILES = {
    "8 coefficients": (opencv_yaml(D14[:8]), D14[:8]),
    "12 coefficients: thin prism": (opencv_yaml(D14[:12]), D14[:12]),
    "14 coefficients: tilted sensor": (opencv_yaml(D14), D14),
    "14 coefficients, the last 6 zero": (opencv_yaml([*D14[:8], *ZEROS[:6]]), D14[:8]),
    "XML": (opencv_file("xml", D5, flags=2, camera_name="cam7"), D5),
    "XML with 14": (opencv_file("xml", D14), D14),
    "JSON of FileStorage": (opencv_file("json", D5), D5),
    "YAML of FileStorage": (opencv_file("yml", D14[:12]), D14[:12]),
    "YAML 1.2 directive": (opencv_yaml(D5, "%YAML 1.2\n---\n"), D5),
    "without directive": (opencv_yaml(D5, ""), D5),
    "OpenCV 2.4, without ---": (opencv_yaml(D5, "%YAML:1.0\n"), D5),
    "byte-order mark": ("\ufeff" + opencv_yaml(D5), D5),
    "Windows line ends": (opencv_yaml(D5).replace("\n", "\r\n"), D5),
    "names of OpenCV 2.4": (
        opencv_yaml(D5, names=("Camera_Matrix", "Distortion_Coefficients")).replace("image_w", "image_W"),
        D5,
    ),
    "dist_coeffs": (opencv_yaml(D5, names=("camera_matrix", "dist_coeffs")), D5),
    "K and D": (opencv_yaml(D5, names=("K", "D")), D5),
    "cameraMatrix and distCoeffs": (opencv_yaml(D5, names=("cameraMatrix", "distCoeffs")), D5),
    "mtx and dist": (json.dumps({"mtx": K, "dist": [D5], "width": 1280, "height": 720}), D5),
    "four, not a fisheye": (opencv_yaml(D5[:4], more="fisheye_model: 0\n"), D5[:4]),
    "JSON of lists": (json.dumps(JSON_LISTS), D5),
    "JSON of lists, blank lines behind": (json.dumps(JSON_LISTS) + "\n\n", D5),
    "Metavision SDK 4 with a byte-order mark": ("\ufeff" + json.dumps(SDK4), D5),
    "ROS": (ros_yaml(D5), D5),
    "ROS plumb_bob with 8, zeros": (ros_yaml([*D5, *ZEROS[:3]]), D5),
    "ROS plumb_bob with 4": (ros_yaml(D5[:4]), D5[:4]),
    "ROS plumb_bob with 0": (ros_yaml([]), []),
    "ROS rational with 5": (ros_yaml(D5, "rational_polynomial"), D5),
    "ROS rational with 8": (ros_yaml(D14[:8], "rational_polynomial"), D14[:8]),
    "ROS rational with 14, zeros": (ros_yaml([*D14[:8], *ZEROS[:6]], "rational_polynomial"), D14[:8]),
    "ROS without distortion_model": (ros_yaml(D5, None), D5),
    "ROS with an empty distortion_model": (ros_yaml(D5, "''"), D5),
    "ROS 1 topic echo": (ros_echo(1), D5),
    "ROS 2 topic echo": (ros_echo(2), D5),
    "ROS 2 topic echo of rational": (ros_echo(2, "rational_polynomial", D14[:8]), D14[:8]),
    "ost.txt": (OST, D5),
    "EuRoC": (EUROC, D5[:4]),
    "MC-Calib": (MC_CALIB, D5),
    "mrcal with 5": (mrcal(D5), D5),
    "mrcal with 4": (mrcal(D5[:4]), D5[:4]),
    "mrcal with 12": (mrcal(D14[:12]), D14[:12]),
    "COLMAP OPENCV": (colmap("OPENCV", D5[:4]), D5[:4]),
    "COLMAP FULL_OPENCV": (colmap("FULL_OPENCV", D14[:8]), D14[:8]),
    "COLMAP PINHOLE": (colmap("PINHOLE", []), []),
    "numbers as a tuple of Python": (
        f"K: {K}\nD: {D5}\nimage_size: !!python/tuple\n- 1280\n- 720\n", D5,
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "coefficients"), BROWN_FILES.values(), ids=BROWN_FILES)
def test_the_rays_of_a_camera_file_are_those_of_opencv(tmp_path, text, coefficients):
    (tmp_path / "file").write_bytes(text.encode())
    camera = read_camera_file(tmp_path / "file").camera
    assert camera.image_size == SIZE
    assert off_px(camera, coefficients) < 1e-6


FISHEYE_FILES = {
    "Kalibr": (
        f"cam0:\n  camera_model: pinhole\n  intrinsics: {FOCAL_AND_CENTRE}\n  distortion_model: equidistant\n"
        f"  distortion_coeffs: {FISHEYE}\n  resolution: [1280, 720]\n  rostopic: /cam0/events\n"
    ),
    "flag": opencv_yaml(FISHEYE, more="fisheye_model: 1\n"),
    "flag in XML": opencv_file("xml", FISHEYE, fisheye_model=1),
    "another name of the model": opencv_yaml(FISHEYE, more="calibration_model: fisheye\n"),
    "ROS equidistant": ros_yaml(FISHEYE, "equidistant"),
    "ROS echo": ros_echo(2, "equidistant", FISHEYE),
    "COLMAP": colmap("OPENCV_FISHEYE", FISHEYE),
    "Kannala-Brandt": json.dumps({"K": K, "D": FISHEYE, "resolution": SIZE, "camera_model": "KannalaBrandt8"}),
    "MC-Calib": MC_CALIB.replace("distortion_type: 0", "distortion_type: 1").replace(str(D5), str(FISHEYE)).replace("cols: 5", "cols: 4"),
}  # fmt: skip


@pytest.mark.parametrize("text", FISHEYE_FILES.values(), ids=FISHEYE_FILES)
def test_the_rays_of_a_fisheye_file_are_those_of_opencv(tmp_path, text):
    (tmp_path / "file").write_text(text)
    assert off_px(read_camera_file(tmp_path / "file").camera, FISHEYE, fisheye=True) < 1e-6


def test_a_fisheye_of_colmap_without_coefficients_is_equidistant(tmp_path):
    (tmp_path / "file").write_text(colmap("FISHEYE", []))
    assert off_px(read_camera_file(tmp_path / "file").camera, [0.0] * 4, fisheye=True) < 1e-6


@pytest.mark.parametrize("codec", ["utf-8-sig", "utf-16"])
def test_a_message_that_powershell_redirected_is_read(tmp_path, codec):
    (tmp_path / "ci.yaml").write_bytes(ros_echo(2).encode(codec))
    assert off_px(read_camera_file(tmp_path / "ci.yaml").camera, D5) < 1e-6


def test_the_skew_of_a_fisheye_calibration_is_used_and_said(tmp_path):
    matrix = [FLAT_K[0], -0.96635, *FLAT_K[2:]]
    (tmp_path / "ost.yaml").write_text(ros_yaml(FISHEYE, "equidistant", matrix))
    camera_file = read_camera_file(tmp_path / "ost.yaml")
    assert off_px(camera_file.camera, FISHEYE, fisheye=True, skew_px=-0.96635) < 1e-6
    assert "-0.96635" in camera_file.remarks[0]


def test_four_coefficients_without_a_lens_model_are_not_guessed(tmp_path):
    file = tmp_path / "cal.yml"
    file.write_text(opencv_yaml(FISHEYE))
    with pytest.raises(NotACamera) as error:
        read_camera_file(file)
    assert "no lens model" in error.value.what
    assert " px apart" in error.value.what
    assert "--lens" in error.value.remedy
    assert off_px(read_camera_file(file, lens="fisheye").camera, FISHEYE, fisheye=True) < 1e-6
    assert off_px(read_camera_file(file, lens="brown").camera, FISHEYE) < 1e-6


def test_an_option_does_not_override_what_a_file_states(tmp_path):
    (tmp_path / "ci.yaml").write_text(ros_yaml(D5))
    with pytest.raises(NotACamera, match="plumb_bob"):
        read_camera_file(tmp_path / "ci.yaml", lens="fisheye")


CHAIN = {
    "Kalibr": "".join(
        f"cam{at}:\n  camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: {D5[:4]}\n"
        f"  intrinsics: [{1050.3 + at}, 1049.1, 644.2, 357.9]\n  resolution: [1280, 720]\n"
        "  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, 0.0]\n  - [0.0, 1.0, 0.0, 0.0]\n"
        for at in (0, 1)
    ),
    "DSEC": "extrinsics:\n  T_10:\n  - [1.0, 0.0]\nintrinsics:\n"
    + "".join(
        f"  cam{at}:\n    camera_matrix: [{1050.3 + at}, 1049.1, 644.2, 357.9]\n    camera_model: pinhole\n"
        f"    distortion_coeffs: {D5[:4]}\n    distortion_model: radtan\n    resolution: [1280, 720]\n"
        for at in (0, 1)
    )
    + "disparity_to_depth:\n  cams_03:\n  - [1.0, 0.0]\n",
    "ost.txt": "[image]\nwidth\n1280\nheight\n720\n"
    + "".join(
        f"[cam{at}]\ncamera matrix\n{1050.3 + at} 0 644.2\n0 1049.1 357.9\n0 0 1\ndistortion\n{' '.join(map(str, [*D5[:4], 0.0]))}\n"
        for at in (0, 1)
    ),
}


@pytest.mark.parametrize("text", CHAIN.values(), ids=CHAIN)
def test_one_camera_of_several_is_named(tmp_path, text):
    file = tmp_path / "chain"
    file.write_text(text)
    matrix = np.array(K)
    matrix[0, 0] += 1
    assert off_px(read_camera_file(file, "cam1").camera, D5[:4], matrix=matrix) < 1e-6
    with pytest.raises(NotACamera) as error:
        read_camera_file(file)
    assert "2 cameras: cam0, cam1" in error.value.what
    assert "--camera" in error.value.remedy
    with pytest.raises(NotACamera, match="no camera 'cam7'"):
        read_camera_file(file, "cam7")


def test_the_cameras_of_opencvs_stereo_file_are_named_by_number(tmp_path):
    matrices = json.dumps(
        {"M1": K, "D1": D5, "M2": [[900.0, 0, 640], [0, 900.0, 360], [0, 0, 1]], "D2": D5, "image_size": SIZE}
    )
    (tmp_path / "intrinsics.json").write_text(matrices)
    assert off_px(read_camera_file(tmp_path / "intrinsics.json", "1").camera, D5) < 1e-6
    assert read_camera_file(tmp_path / "intrinsics.json", "2").camera.fx == 900.0


#: Metavision's camera-geometry.json
GEOMETRY = {"type": "pinhole", "width": 1280, "height": 720, "K": FLAT_K, "D": D5}
REFUSED = {
    "plumb_bob with 8": (ros_yaml(D14[:8]), "plumb_bob has 5 coefficients, but the file states 8: coefficient 6 is 0.01, not 0"),
    "radtan with 5": (CHAIN["Kalibr"].replace(str(D5[:4]), str(D5)).partition("cam1")[0], "radtan has 4 coefficients"),
    "six coefficients": (opencv_yaml(D14[:6]), "6 distortion coefficients are no camera's"),
    "fisheye with 3": (ros_yaml(FISHEYE[:3], "equidistant"), "3 distortion coefficients are no camera's"),
    "fisheye with 5": (ros_yaml([*FISHEYE, 0.01], "equidistant"), "equidistant has 4 coefficients"),
    "no size": (opencv_yaml(D5).replace("image_", "other_"), "does not state the size of the image"),
    "not calibrated": (ros_yaml(ZEROS[:5], matrix=ZEROS), "not calibrated"),
    "columns of MATLAB": (json.dumps({**JSON_LISTS, "camera_matrix": np.array(K).T.tolist()}), "row after row"),
    "inverse model of RealSense": (ros_yaml(D5, "inverse_brown_conrady"), "'inverse_brown_conrady'"),
    "omnidirectional": (json.dumps({**JSON_LISTS, "xi": 0.8}), "omnidirectional"),
    "camodocal's omnidirectional": (
        "%YAML:1.0\n---\nmodel_type: MEI\nmirror_parameters:\n   xi: 1.5\n", "omnidirectional",
    ),
    "Basalt": (json.dumps({"value0": {"intrinsics": [], "resolution": []}}), "Basalt"),
    "numpy in YAML": ("K: !!python/object/apply:numpy.core.multiarray._reconstruct\n  args: [1]\n", "numpy"),
    "XML of a whole project of Metashape": ("<?xml version='1.0'?><document version='1.5.0'/>", "XML of another program"),
    "torn XML": (opencv_file("xml", D5)[:300], "no complete XML"),
    "torn JSON": (json.dumps(JSON_LISTS)[:60], "no complete JSON"),
    "torn YAML": (opencv_yaml(D5)[:-4], "line 14: this is no YAML"),
    "torn YAML, second document": (ros_echo(2) + "K: [1, 2\n", "line 51: this is no YAML"),
    "a name twice": (opencv_yaml(D5) + "image_width: 3\n", "line 15: duplicate key"),
    "torn mrcal": (mrcal(D5)[:200], "no complete dictionary"),
    "not finite": (opencv_yaml([-0.1, float("nan"), 0.0, 0.0, 0.0]), "the distortion"),
    "text in place of a number": (json.dumps({**JSON_LISTS, "dist_coeff": ["a"]}), "the distortion is no list of numbers"),
    "no focal length beside four coefficients": (
        json.dumps({**JSON_LISTS, "camera_matrix": [[0.0, *K[0][1:]], *K[1:]], "dist_coeff": D5[:4]}),
        "focal lengths of 0 and 1049.1 px",
    ),
    "no distortion": (json.dumps({"K": K, "image_size": SIZE}), "no distortion coefficients"),
    "two cameras one after the other": (ros_echo(2) + ros_echo(2).replace("1050.3", "900.0"), "different cameras"),
    "models that contradict": (opencv_yaml(FISHEYE, more="fisheye_model: 0\ncamera_model: fisheye\n"), "contradict"),
    "COLMAP of another model": (colmap("THIN_PRISM_FISHEYE", ZEROS[:8]), "THIN_PRISM_FISHEYE"),
    "COLMAP with a value too few": (colmap("OPENCV", D5[:3]), "has 8 values; camera 1 has 7"),
    "entities that grow": (
        '<!DOCTYPE a [<!ENTITY e0 "' + "K" * 1000 + '">'
        + "".join(f'<!ENTITY e{at + 1} "{f"&e{at};" * 50}">' for at in range(6))
        + "]><opencv_storage>&e6;</opencv_storage>",
        "no complete XML",
    ),
    "nested XML": ("<opencv_storage>" + "<a>" * 40_000 + "</a>" * 40_000 + "</opencv_storage>", "nested deeper"),
    "large XML": ("<opencv_storage>" + "<a>" * 200_000, "too large"),
    "nested YAML": ("%YAML:1.0\n---\na: " + "[" * 100_000, "no YAML"),
    "nested Python": ("# x\n{'lensmodel': " + "[" * 100_000, "no complete dictionary"),
    "coefficients, but no matrix": (
        "f: 900\ncx: 640\ncy: 360\nk1: -0.1\nk2: 0.02\nwidth: 1280\nheight: 720\n", "it has no camera matrix",
    ),
    "a list": ("- 1\n- 2\n", "names with values"),
    "only a comment": ("# nothing\n", "names with values"),
    "omni of Kalibr": (CHAIN["Kalibr"].partition("cam1")[0].replace("pinhole", "omni"), "'omni'"),
    "another type of camera-geometry.json": (json.dumps({**GEOMETRY, "type": "kannala"}), "only `pinhole` is known"),
    "three numbers as matrix": (json.dumps({**GEOMETRY, "K": [1, 2, 3]}), "the camera matrix has 3 numbers"),
    "no width": (json.dumps({**GEOMETRY, "width": 0}), "not possible"),
    "a name of JSON twice": ('{"type": "pinhole", "type": "pinhole"}', "the key 'type' is there twice"),
    "empty JSON": ("{}", "it has no camera matrix"),
    "empty": ("", "it is empty"),
    "a width alone": ("%YAML:1.0\n---\nimage_width: 3\n", "no camera matrix"),
    "a model that nobody knows": ("K: [1, 1, 1, 1]\nD: []\ndistortion_model: magic\n", "'magic'"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "why"), REFUSED.values(), ids=REFUSED)
def test_what_is_not_read_is_refused_with_its_real_cause(tmp_path, text, why):
    (tmp_path / "file").write_text(text)
    with pytest.raises(NotACamera) as error:
        read_camera_file(tmp_path / "file")
    assert why in error.value.what
    assert error.value.where == str(tmp_path / "file")
    assert error.value.remedy
    assert error.value.exit_status == 2


@pytest.mark.parametrize(
    ("data", "why", "way"),
    [
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + bytes(90), "MATLAB", "jsonencode"),
        (b"\x93NUMPY\x01\x00v\x00", "numpy", "FileStorage"),
        (b"PK\x03\x04\x14\x00", "numpy's .npz", "FileStorage"),
        (b"\x80\x04\x95\x00", "pickle", "FileStorage"),
        (b"\x1f\x8b\x08\x00", "compressed", "Unpack"),
        (b"SQLite format 3\x00", "COLMAP's", "cameras.txt"),
        (b"% evt 3.0\n% end\n\x00\x80", "recording", ""),
        (b"\x89PNG\r\n\x1a\n", "picture", "FileStorage"),
        (b"\x89HDF\r\n", "HDF5", "FileStorage"),
        (b"#ROSBAG V2.0\n", "ROS bag", "rostopic echo"),
        (b"\x00\x01\x02\x03", "binary", "FileStorage"),
        (b" " * 20_000_001, "at most 20000000 bytes", ""),
        ("Brennweite für 3".encode("latin-1"), "UTF-8", "as UTF-8"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_text_is_named_as_what_it_is_with_the_way_to_its_camera(tmp_path, data, why, way):
    (tmp_path / "file").write_bytes(data)
    with pytest.raises(NotACamera, match=why) as error:
        read_camera_file(tmp_path / "file")
    assert way in error.value.remedy


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ("binning_x: 2\nbinning_y: 2\n", "binned by 2 x 2"),
        (
            "roi:\n  x_offset: 10\n  y_offset: 0\n  height: 600\n  width: 800\n  do_rectify: false\n",
            "region of interest",
        ),
    ],
)
def test_a_camera_of_binned_or_cropped_images_is_that_of_the_whole_image_and_says_so(tmp_path, more, why):
    (tmp_path / "ci.yaml").write_text(ros_echo(1, more=more))
    camera_file = read_camera_file(tmp_path / "ci.yaml")
    assert off_px(camera_file.camera, D5) < 1e-6
    assert why in camera_file.remarks[0]


@given(st.binary(max_size=400))
def test_any_bytes_are_a_camera_or_refused(data):
    with contextlib.suppress(NotACamera):
        parse_camera(data, Path("file"))


@given(st.sampled_from([text for text, *_ in BROWN_FILES.values()]), st.data())
def test_a_file_with_a_part_missing_is_a_camera_or_refused(text, drawn):
    begin, end = sorted(drawn.draw(st.tuples(*[st.integers(0, len(text))] * 2)))
    with contextlib.suppress(NotACamera):
        camera_file = parse_camera((text[:begin] + text[end:]).encode(), Path("file"))
        assert np.isfinite(camera_file.camera.values).all()


def test_the_whole_image_as_region_of_interest_is_not_remarkable(tmp_path):
    more = "binning_x: 0\nbinning_y: 1\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 720\n  width: 1280\n"
    (tmp_path / "ci.yaml").write_text(ros_echo(1, more=more))
    assert read_camera_file(tmp_path / "ci.yaml").remarks == ()


def test_a_principal_point_far_from_the_middle_is_remarked(tmp_path):
    (tmp_path / "ci.yaml").write_text(
        ros_yaml(D5, matrix=[262.6, 0.0, 161.0, 0.0, 262.3, 89.5, 0.0, 0.0, 1.0])
    )
    (remark,) = read_camera_file(tmp_path / "ci.yaml").remarks
    assert "13 % of the width" in remark


@pytest.mark.parametrize(
    "size",
    [
        {"img_size": SIZE},
        {"size": SIZE},  # aniposelib
        {"dimensions": SIZE},
        {"res_x": SIZE[0], "res_y": SIZE[1]},  # EV-IMO
        {"image_size": SIZE, "size": [9, 6]},  # of a board
        {"ImageSize": {"Width": SIZE[0], "Height": SIZE[1]}},
        {"image_size": "(1280, 720)"},  # Python's print
    ],
)
def test_the_size_of_the_image_has_the_names_of_programs(size):
    camera = parse_camera(json.dumps({"K": K, "dist": D5, **size}).encode(), Path("a.json")).camera
    assert camera.image_size == SIZE
    assert off_px(camera, D5) < 1e-3
