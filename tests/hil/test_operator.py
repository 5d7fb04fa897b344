"""An operator at another terminal: hold and go on, skip, abort, take over; and a pose that crashes the process."""

import json
import signal
import time

import pytest
from running import PATIENCE_S, end_when, entering, journal, numbers, results, starbench, start

SEED = 7


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return tmp_path_factory.mktemp("home")


@pytest.fixture
def process(home, tmp_path):
    """A run under way, which a test commands."""
    process = start("run", "three_pose", "-s", "simulated", "--seed", SEED, "-o", tmp_path / "run", home=home)
    yield process
    process.kill()
    process.communicate()


def wait_for(process, folder, reached):
    deadline = time.monotonic() + PATIENCE_S
    while not any(map(reached, journal(folder))):
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline, journal(folder)
        time.sleep(0.01)


def states(folder):
    return [line["state"] for line in journal(folder) if line["event"] == "entering"]


def test_a_held_run_goes_on_where_it_was_and_ends_with_the_same_numbers(home, tmp_path, process):
    folder = tmp_path / "run"
    wait_for(process, folder, entering("slewing", 2))
    assert starbench("hold", folder, "--operator", "ada", home=home).returncode == 0
    wait_for(process, folder, entering("holding"))
    refused = starbench("release", folder, "--operator", "ben", home=home)
    assert refused.returncode == 1
    assert "held by ada" in refused.stderr
    status = json.loads(starbench("status", folder, "--json", home=home).stdout)
    assert (status["running"], status["state"], status["held_by"]) == (True, "holding", "ada")
    taken = starbench("release", folder, "--operator", "ben", "--take-over", "--json", home=home)
    assert json.loads(taken.stdout)["taken"]
    assert process.wait(PATIENCE_S) == 0
    after = states(folder)[states(folder).index("holding") + 1 :]
    assert after[0] == "lighting"
    assert "slewing" in after[1:2] or after[1] == "settling"
    assert any("Held by ada" in what for what in results(folder)["deviations"])
    assert not (folder / "control").exists()
    undisturbed = tmp_path / "undisturbed"
    said = starbench("run", "three_pose", "-s", "simulated", "--seed", SEED, "-o", undisturbed, home=home)
    assert said.returncode == 0, said.stderr
    assert numbers(folder) == numbers(undisturbed)
    assert starbench("verify", folder, home=home).returncode == 0


def test_the_light_is_off_while_a_run_is_held_and_the_move_is_repeated_after(home, tmp_path, process):
    folder = tmp_path / "run"
    wait_for(process, folder, entering("settling"))
    assert starbench("hold", folder, home=home).returncode == 0
    wait_for(process, folder, entering("holding"))
    wire = (folder / "wire.jsonl").read_text().splitlines()
    outputs = [line for line in wire if "OUTP" in line.upper() and "?" not in line]
    assert "OFF" in outputs[-1].upper() or "OUTP 0" in outputs[-1].upper() or "OUTP1 0" in outputs[-1].upper()
    assert starbench("release", folder, home=home).returncode == 0
    assert process.wait(PATIENCE_S) == 0
    after = states(folder)[states(folder).index("holding") + 1 :]
    assert after[:4] == ["lighting", "slewing", "settling", "recording"]


def test_a_skipped_pose_is_left_out_and_the_report_says_who_asked(home, tmp_path, process):
    folder = tmp_path / "run"
    wait_for(process, folder, entering("preflight"))
    assert starbench("skip", folder, "--pose", 2, "--operator", "ada", home=home).returncode == 0
    again = starbench("skip", folder, "--pose", 2, home=home)
    assert "skipped already" in again.stderr
    assert process.wait(PATIENCE_S) == 0
    told = results(folder)
    assert [pose["index"] for pose in told["poses"]] == [1, 3]
    assert told["deviations"] == ["Pose 2 (right) was skipped: ada asked for it."]


def test_an_abort_from_another_terminal_ends_safely_and_the_run_resumes(home, tmp_path, process):
    folder = tmp_path / "run"
    wait_for(process, folder, entering("slewing", 2))
    assert starbench("abort", folder, "--operator", "ben", home=home).returncode == 0
    assert process.wait(PATIENCE_S) == 3
    assert states(folder)[-2:] == ["aborting", "aborted"]
    assert "abort by ben" in journal(folder)[-1]["why"]
    late = starbench("hold", folder, home=home)
    assert late.returncode == 1
    assert "No process works on this run" in late.stderr
    before = (folder / "journal.jsonl").read_bytes()
    planned = starbench("resume", folder, "--dry-run", home=home)
    assert "To record: pose 2 (right)." in planned.stdout
    assert (folder / "journal.jsonl").read_bytes() == before
    resumed = starbench("resume", folder, home=home)
    assert resumed.returncode == 0, resumed.stderr
    assert "To record: pose 2 (right)." in resumed.stderr


def test_a_pose_that_crashes_the_process_twice_is_skipped_and_marked(home, tmp_path, process):
    folder = tmp_path / "run"
    end_when(process, folder, entering("recording", 2), signal.SIGSEGV)
    crashed_at = len(journal(folder))
    second = start("resume", folder, home=home)
    end_when(
        second,
        folder,
        lambda line: line["seq"] >= crashed_at and entering("recording", 2)(line),
        signal.SIGSEGV,
    )
    assert "crashed 2 times" in starbench("resume", folder, "--dry-run", home=home).stdout
    third = starbench("resume", folder, home=home)
    assert third.returncode == 0, third.stderr
    told = results(folder)
    (deviation,) = [what for what in told["deviations"] if what.startswith("Pose 2")]
    assert "crashed 2 times" in deviation
    assert [view["name"] for view in told["calibration"]["views"]] == ["left", "below"]
    crashes = [line["crash"] for line in journal(folder) if line["event"] == "run_resumed"]
    assert crashes == ["Fatal Python error: Segmentation fault"] * 2
    assert len(list((folder / "quarantine").glob("crash.txt.*"))) == 2
    assert starbench("verify", folder, home=home).returncode == 0
