"""The cells of the tables of a page: which value stands in which column, and in which colour."""

import copy

import numpy as np
import pytest
from report_sample import SMALL, sample

from bench.charts.chart_findings import find_charts
from bench.report.control_chart import render_charts
from bench.report.html import ReportData, render_report
from bench.wording.numbers import NOTHING
from tests.unit.bench.charts.test_charts import steady
from tests.unit.bench.report.structure import cells

MINUS = "\N{MINUS SIGN}"


@pytest.fixture(scope="module")
def page():
    """The sample with a pose that was not used, one that was refused, and refused recordings."""
    data = sample(size=SMALL)
    results = copy.deepcopy(dict(data.results))
    first, second, third = results["poses"]
    first["measured_deg"]["pan"] = 1.70042
    first["attempts"][0] |= {"accepted": False, "reasons": ["few stars", "the target moved"]}
    second |= {"rms_px": None, "named_by": "gimbal"}
    third["attempts"][0]["accepted"], third["rms_px"] = False, None
    return render_report(ReportData(results, data.views))


def test_a_pose_shows_its_state_angles_stars_and_picture(page):
    picture = "fired-per-edge, 2 periods, 2.1 events per edge, 50 % ON, 12 hot pixels"
    tilt = f"tilt {MINUS}0.500"
    explained = f"{picture} (2.1 events an edge)"
    assert cells(page, "Poses") == [
        ["first", f"pan 1.700, {tilt}", f"pan 1.7004, {tilt}0", "1.4", "274", "0.0805", "60.0003", explained],
        ["second & third [marginal] not used", f"pan 3.400, {tilt}", f"pan 3.4000, {tilt}0", "0.1",
         "234, identified by the gimbal", NOTHING, "60.0003", picture],
        ["roll <b>$x$ [fail] refused", f"pan 5.100, {tilt}", f"pan 5.1000, {tilt}0", "0.1", "246", NOTHING, "60.0003",
         picture],
    ]  # fmt: skip


def test_a_recording_shows_why_it_was_refused(page):
    rows = cells(page, "Recordings")
    assert rows[0][:6] == ["first", "1", "1\u202f234\u202f567", "24.7", "8", "50 ms"]
    assert rows[0][6] == f"captures/pose-001-attempt-1.raw {'11' * 32}few stars; the target moved"
    assert [row[7] for row in rows] == [
        "[fail] refused",
        "[fail] refused",
        "[pass] accepted",
        "[fail] refused",
    ]


def test_the_truth_has_the_digits_of_the_uncertainty(page):
    fx, _, cx = cells(page, "Comparison with the simulated truth")[:3]
    assert fx == ["fx", "3346.4", "± 4.3", "3345.1", "1.3", "0.61"]
    assert cx[4:] == [f"{MINUS}1.6", f"{MINUS}1.22"]


def test_a_chart_counts_the_runs_beyond_each_limit_and_marks_a_drift_that_is_seen():
    drifting = steady(
        30, np.random.default_rng(5), ("fx", "k1"), lambda n, name: 0.3 * n if name == "fx" else 0.0
    )
    fx, k1 = cells(render_charts(find_charts([drifting])), "Camera 1, EVK4: 30 runs")
    assert fx == [
        "fx", "px", "3346.59", "3349.41", "3352.24", "12", "26", "[drift] +0.307 ± 0.041 per hour",
        "+0.38 ± 0.85 per °C", "[fail] out of control",
    ]  # fmt: skip
    assert k1[5:8] == ["0", "0", f"{MINUS}0.003 ± 0.039 per hour"]
