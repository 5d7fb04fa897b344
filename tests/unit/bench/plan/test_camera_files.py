"""Cameras read from the files of other programs: the exports of one calibration give that calibration again."""

import json

import numpy as np
import pytest
import yaml
from solved_run import write_solved_run

from bench.plan.camera_files import NotACamera, read_camera_file
from bench.record.storage import read_json

GEOMETRY = {
    "type": "pinhole",
    "width": 1280,
    "height": 720,
    "K": [3345.0, 0.0, 643.0, 0.0, 3346.0, 364.0, 0.0, 0.0, 1.0],
    "D": [0.06, -0.9, 3e-4, -2e-4, 0.1],
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write_solved_run(tmp_path_factory.mktemp("solved"))


@pytest.fixture
def stated(run):
    return read_json(run / "results.json")["calibration"]


EXPORTS = [
    "opencv.yaml", "ros_camera_info.yaml", "kalibr_camchain.yaml", "metavision.json", "camera-geometry.json",
    "mrcal.cameramodel", "colmap_cameras.txt",
]  # fmt: skip


@pytest.mark.parametrize("name", EXPORTS)
def test_an_export_holds_the_camera_of_the_run(run, stated, name):
    file = run / "exports" / name
    assert file.is_file() or name == "kalibr_camchain.yaml", "the run has this export"
    if not file.is_file():
        pytest.skip("Kalibr's lens has no k3")
    found = read_camera_file(file)
    for key, value in stated["camera"].items():
        own = getattr(found.camera, key) if key in ("fx", "fy", "cx", "cy") else found.camera.distortion[key]
        assert own == pytest.approx(value, rel=1e-12)
    assert list(found.camera.image_size) == stated["image_size"]
    assert (found.covariance is not None) == (name == "opencv.yaml")


@pytest.mark.parametrize("place", ["", "results.json", "exports/opencv.yaml"])
def test_a_run_and_its_opencv_export_state_the_covariance(run, stated, place):
    found = read_camera_file(run / place)
    sigmas = np.sqrt(np.diag(found.covariance))
    expected = [stated["sigma"][name] for name in found.camera.parameter_names]
    assert sigmas == pytest.approx(expected, rel=1e-9)


KALIBR = {
    "camera_model": "pinhole",
    "intrinsics": [400.0, 401.0, 320.0, 240.0],
    "distortion_model": "equidistant",
    "distortion_coeffs": [0.1, 0.2, 0.3, 0.4],
    "resolution": [640, 480],
    "rostopic": "/cam0/events",
}


def test_an_equidistant_camera_of_kalibr_is_a_fisheye(tmp_path):
    (tmp_path / "camchain.yaml").write_text(yaml.safe_dump({"cam0": KALIBR}))
    camera = read_camera_file(tmp_path / "camchain.yaml").camera
    assert camera.is_fisheye
    assert camera.fisheye_coefficients.tolist() == [0.1, 0.2, 0.3, 0.4]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (yaml.safe_dump({"cam0": KALIBR}) + yaml.safe_dump({"cam1": KALIBR}), "holds 2 cameras: cam0, cam1"),
        (yaml.safe_dump({"cam0": {**KALIBR, "camera_model": "omni"}}), "'omni'"),
        (json.dumps({**GEOMETRY, "type": "kannala"}), "only `pinhole` is known"),
        (json.dumps({**GEOMETRY, "K": [1, 2, 3]}), "the camera matrix has 3 numbers"),
        (json.dumps({**GEOMETRY, "width": 0}), "not possible"),
        ('{"type": "pinhole", "type": "pinhole"}', ""),
        ("{}", ""),
        ("a: [1, 2", ""),
        ("", ""),
        ("%YAML:1.0\n---\nimage_width: 3\n", "no camera matrix"),
        (yaml.safe_dump({"K": [1, 1, 1, 1], "D": [], "distortion_model": "magic"}), "'magic'"),
    ],
)
def test_what_is_no_camera_is_refused_with_the_reason(tmp_path, text, why):
    (tmp_path / "file").write_text(text)
    with pytest.raises(NotACamera) as error:
        read_camera_file(tmp_path / "file")
    assert why in error.value.what
    assert error.value.where == str(tmp_path / "file")
    assert error.value.remedy
