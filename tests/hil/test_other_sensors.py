"""Sensors of other sizes than that of the IMX636: a whole run takes the size from the camera, not from a constant."""

import pytest
import quick_runs
from quick_runs import write_sequence
from running import called, results
from station_texts import PLAIN

from drivers.camera.raw_file import RawFile

POSES = "[{pan_deg: -3, tilt_deg: 2}, {pan_deg: 3, tilt_deg: 2}, {pan_deg: 0, tilt_deg: -3}]"


def write_station(path, width, height, fx):
    camera = f"{{width: {width}, height: {height}, fx: {fx}, fy: {fx}, cx: {width / 2}, cy: {height / 2}}}"
    simulation = quick_runs.SIMULATION % ""
    wanted = simulation.replace("{width: 640, height: 360, fx: 1672, fy: 1672, cx: 320, cy: 180}", camera)
    assert wanted != simulation
    path.write_text(PLAIN.replace("simulation: {}", wanted))  # it still expects an image of 1280 x 720


@pytest.mark.parametrize(
    ("width", "height", "fx"), [(320, 320, 1290), pytest.param(640, 480, 1672, marks=pytest.mark.slow)]
)
def test_a_run_takes_the_size_of_the_sensor_from_the_camera(tmp_path, width, height, fx):
    sequence, bench = write_sequence(tmp_path / "s.yaml", POSES), tmp_path / "b.yaml"
    write_station(bench, width, height, fx)
    called("run", sequence, "-s", bench, "--seed", 3, "-o", tmp_path / "run", home=tmp_path)
    run_results = results(tmp_path / "run")
    assert run_results["calibration"]["image_size"] == [width, height]
    camera = run_results["devices"]["camera"]
    assert (camera["width"], camera["height"]) == (width, height)
    recording = RawFile.open(next((tmp_path / "run" / "captures").glob("*.raw")))
    assert (recording.width, recording.height) == (width, height)
    (row,) = (row for row in run_results["comparison"] if row["name"] == "fx")
    assert abs(row["error_sigmas"]) < 3
