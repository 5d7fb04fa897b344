"""Recordings played as a camera: a whole run from RAW files, to the same numbers as the run that made them."""

import pytest
from running import results, starbench

CAMERA = "driver: simulated_evk4\n  address: sim:camera"


@pytest.mark.slow
def test_a_run_from_recordings_ends_with_the_numbers_of_the_run_that_made_them(three_pose, tmp_path):
    home, first, again = tmp_path / "home", three_pose / "run", tmp_path / "again"
    text = (first / "station.yaml").read_text()
    assert CAMERA in text
    station = tmp_path / "played.yaml"
    station.write_text(text.replace(CAMERA, f"driver: recorded\n  path: {first / 'captures'}"))
    starbench("run", "three_pose", "-s", station, "-o", again, home=home)
    assert results(again)["calibration"]["camera"] == results(first)["calibration"]["camera"]
    assert results(again)["run"]["simulated"]
    assert results(again)["devices"]["camera"]["model"] == "recorded"
    for capture in (first / "captures").iterdir():
        assert (again / "captures" / capture.name).read_bytes() == capture.read_bytes()
    starbench("verify", again, "--again", home=home)
