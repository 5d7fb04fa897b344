"""Results held against those calculated again: rounding counts as equal, anything else is told with its place."""

import copy

import pytest
from report_sample import sample

from bench.evidence.findings import Findings
from bench.results import compare_numbers
from bench.results.results_content import other_software, software


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
