"""Recordings played as a camera: a whole run from RAW files, to the same numbers as the run that made them."""

import json

import pytest
from running import results, starbench

pytestmark = pytest.mark.slow

CAMERA = "driver: simulated_evk4\n  address: sim:camera"


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return tmp_path_factory.mktemp("home")


@pytest.fixture(scope="module")
def first(tmp_path_factory, home):
    folder = tmp_path_factory.mktemp("runs") / "first"
    said = starbench("run", "three_pose", "-s", "simulated", "--seed", 7, "-o", folder, home=home)
    assert said.returncode == 0, said.stderr
    return folder


def played(first, tmp_path, path, serial="00050423"):
    """A station like the first run's, its camera those recordings."""
    text = (first / "station.yaml").read_text()
    assert CAMERA in text
    station = tmp_path / "played.yaml"
    station.write_text(
        text.replace(CAMERA, f"driver: recorded\n  path: {path}").replace(
            "serial: 00050423", f"serial: {serial}"
        )
    )
    return station


def camera_of(folder):
    return results(folder)["calibration"]["camera"]


def test_a_run_from_recordings_ends_with_the_numbers_of_the_run_that_made_them(first, tmp_path, home):
    station = played(first, tmp_path, first / "captures")
    again = tmp_path / "again"
    said = starbench("run", "three_pose", "-s", station, "-o", again, home=home)
    assert said.returncode == 0, said.stderr
    assert camera_of(again) == camera_of(first)
    assert results(again)["run"]["simulated"]
    assert results(again)["devices"]["camera"]["model"] == "recorded"
    names = sorted(path.name for path in (first / "captures").iterdir())
    assert [(again / "captures" / name).read_bytes() for name in names] == [
        (first / "captures" / name).read_bytes() for name in names
    ]
    assert starbench("verify", again, "--again", home=home).returncode == 0


def test_recordings_of_another_camera_are_refused_before_anything_moves(first, tmp_path, home):
    station = played(first, tmp_path, first / "captures", serial="00099999")
    folder = tmp_path / "refused"
    said = starbench("run", "three_pose", "-s", station, "-o", folder, home=home)
    assert said.returncode == 1
    assert "This file was recorded by camera 00050423, not 00099999" in said.stderr
    events = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    assert not any(line.get("state") in {"homing", "slewing"} for line in events)


def test_a_run_that_has_played_all_recordings_fails_and_says_so(first, tmp_path, home):
    few = tmp_path / "few"
    few.mkdir()
    (few / "a.raw").write_bytes((first / "captures" / "pose-001-attempt-1.raw").read_bytes())
    (few / "b.raw").write_bytes((first / "captures" / "pose-002-attempt-1.raw").read_bytes())
    folder = tmp_path / "short"
    said = starbench("run", "three_pose", "-s", played(first, tmp_path, few), "-o", folder, home=home)
    assert said.returncode == 1
    assert "All recordings have been played" in said.stderr
