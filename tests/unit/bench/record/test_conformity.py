"""PASS or FAIL of a run: guarded acceptance by the expanded uncertainty, and what fails whatever the limits say."""

from types import SimpleNamespace

import pytest

from bench.record.conformity import conformity
from bench.wording.conformity import conformity_headline, conformity_sentences
from sequences.schema import ResultLimitConfig


def calibration(**changes):
    values = {"fx": 1600.0, "k1": -0.1, "r": 255.0}
    expanded = {"fx": 2.0 * 1.0, "k1": 3.0 * 0.001, "r": 2.0 * 0.1}
    return SimpleNamespace(**{"converged": True, "values": values, "U": expanded} | changes)


def judged(*limits, failed=(), **changes):
    rules = tuple(ResultLimitConfig(**limit) for limit in limits)
    return conformity(calibration(**changes), {"sequence": rules}, failed)


@pytest.mark.parametrize(
    ("upper", "verdict"),
    [(1602.0, "pass"), (1601.9, "conditionalPass"), (1598.0, "conditionalFail"), (1597.9, "fail")],
)
def test_a_value_passes_only_if_it_is_inside_by_its_expanded_uncertainty(upper, verdict):
    judgement = judged({"result": "fx", "upper": upper})
    assert judgement.statements[0].verdict == verdict
    assert judgement.passed is (verdict == "pass")


def test_each_value_has_the_guard_band_of_its_own_coverage_factor():
    assert judged({"result": "k1", "upper": -0.097}).passed
    assert not judged({"result": "k1", "upper": -0.0971}).passed
    assert judged() is None


def test_limits_of_the_station_count_as_those_of_the_sequence():
    loose, tight = (ResultLimitConfig(result="r", lower=low) for low in (200.0, 254.9))
    judgement = conformity(calibration(), {"station": (tight,), "sequence": (loose,)}, ())
    assert [(statement.stated_by, statement.verdict) for statement in judgement.statements] == [
        ("station", "conditionalPass"),
        ("sequence", "pass"),
    ]
    assert not judgement.passed


def test_a_value_that_was_not_estimated_does_not_pass():
    judgement = judged({"result": "k2", "upper": 1.0})
    assert not judgement.passed
    assert "k2: " in conformity_sentences(judgement)[0]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"converged": False}, "The optimisation did not converge."),
        ({"failed": ["rms"]}, "The gate rms failed."),
    ],
)
def test_values_that_must_not_be_used_do_not_pass(changes, reason):
    judgement = judged({"result": "fx", "lower": 1500.0}, **changes)
    assert judgement.statements[0].verdict == "pass"
    assert not judgement.passed
    assert reason in conformity_sentences(judgement)


def test_the_words_begin_with_what_is_not_kept():
    judgement = judged(
        {"result": "fx", "lower": 1500.0},
        {"result": "r", "lower": 254.9, "upper": 300.0, "specification": "drawing 7"},
    )
    assert conformity_headline(judgement) == "FAIL: 1 of 2 limits kept."
    sentences = conformity_sentences(judgement)
    assert sentences[0].startswith("r 255.00 ± 0.20 mm (at least 254.9 and at most 300 mm by drawing 7)")
    assert sentences[1].startswith("fx 1600.0 ± 2.0 px (at least 1500 px)")
