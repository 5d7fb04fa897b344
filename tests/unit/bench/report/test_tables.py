"""Tables of a report: the budget, the gimbal, the witnesses, and what is known of the bench."""

from dataclasses import replace

import pytest
from report_sample import BORESIGHT, SMALL, sample

from bench.record.results import MountFace, ReadingsUse
from bench.report.calibration_tables import budget_rows, combined, not_included, overlap, witness_rows
from bench.report.html import render_report
from bench.report.run_tables import boresight_rows, inputs, readings_rows
from bench.wording.numbers import NOTHING
from calib.model.result_parts import COMMON_FIELD as COMMON_ERRORS
from calib.model.result_parts import GimbalEstimate, Witness
from tests.support.printed_text import printed_text

# ---------------------------------------------------------------- the uncertainty budget

TIMES = "\N{MULTIPLICATION SIGN}"


@pytest.fixture(scope="module")
def calibration(data):
    return data.results["calibration"]


def test_a_row_is_printed_with_units_divisor_and_shares(calibration):
    rows = {row["name"]: row for row in budget_rows(calibration)}
    scale, stars, bow = (rows[name] for name in ("scale of the print", "stars", "bow of the print"))
    assert (scale["type"], scale["value"]) == ("B", f"20 {TIMES} 10⁻⁶")
    assert scale["sensitivity"] == "0.00334 px / 10⁻⁶"
    assert scale["distribution"] == "rectangular, divisor 1.73"
    assert rows["passport of the collimator"]["sensitivity"] == "13.1 px / mm"
    assert (bow["value"], bow["lengths"][0]) == ("0.01 mm at 40 mm", "< 0.001")
    assert (stars["value"], stars["sensitivity"]) == (NOTHING, NOTHING)
    assert stars["distribution"] == "normal, \N{GREEK SMALL LETTER NU} = 1791"
    assert sum(row["shares"][0] for row in rows.values()) == pytest.approx(1)


def test_the_sums_are_those_of_the_contributions_and_what_is_not_included_keeps_its_effect(calibration):
    assert combined(calibration) == (("2.1", "0.48"), ("4.3", "0.97"))
    assert not_included(calibration)[0][0] == "bow of the print"
    assert not_included({"not_included": ["mounting of the lens"]}) == [("mounting of the lens", "")]


def test_rows_that_can_hold_the_same_errors_are_named(calibration):
    first, *_ = stated = calibration["budget_rows"]
    own = replace(first, name=COMMON_ERRORS, value=None, unit="")
    wavefront = replace(first, name="slopes of the wavefront", unit="urad", value=2.0)
    rows = [row for row in stated if row.name != COMMON_ERRORS and row.unit != "urad"]
    for alone in ([*rows, own], [*rows, wavefront], []):
        assert overlap({"budget_rows": alone}) == ""
    sentence = overlap({"budget_rows": [*rows, own, wavefront]})
    assert "slopes of the wavefront" in sentence
    assert COMMON_ERRORS in sentence
    assert sentence.endswith("an upper limit.")
    data = sample(size=SMALL)
    data.results["calibration"]["budget_rows"] = [*rows, own, wavefront]
    assert sentence in render_report(data)


# ---------------------------------------------------------------- the gimbal: no blame without evidence


ENTERED = GimbalEstimate(
    entered=True,
    values={},
    sigma={},
    chi_square=20.4,
    degrees_of_freedom=21,
    rms_deg=0.001,
    reading_sigma_deg=0.002,
    scatter=1.0,
)


def test_the_boresight_is_printed_with_u_and_with_the_faces_of_the_mount(results):
    assert boresight_rows(results) == []
    results["calibration"]["gimbal"] = ENTERED
    assert "two axes" in dict(boresight_rows(results))["Boresight"]
    results["calibration"]["boresight"] = BORESIGHT.to_dict()
    results["mount_faces"] = [MountFace("front", [0, 0, 1], angle_deg=1.28, expanded_deg=0.023)]
    turned, looks, face = (text for _, text in boresight_rows(results))
    assert turned == "x 0.500° ± 0.012°, y \N{MINUS SIGN}1.250° ± 0.046°, z 3.00° ± 0.11°"
    assert looks == "right 1.146° ± 0.012°, down \N{MINUS SIGN}0.573° ± 0.023° of the flange's axis"
    assert face == "angle 1.280° ± 0.023°"


# ---------------------------------------------------------------- what is stated beside what all others say


def witness(name="certificate", **changed):
    plain = Witness(
        name, "station", "mm", 255.0, 0.05, 255.02, 0.04, innovation=-0.31, fault_probability=0.01
    )
    return replace(plain, **changed)


@pytest.mark.parametrize(
    ("innovation", "fault", "verdict"),
    [(-0.3, 0.01, "pass"), (2.4, 0.05, "marginal"), (4.2, 0.1, "fail"), (-2.9, 0.6, "fail")],
)
def test_a_statement_is_doubted_by_its_difference_or_by_its_probability_of_a_fault(
    innovation, fault, verdict
):
    (row,) = witness_rows({"witnesses": [witness(innovation=innovation, fault_probability=fault)]})
    assert row["verdict"] == verdict
    assert row["fault"] == f"{100 * fault:.0f} %"


def test_statements_have_their_standard_uncertainties_and_the_one_most_at_odds_comes_first():
    joint = witness("joint", stated=None, sigma=None, expected=None, expected_sigma=None, innovation=1.2)
    likely_wrong, far = witness("b", fault_probability=0.9), witness("c", innovation=3.0)
    rows = witness_rows({"witnesses": [witness(), joint, likely_wrong, far]})
    assert [row["name"] for row in rows] == ["b", "c", "joint", "certificate"]
    plain, joint = rows[3], rows[2]
    assert (plain["stated"], plain["expected"]) == ("255.000 ± 0.050 mm", "255.020 ± 0.040 mm")
    assert plain["innovation"] == "\N{MINUS SIGN}0.3"
    assert joint["stated"] == joint["expected"]
    assert "mm" not in joint["stated"]


# ---------------------------------------------------------------- passport, readings and input files


def test_the_report_names_the_passport_with_values_and_hash(data):
    rows = dict(inputs(data.results))
    assert rows["Collimator passport"] == (
        "number T-2041, of the collimator C-17, dated 2026-02-11, valid until 2028-02-11, at 20 °C, "
        "stated in the station file (certificate)"
    )
    assert rows["Values of the passport"] == "r = 255.03 mm, standard uncertainty 0.05 mm"
    text = printed_text(render_report(data))
    assert "ab" * 32 in text
    assert any("does not bound the parallax" in words for words in text)


def test_readings_that_entered_say_how_they_agree():
    readings = ReadingsUse(entered=True, statement=None, bound=None, why_not=None)
    ((_, text),) = readings_rows(readings, replace(ENTERED, scatter=1.0, reading_sigma_deg=0.002))
    what = "entered the adjustment as measurements; chi-square 20.4 with 21 degrees of freedom"
    assert text == f"{what}, 3.6 arc seconds RMS"
    ((_, text),) = readings_rows(readings, replace(ENTERED, scatter=2.0, reading_sigma_deg=0.004))
    widened = "entered with a standard uncertainty of 0.00400°, because they scatter more than stated"
    assert text.endswith(widened)
