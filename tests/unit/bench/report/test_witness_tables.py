"""The table of witnesses: what is stated beside what all others say, and which statement is doubted."""

import pytest

from bench.report.calibration_tables import amplitude_rows, witness_rows


def witness(name="certificate", **changed):
    plain = {
        "name": name,
        "source": "station",
        "unit": "mm",
        "stated": 255.0,
        "sigma": 0.05,
        "expected": 255.02,
        "expected_sigma": 0.04,
        "innovation": -0.31,
        "fault_probability": 0.01,
    }
    return {**plain, **changed}


@pytest.mark.parametrize(
    ("innovation", "fault", "verdict"),
    [(-0.3, 0.01, "pass"), (2.4, 0.05, "marginal"), (4.2, 0.1, "fail"), (-2.9, 0.6, "fail")],
)
def test_a_statement_is_doubted_by_its_difference_or_by_its_probability_of_a_fault(
    innovation, fault, verdict
):
    (row,) = witness_rows({"witnesses": [witness(innovation=innovation, fault_probability=fault)]})
    assert row.verdict == verdict
    assert row.fault == f"{100 * fault:.0f} %"


def test_values_are_printed_with_their_standard_uncertainties():
    (row,) = witness_rows({"witnesses": [witness()]})
    assert (row.stated, row.expected) == ("255.000 ± 0.050 mm", "255.020 ± 0.040 mm")
    assert row.innovation == "\N{MINUS SIGN}0.3"


def test_a_joint_statement_has_no_single_value():
    joint = witness(stated=None, sigma=None, expected=None, expected_sigma=None, innovation=1.2)
    (row,) = witness_rows({"witnesses": [joint]})
    assert row.stated == row.expected
    assert "mm" not in row.stated


def test_the_statement_most_at_odds_comes_first():
    rows = witness_rows(
        {"witnesses": [witness("a"), witness("b", fault_probability=0.9), witness("c", innovation=3.0)]}
    )
    assert [row.name for row in rows] == ["b", "c", "a"]


def test_sizes_are_printed_with_their_unit_and_expectation():
    size = {"name": "field of a pose", "value": 12.34, "log_sigma": 0.2, "unit": "urad", "expected": 5.0}
    assert amplitude_rows({"amplitudes": [size]}) == [
        ("field of a pose", "12 µrad, known to a factor of 1.2; expected 5.0 µrad")
    ]


def test_results_of_another_engine_have_no_witnesses():
    assert witness_rows({}) == []
    assert amplitude_rows({}) == []
