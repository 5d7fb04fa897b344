"""A run that chooses its poses on the simulated bench: to its bound, and to its goal."""

import re

import pytest
from quick_runs import THREE, write_station, write_until
from running import called, journal, results

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
    ended = called("run", sequence, "-s", station, "--seed", SEED, "-o", folder, home=home)
    assert ended.returncode == 0, ended.stderr
    assert re.search(r"3 poses \(k = [\d.]+\): U\(fx\)", ended.stderr)
    return folder


def poses(folder):
    accepted = {
        line["pose"] for line in journal(folder) if line["event"] == "attempt_checked" and line["accepted"]
    }
    stored = [line for line in journal(folder) if line["event"] == "capture_stored"]
    return {line["pose"]: line["commanded_deg"] for line in stored if line["pose"] in accepted}


def test_it_measures_until_its_bound_and_the_report_shows_the_course(undisturbed, files):
    decisions = results(undisturbed)["untils"]
    reached = [decision["now"]["expanded_fx_px"] for decision in decisions]
    assert [decision["poses"] for decision in decisions] == [3, 4, 5]
    assert reached[0] > reached[-1]
    assert decisions[-1]["ended"] == "at_most"
    page = (undisturbed / "report.html").read_text()
    assert "at most 0.001 px" in page
    assert "course-2-" in page
    assert "goal of a step" in page
    again = called("status", undisturbed, home=files[0])
    assert "5 of 5 poses recorded" in again.stdout
    assert called("verify", undisturbed, "--again", home=files[0]).returncode == 0


def test_the_final_solve_states_what_the_last_decision_reached(undisturbed):
    run_results = results(undisturbed)
    k = run_results["calibration"]["coverage_factor"]
    assert run_results["untils"][-1]["now"]["expanded_fx_px"] == pytest.approx(
        k * run_results["calibration"]["sigma"]["fx"]
    )
