"""A run that chooses its poses on the simulated bench: to its goal; killed in each phase of a round, then resumed."""

import json
import re
import shutil

import pytest
from quick_runs import THREE, write_station, write_until
from running import end_when, entering, journal, results, starbench, start

SEED = 3
UNTIL = f"{{expanded_fx_px: 0.001, at_most: 5, start: {THREE}}}"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    sequence = write_until(folder / "sequence.yaml", UNTIL)
    return folder / "home", sequence, write_station(folder / "station.yaml")


@pytest.fixture(scope="module")
def undisturbed(files, tmp_path_factory):
    home, sequence, station = files
    folder = tmp_path_factory.mktemp("runs") / "undisturbed"
    said = starbench("run", sequence, "-s", station, "--seed", SEED, "-o", folder, home=home)
    assert said.returncode == 0, said.stderr
    assert re.search(r"3 poses \(k = [\d.]+\): U\(fx\)", said.stderr)
    return folder


def decisions(folder):
    return [line for line in journal(folder) if line["event"] == "until_decided"]


def poses(folder):
    accepted = {
        line["pose"] for line in journal(folder) if line["event"] == "attempt_checked" and line["accepted"]
    }
    stored = [line for line in journal(folder) if line["event"] == "capture_stored"]
    return {line["pose"]: line["commanded_deg"] for line in stored if line["pose"] in accepted}


def test_it_measures_until_its_bound_and_the_report_shows_the_course(undisturbed, files):
    told = results(undisturbed)["untils"]
    reached = [one["now"]["expanded_fx_px"] for one in told]
    assert [one["poses"] for one in told] == [3, 4, 5]
    assert reached[0] > reached[-1]
    assert told[-1]["ended"] == "at_most"
    page = (undisturbed / "report.html").read_text()
    assert "Until the goal: U(fx) is at most 0.001 px" in page
    assert "course-2-" in page
    assert "The goal of a step was not met." in page
    again = starbench("status", undisturbed, home=files[0])
    assert "5 of 5 poses recorded" in again.stdout
    assert starbench("verify", undisturbed, "--again", home=files[0]).returncode == 0


def test_the_final_solve_states_what_the_last_decision_reached(undisturbed):
    told = results(undisturbed)
    k = told["calibration"]["coverage_factor"]
    assert told["untils"][-1]["now"]["expanded_fx_px"] == pytest.approx(
        k * told["calibration"]["sigma"]["fx"]
    )


@pytest.mark.parametrize(
    "reached",
    [
        pytest.param(entering("choosing"), marks=pytest.mark.slow),
        entering("slewing", 4),
        pytest.param(entering("settling", 4), marks=pytest.mark.slow),
        pytest.param(entering("recording", 4), marks=pytest.mark.slow),
        pytest.param(entering("checking", 4), marks=pytest.mark.slow),
        pytest.param(lambda line: line["event"] == "until_decided", marks=pytest.mark.slow),
    ],
    ids=["choosing", "slewing", "settling", "recording", "checking", "decided"],
)
@pytest.mark.slow
def test_killed_in_a_round_it_goes_on_with_the_same_poses(reached, files, undisturbed, tmp_path):
    home, sequence, station = files
    folder = tmp_path / "killed"
    end_when(start("run", sequence, "-s", station, "--seed", SEED, "-o", folder, home=home), folder, reached)
    before = decisions(folder)
    resumed = starbench("resume", folder, home=home)
    assert resumed.returncode == 0, resumed.stderr
    assert "Choose poses until U(fx) is at most 0.001 px" in resumed.stderr
    assert decisions(folder)[: len(before)] == before
    assert poses(folder)[4] == poses(undisturbed)[4]
    assert len(poses(folder)) == 5
    names = {json.dumps(one["chosen"]["angles_deg"]) for one in decisions(folder) if "chosen" in one}
    assert len(names) == 2
    shutil.rmtree(folder, ignore_errors=True)


def test_a_goal_is_met_and_nothing_further_is_recorded(files, tmp_path):
    home, _, station = files
    sequence = write_until(tmp_path / "good.yaml", f"{{worst_corner_px: 0.9, at_most: 9, start: {THREE}}}")
    folder = tmp_path / "good"
    said = starbench("run", sequence, "-s", station, "--seed", SEED, "-o", folder, home=home)
    assert said.returncode == 0, said.stderr
    last = decisions(folder)[-1]
    assert last["ended"] == "met"
    assert last["now"]["worst_corner_px"] <= 0.9
    assert len(poses(folder)) == last["poses"] < 9
    assert "The goals are met." in said.stderr


def test_it_is_rehearsed(files, tmp_path):
    home, sequence, station = files
    queue = tmp_path / "queue.yaml"
    queue.write_text(
        f"format: starbench/queue/1\nname: Night\njobs: [{{name: one, sequence: {sequence}, station: {station}}}]\n"
    )
    night = tmp_path / "night"
    said = starbench("rehearse", queue, "--output", night, "--quiet", home=home)
    assert said.returncode == 0, said.stderr + said.stdout
    (folder,) = (path.parent for path in night.rglob("journal.jsonl") if decisions(path.parent))
    assert [one["recorded"] for one in decisions(folder)] == [3, 4, 5]
    assert json.loads((folder / "results.json").read_text())["untils"][-1]["ended"] == "at_most"
