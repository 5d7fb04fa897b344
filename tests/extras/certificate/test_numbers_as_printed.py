"""A certificate's numbers and words: what a reader can calculate again, and its JSON."""

import copy
import dataclasses
import json
import math
import re
from decimal import Decimal

import pytest
from certificate_sample import LAB, full_certificate, identity, sample_lab, small_certificate
from hypothesis import example, given
from hypothesis import strategies as st
from report_sample import BORESIGHT, STORED
from scipy import stats
from sealed_bench import sample_results

from bench.base.errors import EvidenceError
from bench.extras.certificate.budget_rows import budget_of, expanded, print_result
from bench.extras.certificate.certificate_data import Certificate
from bench.extras.certificate.compose import compose
from bench.extras.certificate.facts_of_run import further_of, results_of
from bench.extras.certificate.lab_config import LabRuleConfig
from bench.extras.certificate.limits import passes_over_fail
from bench.record.conformity import conformity, verdict_of
from bench.record.stored_calibration import stored_calibration
from bench.wording.numbers import round_expanded, with_uncertainty
from sequences.schema import ResultLimitConfig

EXPANDED = st.floats(min_value=1e-9, max_value=1e9)


@given(st.floats(min_value=-1e9, max_value=1e9), EXPANDED)
@example(640.02, 2.24)
@example(1.0, 9.99)
@example(1.0, 0.0995)
@example(1.0, 2.4106)
def test_report_and_certificate_print_the_same_numbers(value, expanded_value):
    texts = tuple(text.replace("\N{MINUS SIGN}", "-") for text in with_uncertainty(value, expanded_value))
    assert texts == print_result(value, expanded_value)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_what_is_no_uncertainty_is_refused(bad):
    with pytest.raises(ValueError, match=str(bad)):
        round_expanded(bad)


@given(
    st.decimals(-100, 100, places=2), st.decimals("0.01", 20, places=2), st.floats(-50, 0), st.floats(0.1, 50)
)
def test_verdicts_follow_the_guard_band(value, band, lower, upper):
    verdict = verdict_of(str(value), str(band), lower, upper)
    inside = min(Decimal(repr(upper)) - value, value - Decimal(repr(lower)))
    assert (verdict in ("pass", "conditionalPass")) == (inside >= 0)
    assert (verdict in ("pass", "fail")) == (inside >= band or inside < -band)


def test_one_limit_alone_is_enough():
    assert verdict_of("5", "1", None, 6.0) == "pass"
    assert verdict_of("5", "1", 5.5, None) == "conditionalFail"


SYMBOLS = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"]


@pytest.mark.parametrize("symbol", SYMBOLS)
def test_a_reader_can_calculate_every_uncertainty_from_the_rows(symbol):
    """By the formula of the GUM: u from the rows. k is that of the posterior, which has no degrees of freedom."""
    certificate = full_certificate()
    result = next(result for result in certificate.results if result.symbol == symbol)
    budget = next(budget for budget in certificate.budgets if budget.symbol == symbol)
    stated = sample_results()["calibration"]
    assert math.sqrt(sum(row.u**2 for row in budget.rows)) == pytest.approx(result.u, rel=1e-6)
    assert {row.nu for row in budget.rows} == {None}
    assert (result.nu_eff, result.k) == (None, pytest.approx(stated["coverage_factors"][symbol], rel=1e-8))
    assert float(round_expanded(result.k * result.u)) == result.U
    assert sum(row.share for row in budget.rows) == pytest.approx(1.0)
    assert result.u == pytest.approx(stated["sigma"][symbol], rel=1e-8)


@pytest.mark.parametrize(("k", "nu"), [(2.2215, 12.48), (2.0009, None)])
def test_a_method_of_reference_has_one_k_of_students_distribution_for_all_values(k, nu):
    def of_reference(calibration):
        variances = {symbol: sigma**2 for symbol, sigma in calibration["sigma"].items()}
        parts = {"stars": 0.2, "disagreement of the views": 0.8}
        budget = {name: {s: (part * v) ** 0.5 for s, v in variances.items()} for name, part in parts.items()}
        rows = [row for row in calibration["budget_rows"] if row.name in parts]
        calibration.update(coverage_factors={}, coverage_factor=k, budget=budget, budget_rows=rows)

    calibration = changed(of_reference)
    for symbol in SYMBOLS:
        result, budget = expanded(calibration, symbol), budget_of(calibration, symbol, "px", {}, 1.0)
        assert (result.u, result.k) == (calibration["sigma"][symbol], k)
        assert (
            [row.nu for row in budget.rows] == [budget.nu_eff] * 2 == [nu and pytest.approx(nu, rel=1e-3)] * 2
        )
        assert nu is None or stats.t.ppf(0.97725, result.nu_eff) == pytest.approx(k, rel=1e-6)
        assert any("as one row" in remark for remark in budget.remarks) == (nu is not None)


