"""A calibration measures the focal length of the lens as it is focused, and is compared with that one."""

import pytest
from quick_runs import THREE, write_sequence, write_station
from running import results, starbench

DELIVERED_PX = 1672.0
BREATHED_PX = DELIVERED_PX / (1.0 - DELIVERED_PX * 4.86e-6 / 2.0)
"""1 / v = 1 / f - 1 / d, for d = 2 m: 0.4 % more."""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("breathing")
    lens = "lens: {focus_distance_m: 2, f_number: 5.6}, "  # blurred over 1.2 px
    station = write_station(folder / "station.yaml", simulation=lens)
    sequence = write_sequence(folder / "sequence.yaml", THREE)
    said = starbench(
        *("run", sequence, "-s", station, "--seed", 4, "-o", folder / "run"),
        home=tmp_path_factory.mktemp("home"),
    )
    assert said.returncode == 0, said.stderr
    return folder / "run"


@pytest.mark.slow
def test_the_result_is_the_breathed_focal_length(finished):
    told = results(finished)
    (fx,) = [row for row in told["comparison"] if row["name"] == "fx"]
    assert fx["truth"] == pytest.approx(BREATHED_PX, rel=1e-6)
    assert abs(fx["error"]) < 4.0 * fx["sigma"]
    assert fx["sigma"] < (BREATHED_PX - DELIVERED_PX) / 4.0


@pytest.mark.slow
def test_the_report_states_the_truth_of_that_focus(finished):
    assert results(finished)["truth"]["lens"]["focus_distance_m"] == 2.0
