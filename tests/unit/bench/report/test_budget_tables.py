"""The uncertainty budget of a report, as printed."""

import re

import pytest
from report_sample import SMALL, sample

from bench.report.calibration_tables import budget_rows, combined, not_included, overlap
from bench.report.html import render_report
from bench.report.text import NOTHING
from calib.model.budget_row import COMMON_FIELD as COMMON_ERRORS

TIMES = "\N{MULTIPLICATION SIGN}"


@pytest.fixture(scope="module")
def calibration(data):
    return data.results["calibration"]


def test_a_row_is_printed_with_units_divisor_and_shares(calibration):
    rows = {row.name: row for row in budget_rows(calibration)}
    scale = rows["scale of the print"]
    assert (scale.type, scale.value, scale.sensitivity) == ("B", f"20 {TIMES} 10⁻⁶", "0.00334 px / 10⁻⁶")
    assert scale.distribution == "rectangular, divisor 1.73"
    assert rows["passport of the collimator"].sensitivity == "13.1 px / mm"
    assert rows["bow of the print"].value == "0.01 mm at 40 mm"
    assert rows["bow of the print"].focal == "< 0.001"
    stars = rows["stars"]
    assert (stars.value, stars.sensitivity, stars.distribution) == (
        NOTHING,
        NOTHING,
        "normal, \N{GREEK SMALL LETTER NU} = 1791",
    )
    assert sum(row.focal_share for row in rows.values()) == pytest.approx(1)


def test_the_sums_are_those_of_the_contributions(calibration):
    (u_focal, u_corner), (focal, corner) = combined(calibration)
    assert (u_focal, u_corner) == ("2.1", "0.48")
    assert (focal, corner) == ("4.3", "0.97")


def test_what_is_not_included_keeps_its_effect(calibration):
    names = [name for name, _ in not_included(calibration)]
    assert names[0] == "bow of the print"
    assert not_included({"not_included": ["mounting of the lens"]}) == [("mounting of the lens", "")]


def test_results_without_rows_print_no_table():
    assert (budget_rows({}), combined({}), not_included({})) == ([], None, [])
    data = sample(size=SMALL)
    for key in ("budget_rows", "not_included"):
        del data.results["calibration"][key]
    page = render_report(data, draw=False)
    assert "Not known, not included" not in page
    assert "<h3>Uncertainty budget</h3>" in page


def test_the_page_has_the_table_and_escapes_what_a_station_says(html):
    table = html[html.index('id="budget"') : html.index("Not known, not included")]
    assert "maker&#39;s drawing &lt;4711&gt;" in table
    assert len(re.findall("<tr", table)) == 6 + 3
    assert "0.01 mm at 35 mm from the axis would move fx by 5.8 px" in html
    assert "Shares of the variance of each value" in html


def test_rows_that_can_hold_the_same_errors_are_named(calibration):
    own = {**calibration["budget_rows"][0], "name": COMMON_ERRORS, "value": None, "unit": ""}
    wavefront = {
        **calibration["budget_rows"][0],
        "name": "slopes of the wavefront",
        "unit": "urad",
        "value": 2.0,
    }
    rows = [
        row for row in calibration["budget_rows"] if row["name"] != COMMON_ERRORS and row["unit"] != "urad"
    ]
    assert (
        overlap({"budget_rows": [*rows, own]})
        == overlap({"budget_rows": [*rows, wavefront]})
        == overlap({})
        == ""
    )
    said = overlap({"budget_rows": [*rows, own, wavefront]})
    assert "slopes of the wavefront" in said
    assert COMMON_ERRORS in said
    assert said.endswith("the uncertainty is an upper limit.")
    data = sample(size=SMALL)
    data.results["calibration"]["budget_rows"] = [*rows, own, wavefront]
    assert said in render_report(data, draw=False)