def test_a_stated_value_has_the_degrees_of_freedom_that_are_stated_with_it():
    def stated(calibration):
        calibration["budget_rows"] = [
            dataclasses.replace(row, degrees_of_freedom=8) if row.name == "scale of the print" else row
            for row in calibration["budget_rows"]
        ]

    budget = budget_of(changed(stated), "fx", "px", {}, 2.0)
    assert {row.name: row.nu for row in budget.rows if row.nu is not None} == {"scale of the print": 8.0}


def test_rows_name_their_certificates():
    fx = full_certificate().budgets[0]
    known = {row.name: (row.number, row.date) for row in fx.rows if row.number}
    print_scale = ("R-17", "2026-01-08")
    passport = ("SIM-2026-01", "2026-01-12")
    assert known == {"passport of the collimator": passport, "scale of the print": print_scale}


def test_of_a_coefficient_a_row_of_a_single_source_states_its_value_with_its_certificate():
    """The engine splits the variance of k1 by groups alone; certificates belong to single sources."""
    k1 = next(budget for budget in full_certificate().budgets if budget.symbol == "k1")
    rows = {row.name: row for row in k1.rows}
    passport = rows["passport of the collimator"]
    assert (passport.value, passport.number) == (0.1, "SIM-2026-01")
    assert rows["scale of the print"].value == 2e-5
    variances = sample_results()["calibration"]["budget"]
    ratio = rows["scale of the print"].u / passport.u
    by_engine = variances["scale of the print"]["k1"] / variances["passport of the collimator"]["k1"]
    assert ratio == pytest.approx(by_engine, rel=1e-6)
    assert (rows["stars"].type, rows["effective radius"].type) == ("A", "B")


def changed(change):
    calibration = copy.deepcopy(sample_results()["calibration"])
    change(calibration)
    return calibration


def changed_data(change):
    content = json.loads(full_certificate().to_json())
    change(content)
    return json.dumps(content).encode()


def test_rows_that_do_not_add_up_and_results_without_a_budget_are_refused():
    wrong = changed(lambda c: c["budget"]["stars"].update(fx=0.1))
    with pytest.raises(EvidenceError, match=r"fx give u = 0\.\d+ px, .* 0\.9613"):
        budget_of(wrong, "fx", "px", {}, 2.4)
    with pytest.raises(EvidenceError, match="fx give u = 0 px"):
        budget_of(changed(lambda c: c.update(budget={})), "fx", "px", {}, 2.4)


def test_data_of_the_customer_mark_the_results_that_depend_on_them():
    text = LAB.replace('data sheet of the camera."}', 'data sheet of the camera.", results: [k1]}')
    certificate = compose(sample_results(), sample_lab(text).value, identity())
    assert [result.symbol for result in certificate.results if result.customer_supplied] == ["k1"]
    assert "customer" in certificate.statement("customer_data")
    assert dataclasses.replace(certificate) == certificate


def run_with_limits(*limits):
    """The results of the sample, whose run states these limits, and a laboratory that states none."""
    results = copy.deepcopy(sample_results())
    rules = [ResultLimitConfig(**limit) for limit in limits]
    results["conformity"] = conformity(stored_calibration(results["calibration"]), {"sequence": rules}, [])
    head, _, rest = LAB.partition("decision_rules:\n")
    text = f"{head}decision_rules: none\n{rest[rest.index('previous_certificate') :]}"
    return results, sample_lab(text).value


def test_the_limits_of_the_run_are_stated_where_the_laboratory_states_no_others():
    results, lab = run_with_limits(
        {"result": "fx", "upper": 3350.0}, {"result": "r", "lower": 9999.0}, {"result": "cx", "lower": 9999.0}
    )
    certificate = compose(results, lab, identity())
    stated = {statement.result: statement.verdict for statement in results["conformity"].statements}
    assert [(statement.symbol, statement.verdict) for statement in certificate.conformity] == [
        ("fx", stated["fx"]), ("cx", "fail"),
    ]  # fmt: skip
    assert "sequence" in certificate.conformity[0].specification
    assert [statement.specification for statement in compose(sample_results(), sample_lab().value, identity()).conformity] == [
        "Customer drawing 4711, focal length", "Customer drawing 4711",
    ]  # fmt: skip


def test_limits_of_a_value_that_the_run_did_not_determine_are_not_left_out_in_silence():
    results, lab = run_with_limits({"result": "kb1", "upper": 1.0, "specification": "drawing 4711"})
    deviations = compose(results, lab, identity()).deviations
    texts = [deviation.text for deviation in deviations if deviation.source == "run"]
    assert any(re.match("kb1: .* 1 by drawing 4711", text) for text in texts)


