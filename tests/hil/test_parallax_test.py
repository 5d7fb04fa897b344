"""The shipped parallax test on a simulated bench whose entrance pupil is 30 mm in front of the pivot."""

import pytest
from quick_runs import write_station
from running import results, starbench

#: Fast light and short windows, so that the small sensor of the quick station is recorded in seconds.
QUICK = [
    *("--set", "sequence.defaults.light.frequency_hz=240"),
    *("--set", "sequence.defaults.record.window_ms=8.4"),
    *("--set", "sequence.defaults.record.attempts=1"),
]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parallax")
    station = write_station(
        folder / "station.yaml", simulation="collimator: {profile: like-bench, disc_walk: [-30, -30]}, "
    )
    said = starbench(
        *("run", "parallax_test", "-s", station, "--seed", 4, "-o", folder / "run", *QUICK),
        home=tmp_path_factory.mktemp("home"),
    )
    assert said.returncode == 0, said.stderr
    return folder / "run"


@pytest.mark.slow
def test_the_run_finds_the_pupil_within_its_uncertainty(finished):
    told = results(finished)["parallax"]
    off = told["pupil_off_pivot_mm"]
    assert off["value"] == pytest.approx(30.0, abs=3 * off["sigma"])
    assert off["sigma"] < 8.0
    assert not told["axes_differ"]
    assert told["stated_mm"] is None


@pytest.mark.slow
def test_the_gimbal_identifies_stars_where_the_tag_is_out_of_view_and_other_poses_are_skipped(finished):
    told = results(finished)
    named = [pose["named_by"] for pose in told["poses"]]
    assert named[:3] == ["tag"] * 3
    assert named.count("gimbal") >= 4
    assert len(told["deviations"]) == named.count(None)


@pytest.mark.slow
def test_the_report_says_what_to_write_into_the_station_file(finished):
    told = results(finished)["parallax"]
    page = (finished / "report.html").read_text(encoding="utf-8")
    assert "Entrance pupil in front of the pivot" in page
    assert told["station_entry"] in page
    assert told["says"][0].replace("+-", "\N{PLUS-MINUS SIGN}") in page
