"""A run on a station with a target of its own: another family, another polarity, other squares."""

import pytest
from quick_runs import END, THREE, quick_words
from running import results, starbench

TARGET = """\
target: {squares: [40, 44], pitch_mm: 4.5, segments: 12, tag_family: 25h9, tag_id: 7, tag_square: [18, 20], polarity: negative}
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    # The lens of the bench has k2 too: without it, the fit is wrong by some sigmas, whatever the target is.
    words = quick_words(folder, THREE, station=TARGET, seed=5, end=END.replace("[k1]", "[k1, k2]"))
    starbench(*words, home=tmp_path_factory.mktemp("home"))
    return folder / "run"


@pytest.mark.slow
def test_the_camera_is_calibrated_with_the_station_s_own_target(finished):
    run_results = results(finished)
    assert run_results["truth"]["target"]["tag_family"] == "25h9"
    assert run_results["truth"]["reticle"]["polarity"] == "negative"
    (fx,) = [row for row in run_results["comparison"] if row["name"] == "fx"]
    assert fx["sigma"] < 1.6
    assert abs(fx["error"]) < 3 * fx["sigma"]
    assert run_results["calibration"]["rms_px"] < 0.036
    assert sum(view["n"] for view in run_results["calibration"]["views"]) > 400
