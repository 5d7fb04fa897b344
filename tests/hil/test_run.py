"""The main job as an operator sees it: from a sequence file to a sealed report, and back again."""

import json
import math
import re
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
from quick_runs import THREE, quick_words
from running import called, end_when, entering, journal, numbers, results, start
from shared_folder import shared_folder
from slow_cases import first_quick

from bench.solve.run_reader import load


@pytest.fixture
def finished(three_pose):
    """A run that nobody disturbed: what the command said, and its folder."""
    answer, progress = ((three_pose / stream).read_text() for stream in ("stdout", "stderr"))
    return json.loads(answer), progress, three_pose / "run"


def test_a_run_ends_with_a_report_and_every_parameter_within_its_uncertainty(finished):
    answer, _, folder = finished
    assert (folder / "report.html").read_text().startswith("<!DOCTYPE html>")
    assert answer["converged"]
    assert set(answer["camera"]) >= {"fx", "fy", "cx", "cy", "k1", "k2"}
    assert set(answer["sigma"]) >= {*["x", "y", "r"], *["fx", "fy", "cx", "cy", "k1", "k2"]}
    run_results = answer["results"]
    assert run_results["run"]["collimator"]["serial"] == "SIM-1"
    assert run_results["passport"]["number"] == "SIM-2026-01"
    assert run_results["gimbal_readings"]["entered"]
    k = run_results["calibration"]["coverage_factor"]
    expanded = {row["name"]: k * row["sigma"] for row in run_results["comparison"]}
    assert set(expanded) >= {"fx", "fy", "cx", "cy", "k1", "k2", "r"}
    assert all(abs(row["error"]) <= expanded[row["name"]] for row in run_results["comparison"])
    assert 0.5 < expanded["fx"] < 15  # what certificate and readings can tell of 3345 px from three poses
    assert answer["rms_px"] < 0.2


def test_progress_tells_state_pose_and_time_left(finished):
    _, progress, _ = finished
    assert re.search(r"recording +pose 2 of 3 \(right\)", progress)
    assert " left" in progress


def test_a_notebook_reads_the_run_and_finds_its_stars_again_without_its_results(finished, tmp_path):
    answer, _, folder = finished
    run = load(folder)
    assert run.camera.to_dict() == answer["camera"]
    assert run.sigma == pytest.approx(answer["sigma"])
    solved_only = shutil.copytree(folder, tmp_path / "solved")
    solved_only.chmod(0o755)
    for name in ("results.json", "views.h5", "report.html"):
        (solved_only / name).unlink()
    again = load(solved_only)
    assert again.report is None
    assert again.camera == run.camera
    assert again.collimator == run.collimator
    assert np.array_equal(again.covariance, run.covariance)
    for pose, other in zip(again.poses, run.poses, strict=True):
        assert (pose.index, pose.name, pose.commanded_deg) == (other.index, other.name, other.commanded_deg)
        assert pose.measured_deg == other.measured_deg
        assert pose.view.recorded_s == other.view.recorded_s
        assert np.array_equal(pose.view.points_px, other.view.points_px)
        assert np.array_equal(pose.residuals_px, other.residuals_px)
    assert np.array_equal(again.poses[0].picture, run.poses[0].picture)
    assert (np.diff([pose.view.recorded_s for pose in run.poses]) > 0.0).all()


@pytest.mark.slow  # test_limits.py calibrates the recordings of a run again
def test_calibrating_from_bare_captures_comes_within_the_uncertainty(finished, home):
    answer, _, folder = finished
    captures = sorted((folder / "captures").iterdir())
    again = called("calibrate", *captures, "--json", home=home)
    bare = json.loads(again.stdout)
    # Captures alone hold no certificate and no readings.
    assert bare["sigma"]["fx"] > 3 * answer["sigma"]["fx"]
    assert all(
        abs(bare["camera"][n] - answer["camera"][n]) < 3 * math.hypot(bare["sigma"][n], answer["sigma"][n])
        for n in ("fx", "fy", "cx", "cy", "k1", "k2")
    )


KILLED = [
    pytest.param(entering("homing"), id="homing", marks=pytest.mark.slow),
    pytest.param(entering("recording", 2), id="recording", marks=pytest.mark.slow),
    pytest.param(lambda line: line["event"] == "capture_stored" and line["pose"] == 2, id="stored"),
    pytest.param(entering("reporting"), id="reporting", marks=pytest.mark.slow),
]


@pytest.fixture(scope="session")
def quick(tmp_path_factory):
    """The words of a run without its folder, and the folder of one that nobody disturbed."""

    def make(folder):
        called(*quick_words(folder, THREE), home=folder / "home")

    folder = shared_folder(tmp_path_factory, "quick", make)
    return ("run", folder / "sequence.yaml", "-s", folder / "station.yaml", "--seed", 7), folder / "run"


@pytest.mark.parametrize("reached", KILLED)
def test_a_killed_run_resumes_to_the_same_numbers(quick, home, tmp_path, reached):
    words, undisturbed = quick
    folder = tmp_path / "killed"
    process = start(*words, "-o", folder, home=home)
    end_when(process, folder, reached)
    called("resume", folder, home=home)
    assert numbers(folder) == numbers(undisturbed)
    stored = [line["capture"] for line in journal(folder) if line["event"] == "capture_stored"]
    assert len(stored) == len(set(stored)) == 3
    assert results(folder)["run"]["resumed"] == 1


@pytest.mark.parametrize("spoilt", first_quick([Path.unlink, lambda path: path.write_bytes(bytes(100))]))
def test_a_recording_that_is_gone_when_a_run_is_resumed_is_made_again(quick, home, tmp_path, spoilt):
    """Before, its pose counted as recorded, and the run failed at its end whenever it was resumed."""
    words, _ = quick
    folder = tmp_path / "spoilt"
    process = start(*words, "-o", folder, home=home)
    end_when(process, folder, lambda line: line["event"] == "capture_stored" and line["pose"] == 3)
    capture = folder / "captures" / "pose-002-attempt-1.raw"
    capture.chmod(0o600)
    spoilt(capture)
    assert "Record pose 2" in called("resume", folder, "--dry-run", home=home).stdout
    called("resume", folder, home=home)
    poses = [pose["attempts"][-1]["capture"] for pose in results(folder)["poses"]]
    assert poses[1] == "captures/pose-002-attempt-2.raw"
    assert called("verify", folder, home=home).stdout.startswith("SEALED")


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGINT,
        pytest.param(signal.SIGTERM, marks=pytest.mark.slow),
        pytest.param(signal.SIGHUP, marks=pytest.mark.slow),
    ],
)
def test_a_signal_stops_the_run_safely_and_it_can_be_resumed(quick, home, tmp_path, number):
    folder = tmp_path / "stopped"
    process = start(*quick[0], "-o", folder, home=home)
    output = end_when(process, folder, entering("slewing", 2), number)
    assert process.returncode == 3
    assert f"starbench resume {folder}" in output
    lines = journal(folder)
    assert [line["state"] for line in lines if line["event"] == "entering"][-2:] == ["aborting", "aborted"]
    assert lines[-1]["event"] == "run_ended"
    why = "stopped by Ctrl-C" if number == signal.SIGINT else f"{number.name} received"
    assert lines[-1]["why"] == why
    assert not list((folder / "captures").glob("*.part"))
    assert f"Report: {folder / 'report.html'}" in output
    assert why in (folder / "report.html").read_text()