def test_limits_of_the_collimator_that_the_run_does_not_keep_are_deviations():
    results, lab = run_with_limits({"result": "r", "lower": 9999.0}, {"result": "r", "lower": 1.0})
    certificate = compose(results, lab, identity())
    assert certificate.conformity == ()
    (text,) = [deviation.text for deviation in certificate.deviations if deviation.text.startswith("r ")]
    assert "outside by more than U" in text


def with_own_limits(results, lab, *limits):
    rules = tuple(LabRuleConfig(**limit) for limit in limits)
    return results, lab.model_copy(update={"decision_rules": rules})


WIDE = {"result": "fx", "specification": "drawing 4711", "lower": 3300.0, "upper": 3400.0}


def test_limits_that_the_laboratory_states_as_the_run_does_stand_there_once():
    results, lab = run_with_limits({"result": "fx", "lower": 3300.0, "upper": 3400.0})
    results, lab = with_own_limits(results, lab, WIDE)
    certificate = compose(results, lab, identity())
    assert [statement.specification for statement in certificate.conformity] == ["drawing 4711"]
    assert passes_over_fail(results, lab, certificate.conformity) == []


def test_the_runs_of_the_camera_before_this_one_are_counted_as_in_the_report():
    results = copy.deepcopy(sample_results())
    results["run"]["ledger"] = {
        "number": 9, "head": "ab" * 32, "of_camera": {"failed": 2, "finished": 1, "open": 2}, "faults": ["x"],
    }  # fmt: skip
    text = compose(results, sample_lab().value, identity()).statement("earlier_runs")
    assert "2 failed, 1 finished, 1 without" in text
    assert "break" in text
    results["run"].pop("ledger")
    assert compose(results, sample_lab().value, identity()).statement("earlier_runs") == ""


# ---------------------------------------------------------------- JSON


@pytest.mark.parametrize("make", [full_certificate, small_certificate])
def test_comes_back_the_same(make):
    certificate = make()
    data = certificate.to_json()
    assert Certificate.from_json(data) == certificate
    assert Certificate.from_json(data).to_json() == data


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda c: c.pop("number"), "number is missing"),
        (lambda c: c.update(numbr="x"), "numbr is unknown"),
        (lambda c: c["customer"]["address"].pop("street"), r"customer\.address\.street is missing"),
        (lambda c: c["item"]["lens"].update(colour="x"), r"item\.lens\.colour is unknown"),
        (lambda c: c["laboratory"]["address"].update(country="Germany"), r"laboratory\.address\.country"),
        (lambda c: c["results"][2].update(U="2.9"), r"results\[2\].U must be a finite number"),
        (lambda c: c["results"][0].update(value=True), r"results\[0\].value must be a finite number"),
        (lambda c: c["conformity"][0].update(verdict="passed"), "one of pass, conditionalPass"),
        (lambda c: c.update(results={}), "results must be a list"),
        (lambda c: c.update(format="starbench/certificate/2"), "format must be one of"),
        (lambda c: c["covariance"].update(matrix=[[None]]), r"covariance.matrix\[0\]\[0\]"),
    ],
)
def test_refuses_what_is_not_of_this_form_and_names_it(change, named):
    with pytest.raises(EvidenceError, match=named):
        Certificate.from_json(changed_data(change))


@pytest.mark.parametrize("text", [b"", b"[]", b"{", b'{"a":1,"a":2}', b"\xff", b"[" * 100_000, b"null"])
def test_refuses_what_is_no_json_mapping(text):
    with pytest.raises(EvidenceError):
        Certificate.from_json(text)


def test_refuses_numbers_that_are_not_finite():
    with pytest.raises(EvidenceError, match="NaN"):
        Certificate.from_json(changed_data(lambda c: c["results"][0].update(value=float("nan"))))
    full = full_certificate()
    broken = dataclasses.replace(full, results=(dataclasses.replace(full.results[0], value=float("inf")),))
    with pytest.raises(ValueError, match="Out of range"):
        broken.to_json()


def test_the_certificate_states_the_boresight_with_its_u():
    results = copy.deepcopy(sample_results())
    results["calibration"].pop("boresight")
    before = further_of(results)
    results["calibration"]["boresight"] = BORESIGHT.to_dict()
    stated = {further.id: further for further in further_of(results)}
    assert {further.id for further in before} < set(stated)
    assert (stated["boresight_y"].text, stated["boresight_y"].unit) == ("-1.250 deg", "deg")
    assert stated["boresight_y_expanded"].text == "0.046 deg"
    assert stated["boresight_down"].value == pytest.approx(-0.573, abs=1e-3)


def test_a_certificate_states_the_skew_in_pixels_and_coefficients_as_pure_numbers():
    calibration = STORED["calibration"]
    camera, sigma = ({**calibration[key], "skew": 0.1} for key in ("camera", "sigma"))
    stated = results_of({**STORED, "calibration": {**calibration, "camera": camera, "sigma": sigma}})
    units = {result.symbol: result.unit for result in stated}
    assert (units["skew"], units["fx"], units["k1"]) == ("px", "px", "1")
