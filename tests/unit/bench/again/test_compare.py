"""Results held against those calculated again, by this program and by another, and against the simulated truth."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest
from report_sample import sample

from bench.again.compare import differences, judge
from bench.again.files import maker_of
from bench.again.limits import OF_RECORDING, rules_of_results
from bench.base.bounded_json import canonical_json, parse_json
from bench.evidence.findings import Findings
from bench.solve.results_content import software
from bench.solve.solution import compare_with_truth
from calib.calibration import ENGINES
from simulators.config import bench_config
from tests.unit.bench.evidence.attack_steps import set_at

K = 2.0


def compared(stored, again):
    """What is said of stored results beside those made again: faults, and what was found."""
    findings = Findings()
    maker = maker_of(stored, stored["run"]["software"])
    found = differences(stored, again, rules_of_results(again))
    judge("results", "results.json", found, maker, findings)
    return [str(fault) for fault in findings.faults], findings


def changed(results, part, name, sigmas):
    again = copy.deepcopy(results)
    again["calibration"][part][name] += sigmas * results["calibration"]["sigma"][name]
    return again


@pytest.fixture(scope="module")
def stored():
    whole = parse_json(canonical_json(sample(size=(160, 90)).results))
    whole = {**whole, "run": {**whole["run"], "software": software()}}
    whole["calibration"] = {**whole["calibration"], "engine": {"name": "joint", "version": ENGINES["joint"]}}
    return {name: value for name, value in whole.items() if name != "previous"}


@pytest.fixture(scope="module")
def by_another(stored):
    """The same results, made by another program."""
    return {**stored, "run": {**stored["run"], "software": {**software(), "program": "an earlier one"}}}


@pytest.fixture(scope="module")
def of_another_engine(by_another):
    """The same results, made by another program with another engine."""
    calibration = {**by_another["calibration"], "engine": {"name": "joint", "version": -1}}
    return {**by_another, "calibration": calibration}


@pytest.mark.parametrize("made_by", ["stored", "by_another", "of_another_engine"])
def test_a_value_within_a_tenth_of_its_u_is_confirmed_and_another_a_fault_of_the_same_engine(
    request, made_by
):
    results = request.getfixturevalue(made_by)
    faults, findings = compared(results, changed(results, "camera", "fx", 0.09 * K))
    assert (faults, findings.not_confirmed) == ([], [])
    again = changed(results, "camera", "fx", 0.11 * K)
    faults, findings = compared(results, again)
    (what,) = faults + findings.not_confirmed
    assert bool(faults) is (made_by != "of_another_engine") is ("pip install starbench==" not in what)
    assert all(f"{made['calibration']['camera']['fx']:.12g}" in what for made in (results, again))


@pytest.mark.parametrize(
    ("factor", "is_told"),
    [(1.04, False), (1.06, True), (0.96, False), (0.94, True), (1 / 3, True), (0.0, True)],
)
def test_an_uncertainty_may_differ_by_a_twentieth(by_another, factor, is_told):
    assert bool(compared(by_another, changed(by_another, "sigma", "fx", factor - 1))[0]) == is_told


def test_a_covariance_is_compared_in_units_of_its_sigmas(stored):
    again = copy.deepcopy(stored)
    matrix = np.array(again["calibration"]["covariance"]["matrix"])
    for factor, is_told in ((1.08, False), (1.12, True), (1 / 9, True)):
        again["calibration"]["covariance"]["matrix"] = (matrix * factor).tolist()
        assert bool(compared(stored, again)[0]) == is_told


CERTIFICATE = {"stated": 255.0, "sigma": 0.05, "expected": 254.8, "expected_sigma": 0.2, "innovation": 0.01}
LIMIT = {"result": "fx", "lower": 3340.0, "upper": None, "value": 3346.0, "expanded": 4.3}
PREVIOUS = {"calibration": {"camera": {"fx": 3345.0}}, "change": {"rms_px": 0.01, "largest_ratio": 0.02}}
GIMBAL = {"values": {"mounting_x": 2e-4}, "sigma": {"mounting_x": 0.025}}


@pytest.mark.parametrize(
    ("path", "value", "is_told"),
    [
        (("run", "collimator", "nominal_r_mm"), 255.00001, True),
        (("passport", "values", "r"), 255.04, True),
        (("poses", 0, "measured_deg", "pan"), 1.70003, True),
        (("poses", 0, "stars"), 1, True),
        (("devices", "camera", "serial"), "00050999", True),
        (("conformity", "statements", 0, "lower"), 3340.1, True),
        (("conformity", "statements", 0, "value"), 3346.5, True),
        (("calibration", "rms_px"), 0.2, True),
        (("calibration", "camera", "fx"), float("nan"), True),
        (("calibration", "notes"), [], True),
        (("calibration", "witnesses", 0, "stated"), 255.04, True),
        (("calibration", "witnesses", 0, "stated"), 255.001, False),  # in the unit of r
        (("calibration", "witnesses", 0, "innovation"), 0.014, False),
        (("calibration", "gimbal", "values", "mounting_x"), 2.2e-4, False),
        (("calibration", "gimbal", "values", "mounting_x"), 0.006, True),
        (("calibration", "views", 0, "rotation", 0, 1), 1e-5, False),
        (("calibration", "views", 0, "rotation", 0, 0), 1.001, True),
        (("calibration", "views", 0, "centre_mm", 0), 96.02, False),
        (("calibration", "views", 0, "centre_mm", 0), 96.03, True),
        (("gimbal", "scale", "pan_deg"), 1.00003, True),
        (("previous", "change", "rms_px"), 0.013, False),
        (("previous", "change", "rms_px"), 2.0, True),
        (("previous", "change", "largest_ratio"), 0.2, True),
        (("previous", "calibration", "camera", "fx"), 3345.001, True),
    ],
)
def test_what_is_copied_may_not_differ_and_what_has_a_u_by_a_tenth_of_it(stored, path, value, is_told):
    """What may differ does by less on other processors and with other threads."""
    again = {**stored, "conformity": {"statements": [LIMIT]}, "previous": PREVIOUS}
    again["calibration"] = {**stored["calibration"], "witnesses": [CERTIFICATE], "gimbal": GIMBAL}
    had = copy.deepcopy(again)
    set_at(had, path, value)
    faults = compared(had, again)[0]
    assert bool(faults) is is_told
    assert all(str([part for part in path if isinstance(part, str)][-1]) in fault for fault in faults)


def test_a_plan_is_exact_and_of_a_recording_all_but_what_its_pixels_give():
    had, due = ({"flicker_hz": hz, "motion_px": px} for hz, px in ((60.0, 0.0005), (60.01, 0.0006)))
    assert [seen.where for seen in differences(had, due)] == ["flicker_hz", "motion_px"]
    seen = differences({"measured": had}, {"measured": due}, OF_RECORDING, "pose 1 attempt 1")
    assert [each.where for each in seen] == ["pose 1 attempt 1.measured.flicker_hz"]


def test_a_part_that_follows_from_nothing_or_was_removed_is_told(stored):
    (fault,) = compared({**stored, "approved_by": "nobody"}, stored)[0]
    assert "approved_by" in fault
    (fault,) = compared({name: value for name, value in stored.items() if name != "gates"}, stored)[0]
    assert "gates" in fault


@pytest.mark.parametrize(
    "change",
    [
        lambda results: results.pop("gates"),
        lambda results: results["calibration"].update(notes=["It was otherwise."]),
    ],
)
def test_other_parts_and_sentences_of_another_program_are_not_confirmed_of_the_same_a_fault(
    stored, by_another, change
):
    for results, is_fault in ((stored, True), (by_another, False)):
        had, due = copy.deepcopy(results), copy.deepcopy(results)
        due["calibration"]["notes"] = ["It was so."]
        had["calibration"]["notes"] = ["It was so."]
        change(had)
        faults, findings = compared(had, due)
        assert (bool(faults), bool(findings.not_confirmed)) == (is_fault, not is_fault)


def test_the_number_of_iterations_may_differ_by_rounding(stored):
    again = copy.deepcopy(stored)
    again["calibration"]["iterations"] += 1
    assert compared(stored, again)[0] == []


# ---------------------------------------------------------------- the simulated truth
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "x", "y", "r")

CALIBRATION = SimpleNamespace(
    parameter_names=NAMES, values=dict(zip(NAMES, range(1, 10), strict=True)), sigma=dict.fromkeys(NAMES, 0.5)
)


def rows(collimator: str):
    truth = bench_config({"collimator": collimator}).truth.to_dict()
    return {row.name: row for row in compare_with_truth(CALIBRATION, truth)}


def test_each_value_is_compared_in_its_unit_and_in_its_uncertainty():
    row_of = rows("ideal")
    assert tuple(row_of) == NAMES
    assert row_of["fx"].error == pytest.approx(1.0 - 3345.06)
    assert row_of["fx"].error_sigmas == pytest.approx(2 * (1.0 - 3345.06))


def test_the_apparent_centre_is_not_compared_with_that_of_an_ideal_collimator():
    assert tuple(rows("like-bench")) == ("fx", "fy", "cx", "cy", "k1", "k2", "r")
