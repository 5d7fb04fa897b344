"""Results held against those calculated again and against the simulated truth: rounding counts as equal."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest
from report_sample import sample

from bench.evidence.findings import Findings
from bench.results import compare_numbers
from bench.results.compare_numbers import differences, tolerance
from bench.results.results_content import other_software, software
from bench.results.solution import compare_with_truth
from simulators.config import bench_config


def check_numbers(stored, again, found):
    other = other_software(stored["run"]["software"])
    compare_numbers.check_numbers(stored, again, found, other, "recordings")


@pytest.fixture(scope="module")
def stored():
    whole = sample(size=(160, 90)).results
    whole = {**whole, "run": {**whole["run"], "software": software()}}
    return {name: value for name, value in whole.items() if name != "previous"}


def seen(stored, again):
    found = Findings()
    check_numbers(stored, again, found)
    return [str(fault) for fault in found.faults], found.remarks


def changed(results, part, name, sigmas):
    again = copy.deepcopy(results)
    again["calibration"][part][name] += sigmas * results["calibration"]["sigma"][name]
    return again


def test_the_same_numbers_are_equal_to_the_last_bit(stored):
    faults, remarks = seen(stored, copy.deepcopy(stored))
    assert faults == []
    assert any("equal to the last bit" in remark for remark in remarks)


@pytest.mark.parametrize(("part", "name"), [("camera", "k2"), ("collimator", "r"), ("sigma", "fx")])
def test_what_differs_by_more_than_rounding_is_told(stored, part, name):
    assert seen(stored, changed(stored, part, name, 1e-5))[0] == []
    (fault,) = seen(stored, changed(stored, part, name, 0.01))[0]
    assert f"calibration.{part}.{name} is " in fault


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("calibration", "rms_px"), 0.081),
        (("calibration", "covariance", "matrix", 0, 0), 0.5),
        (("calibration", "notes"), []),
        (("calibration", "degrees_of_freedom"), 7),
        (("poses", 0, "stars"), 1),
        (("run", "simulated"), False),
        (("devices", "camera", "serial"), "00050999"),
    ],
)
def test_every_other_value_is_compared_too(stored, path, value):
    again = copy.deepcopy(stored)
    part = again
    for key in path[:-1]:
        part = part[key]
    assert part[path[-1]] != value
    part[path[-1]] = value
    faults = seen(stored, again)[0]
    assert faults
    assert all(str(path[-2] if isinstance(path[-1], int) else path[-1]) in fault for fault in faults)


def test_what_is_no_number_differs(stored):
    assert seen(changed(stored, "camera", "fx", float("nan")), stored)[0]


def test_a_part_that_follows_from_nothing_is_told(stored):
    (fault,) = seen({**stored, "approved_by": "nobody"}, stored)[0]
    assert 'approved_by is "nobody", which follows from nothing' in fault


def test_a_removed_part_is_told(stored):
    less = {name: value for name, value in stored.items() if name != "gates"}
    (fault,) = seen(less, stored)[0]
    assert "gates is missing" in fault


def test_the_number_of_iterations_may_differ_by_rounding(stored):
    again = copy.deepcopy(stored)
    again["calibration"]["iterations"] += 1
    assert seen(stored, again)[0] == []


def test_what_another_program_does_not_state_is_not_compared_and_that_is_told(stored):
    other = {**stored, "run": {**stored["run"], "software": {**software(), "program": "another"}}}
    less = {name: value for name, value in other.items() if name != "gates"}
    found = Findings()
    check_numbers(less, other, found)
    assert found.faults == []
    assert found.not_compared == [
        "results.json with the recordings: another program calculated it, with differences in gates"
    ]
    assert seen(changed(other, "camera", "fx", 1), other)[0]  # a number that both state must be the same


def test_notes_of_another_program_may_have_other_words_but_not_those_of_the_same_program(stored):
    other = {**stored, "run": {**stored["run"], "software": {**software(), "program": "another"}}}
    for had, is_fault in ((stored, True), (other, False)):
        reworded = copy.deepcopy(had)
        had["calibration"]["notes"], reworded["calibration"]["notes"] = ["As it was."], ["As it is."]
        found = Findings()
        check_numbers(reworded, had, found)
        assert bool(found.faults) == is_fault
        if not is_fault:
            assert "calibration.notes[0]" in found.not_compared[0]
            assert not any("rounding" in remark for remark in found.remarks)


# ---------------------------------------------------------------- how far numbers may differ


def results(fx, planar_fx, rms_px):
    return {
        "calibration": {"camera": {"fx": fx}, "sigma": {"fx": 1.0}, "rms_px": rms_px},
        "planar": {"camera": {"fx": planar_fx}, "sigma": {"fx": 40.0}, "rms_px": 0.3},
    }


def places(stored, derived):
    equal = tolerance(derived["calibration"]["sigma"], derived["planar"]["sigma"])
    return [one.where for one in differences(stored, derived, equal)]


def test_values_may_differ_by_a_thousandth_of_their_uncertainty_and_planar_ones_by_a_hundredth():
    derived = results(3345.0, 3300.0, 0.08)
    assert places(results(3345.0009, 3300.39, 0.08), derived) == []
    assert places(results(3345.0011, 3300.41, 0.08), derived) == ["calibration.camera.fx", "planar.camera.fx"]


def test_other_numbers_of_the_calibration_may_differ_by_a_millionth():
    derived = results(3345.0, 3300.0, 0.08)
    assert places(results(3345.0, 3300.0, 0.08000007), derived) == []
    assert places(results(3345.0, 3300.0, 0.0800001), derived) == ["calibration.rms_px"]


# ---------------------------------------------------------------- the simulated truth

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "x", "y", "r")

CALIBRATION = SimpleNamespace(
    parameter_names=NAMES, values=np.arange(1.0, 10.0), sigma=dict.fromkeys(NAMES, 0.5)
)


def rows(collimator: str):
    truth = bench_config({"collimator": collimator}).truth.to_dict()
    return {row["name"]: row for row in compare_with_truth(CALIBRATION, truth)}


def test_each_value_is_compared_in_its_unit_and_in_its_uncertainty():
    found = rows("ideal")
    assert tuple(found) == NAMES
    assert found["fx"]["error"] == pytest.approx(1.0 - 3345.06)
    assert found["fx"]["error_sigmas"] == pytest.approx(2 * (1.0 - 3345.06))


def test_the_apparent_centre_is_not_compared_with_that_of_an_ideal_collimator():
    assert tuple(rows("like-bench")) == ("fx", "fy", "cx", "cy", "k1", "k2", "r")
