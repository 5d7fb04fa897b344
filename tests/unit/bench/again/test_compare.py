"""Results held against those calculated again, by this program and by another, and against the simulated truth."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest
from report_sample import sample

from bench.again.compare import differences, judge, limits_of_values
from bench.again.files import maker_of
from bench.base.bounded_json import canonical_json, parse_json
from bench.evidence.findings import Findings
from bench.record.coverage import coverage_factor
from bench.solve.results_content import software
from bench.solve.solution import compare_with_truth
from calib.calibration import ENGINES
from simulators.config import bench_config
from tests.unit.bench.evidence.attack_steps import set_at


def compared(stored, again):
    """What is said of stored results beside those made again: faults, and what was found."""
    findings = Findings()
    maker = maker_of(stored, stored["run"]["software"])
    found = differences(stored, again, limits_of_values(again["calibration"]))
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


def with_u(results, name, share):
    """The results with a value moved by a share of its U."""
    calibration = results["calibration"]
    k = coverage_factor(calibration, name)
    return changed(results, "camera", name, share * k)


@pytest.mark.parametrize("made_by", ["stored", "by_another", "of_another_engine"])
def test_a_value_within_a_tenth_of_its_u_is_confirmed_whatever_version_made_it(request, made_by):
    results = request.getfixturevalue(made_by)
    faults, findings = compared(results, with_u(results, "fx", 0.09))
    assert (faults, findings.not_confirmed) == ([], [])


@pytest.mark.parametrize("made_by", ["stored", "by_another"])
def test_a_value_farther_off_is_a_fault_of_the_same_engine_with_both_numbers(request, made_by):
    results = request.getfixturevalue(made_by)
    again = with_u(results, "fx", 0.11)
    (fault,), findings = compared(results, again)
    for made in (results, again):
        assert f"{made['calibration']['camera']['fx']:.12g}" in fault
    assert findings.not_confirmed == []


def test_a_value_farther_off_is_not_confirmed_if_another_engine_made_it(of_another_engine):
    again = with_u(of_another_engine, "fx", 0.11)
    faults, findings = compared(of_another_engine, again)
    (what,) = findings.not_confirmed
    assert faults == []
    for made in (of_another_engine, again):
        assert f"{made['calibration']['camera']['fx']:.12g}" in what
    assert "pip install starbench==" in what


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


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("calibration", "rms_px"), 0.2),
        (("calibration", "camera", "fx"), float("nan")),
        (("calibration", "notes"), []),
        (("poses", 0, "stars"), 1),
        (("devices", "camera", "serial"), "00050999"),
    ],
)
def test_every_other_value_is_compared_too(stored, path, value):
    again = copy.deepcopy(stored)
    set_at(again, path, value)
    faults = compared(stored, again)[0]
    assert faults
    assert all(str(path[-2] if isinstance(path[-1], int) else path[-1]) in fault for fault in faults)


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
