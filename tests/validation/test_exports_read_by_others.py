"""Exports read by the programs they are for, with their own readers and projections.

Each program is asked in whatever Python has it: the one of the tests, the system's, or the one that
STARBENCH_CROSSCHECK_PYTHON names (``pip install pycolmap``; Debian: python3-mrcal, python3-camera-calibration-parsers).
"""

import functools
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from exported_camera import calibration

from bench.solve.exports import exports

RAYS = [[0.0, 0.0, 1.0], [0.15, -0.1, 1.0], [-0.2, 0.08, 1.1], [0.05, 0.11, 0.9], [0.19, 0.1, 1.0]]
MRCAL = """
import json, sys, mrcal, numpy as np
model = mrcal.cameramodel(sys.argv[1])
print(json.dumps({"image": mrcal.project(np.array(json.loads(sys.argv[2])), *model.intrinsics()).tolist(),
                  "size": model.imagersize().tolist()}))
"""
COLMAP = """
import json, sys, numpy as np, pycolmap
model = pycolmap.Reconstruction()
model.read_text(sys.argv[1])
(camera,) = model.cameras.values()
print(json.dumps({"image": camera.img_from_cam(np.array(json.loads(sys.argv[2]))).tolist(),
                  "size": [camera.width, camera.height]}))
"""
ROS = """
import json, sys
from camera_calibration_parsers import readCalibration
name, info = readCalibration(sys.argv[1])
print(json.dumps({"name": name, "size": [info.width, info.height], "model": info.distortion_model,
                  "K": list(info.K), "D": list(info.D), "P": list(info.P)}))
"""


@functools.cache
def python_with(module):
    for python in (
        sys.executable,
        shutil.which("python3", path="/usr/bin"),
        os.environ.get("STARBENCH_CROSSCHECK_PYTHON"),
    ):
        if (
            python
            and subprocess.run(
                [python, "-c", f"import {module}"], capture_output=True, check=False
            ).returncode
            == 0
        ):
            return python
    return None


def ask(module, program, *arguments):
    """What another program answers, as JSON; skips where it is not installed."""
    python = python_with(module)
    if python is None:
        pytest.skip(f"{module} is not installed")
    words = [python, "-c", program, *map(str, arguments)]
    answer = subprocess.run(words, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    return json.loads(answer.stdout.splitlines()[-1])


@pytest.fixture(params=["k1k2", "k1k2k3p1p2", "rational", "fisheye"])
def exported(request, tmp_path):
    """A calibration, and the folder of its exports."""
    made = calibration(request.param)
    for name, data in exports(made, camera_name="evk4_00050423").items():
        (tmp_path / name).write_bytes(data)
    return made, tmp_path


def test_mrcal_projects_to_the_same_pixels(exported):
    made, folder = exported
    if made.camera.is_fisheye:
        assert not (folder / "mrcal.cameramodel").exists()
        return
    answer = ask("mrcal", MRCAL, folder / "mrcal.cameramodel", json.dumps(RAYS))
    assert answer["size"] == [1280, 720]
    np.testing.assert_allclose(answer["image"], made.camera.project(np.array(RAYS)), atol=1e-9)


def test_colmap_projects_to_the_same_pixels_half_a_pixel_further(exported):
    made, folder = exported
    (folder / "colmap_cameras.txt").rename(folder / "cameras.txt")
    for name in ("images.txt", "points3D.txt", "rigs.txt", "frames.txt"):
        (folder / name).write_text("")
    answer = ask("pycolmap", COLMAP, folder, json.dumps(RAYS))
    assert answer["size"] == [1280, 720]
    expected = made.camera.project(np.array(RAYS))
    np.testing.assert_allclose(np.array(answer["image"]) - 0.5, expected, atol=1e-9)


def test_ros_reads_the_same_numbers(exported):
    made, folder = exported
    answer = ask("camera_calibration_parsers", ROS, folder / "ros_camera_info.yaml")
    camera = made.camera
    coefficients = camera.fisheye_coefficients if camera.is_fisheye else camera.coefficients
    count = 4 if camera.is_fisheye else 8 if "k4" in camera.distortion else 5
    assert answer["name"] == "evk4_00050423"
    assert answer["size"] == [1280, 720]
    assert answer["model"] == {4: "equidistant", 5: "plumb_bob", 8: "rational_polynomial"}[count]
    np.testing.assert_array_equal(np.reshape(answer["K"], (3, 3)), made.camera.matrix)
    np.testing.assert_array_equal(np.reshape(answer["P"], (3, 4))[:, :3], made.camera.matrix)
    np.testing.assert_array_equal(answer["D"], coefficients[:count])
