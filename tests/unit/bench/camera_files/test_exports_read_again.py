"""Cameras read from the files of other programs: the exports of one calibration give that calibration again."""

import numpy as np
import pytest
from solved_run import write_solved_run

from bench.camera_files.reader import read_camera_file
from bench.record.storage import read_json


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
    camera_file = read_camera_file(file)
    for key, value in stated["camera"].items():
        own = (
            getattr(camera_file.camera, key)
            if key in ("fx", "fy", "cx", "cy")
            else camera_file.camera.distortion[key]
        )
        assert own == pytest.approx(value, rel=1e-12)
    assert list(camera_file.camera.image_size) == stated["image_size"]
    assert (camera_file.covariance is not None) == (name == "opencv.yaml")


@pytest.mark.parametrize("place", ["", "results.json", "exports/opencv.yaml"])
def test_a_run_and_its_opencv_export_state_the_covariance(run, stated, place):
    camera_file = read_camera_file(run / place)
    sigmas = np.sqrt(np.diag(camera_file.covariance))
    expected = [stated["sigma"][name] for name in camera_file.camera.parameter_names]
    assert sigmas == pytest.approx(expected, rel=1e-9)
