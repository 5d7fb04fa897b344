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


@pytest.mark.parametrize("place", ["", "results.json", "exports/opencv.yaml"])
def test_a_run_and_its_opencv_export_state_the_covariance(run, stated, place):
    camera_file = read_camera_file(run / place)
    sigmas = np.sqrt(np.diag(camera_file.covariance))
    expected = [stated["sigma"][name] for name in camera_file.camera.parameter_names]
    assert sigmas == pytest.approx(expected, rel=1e-9)
