"""What a run does when a pose keeps failing its gates: attempts kept, then skipped, held or failed, as written."""

import json

import pytest
from running import journal, results, starbench

HEAD = """\
format: starbench/sequence/1
name: Retry policy
defaults:
  settle: {duration_s: 0.3}
  record: {attempts: 2, backoff_s: 0.2}
steps:
  - light
"""
IMPOSSIBLE = "record: {gates: {min_stars: 100000}, on_failure: %s, hold_s: 1}"
TWO_POSES = """\
  - repeat:
      poses: [{pan_deg: -6, tilt_deg: 2}, {pan_deg: 6, tilt_deg: 2}]
      steps: [move, settle, record]
"""
END = """\
  - solve: {limits: {rms_px: 0.5, sigma_fx_px: 0.001, sigma_r_mm: 100}}
  - report
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return tmp_path_factory.mktemp("home")


def run(home, folder, on_failure, *, poses="", end=""):
    sequence = folder.with_suffix(".yaml")
    pose = "  - move: {name: doomed, pan_deg: 0, tilt_deg: -3}\n  - settle\n"
    sequence.write_text(HEAD + poses + pose + f"  - {IMPOSSIBLE % on_failure}\n" + end)
    return starbench("run", sequence, "-s", "simulated", "--seed", 5, "-o", folder, home=home)


@pytest.mark.slow
def test_a_pose_that_keeps_failing_is_skipped_where_the_sequence_says_so(home, tmp_path):
    folder = tmp_path / "skipped"
    said = run(home, folder, "skip", poses=TWO_POSES, end=END)
    assert said.returncode == 0, said.stderr
    found = results(folder)
    attempts = [[attempt["accepted"] for attempt in pose["attempts"]] for pose in found["poses"]]
    assert attempts == [[True], [True], [False, False]]
    assert [view["name"] for view in found["calibration"]["views"]] == ["pan -6 tilt 2", "pan 6 tilt 2"]
    (deviation,) = found["deviations"]
    assert "Pose 3 (doomed) failed 2 attempts: stars" in deviation
    assert deviation.endswith("It was skipped, as the sequence specifies.")
    verdicts = {
        gate["name"]: gate["verdict"] for gate in found["gates"] if not gate["name"].startswith("pose")
    }
    assert verdicts == {"rms": "pass", "sigma fx": "fail", "sigma r": "pass"}
    assert starbench("verify", folder, home=home).returncode == 0


def test_between_attempts_it_waits_twice_as_long_each_time(home, tmp_path):
    folder = tmp_path / "failed"
    said = run(home, folder, "fail", end=TWO_POSES + END)
    assert said.returncode == 1
    assert "Pose 1 (doomed) failed 2 attempts: stars" in said.stderr
    waited = [
        e["wait_s"] for e in journal(folder) if e["event"] == "entering" and e["state"] == "backing_off"
    ]
    assert waited == [0.2, 0.0]


@pytest.mark.slow
def test_a_pose_that_is_held_with_nobody_there_ends_the_run_safely_and_resumable(home, tmp_path):
    folder = tmp_path / "held"
    said = run(home, folder, "hold", end=TWO_POSES + END)
    assert said.returncode == 3, said.stderr
    assert "Try it again?" in said.stderr
    lines = journal(folder)
    assert [e["how"] for e in lines if e["event"] == "run_ended"] == ["aborted"]
    resumed = starbench("resume", folder, home=home)
    assert resumed.returncode == 3
    stored = [e["attempt"] for e in journal(folder) if e["event"] == "capture_stored"]
    assert stored == [1, 2, 3, 4]
    assert json.dumps(lines) == json.dumps(journal(folder)[: len(lines)])  # nothing written is written over
