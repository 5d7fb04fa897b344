"""A run that chooses its poses on the simulated bench, to its bound."""

import re

import pytest
from quick_runs import THREE, write_station, write_until
from running import called, results

UNTIL = f"{{expanded_fx_px: 0.001, at_most: 4, start: {THREE}}}"


@pytest.mark.slow  # tests/unit/bench/run/test_until.py rehearses the same
def test_it_measures_until_its_bound_and_the_report_shows_the_course(tmp_path, home):
    sequence, station = write_until(tmp_path / "s.yaml", UNTIL), write_station(tmp_path / "b.yaml")
    run = tmp_path / "run"
    ended = called("run", sequence, "-s", station, "--seed", 3, "-o", run, home=home)
    assert re.search(r"3 poses \(k = [\d.]+\): U\(fx\)", ended.stderr)
    decisions = results(run)["untils"]
    reached = [decision["now"]["expanded_fx_px"] for decision in decisions]
    assert [decision["poses"] for decision in decisions] == [3, 4]
    assert reached[0] > reached[-1]
    assert decisions[-1]["ended"] == "at_most"
    solved = results(run)["calibration"]
    assert reached[-1] == pytest.approx(solved["coverage_factor"] * solved["sigma"]["fx"])
    page = (run / "report.html").read_text()
    assert "at most 0.001 px" in page
    assert "course-2-" in page
    assert "goal of a step" in page
    assert "4 of 4 poses recorded" in called("status", run, home=home).stdout
    called("verify", run, "--again", home=home)
