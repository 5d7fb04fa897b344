"""Results of another program: what it explains is not compared, and anything beyond is a fault."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from report_sample import sample

from bench.evidence.findings import Findings
from bench.results import compare_numbers
from bench.results.compare_numbers import same_stars
from bench.results.compare_trees import SeenView, tell_views
from bench.results.results_content import other_software, software
from calib.view import View


def check_numbers(stored, again, found):
    other = other_software(stored["run"]["software"])
    compare_numbers.check_numbers(stored, again, found, other, "recordings")


@pytest.fixture(scope="module")
def stored():
    whole = sample(size=(160, 90)).results
    whole = {**whole, "run": {**whole["run"], "software": {**software(), "program": "an earlier one"}}}
    return {name: value for name, value in whole.items() if name != "previous"}


def compared(stored, change):
    again = copy.deepcopy(stored)
    change(again["calibration"])
    found = Findings()
    check_numbers(stored, again, found)
    return [str(fault) for fault in found.faults], found.not_compared


def test_a_value_within_a_quarter_of_its_uncertainty_is_not_compared_and_its_size_is_told(stored):
    sigma = stored["calibration"]["sigma"]["fx"]
    faults, places = compared(
        stored,
        lambda results: results["camera"].update(fx=stored["calibration"]["camera"]["fx"] + 0.2 * sigma),
    )
    assert faults == []
    assert places == [
        (
            "results.json with the recordings: another program calculated it, with differences in 1 number (fx differs "
            "most, by 0.2 of its standard uncertainty)"
        )
    ]


def test_a_value_beyond_it_is_a_fault_and_the_program_is_named(stored):
    again = copy.deepcopy(stored)
    again["calibration"]["camera"]["fx"] += 0.3 * stored["calibration"]["sigma"]["fx"]
    found = Findings()
    check_numbers(stored, again, found)
    (fault,) = found.faults
    assert "calibration.camera.fx is " in str(fault)
    assert any("the results were made with program an earlier one" in remark for remark in found.remarks)


@pytest.mark.parametrize(
    ("factor", "faulty"), [(1.3, False), (3.9, False), (4.2, True), (0.2, True), (0.0, True)]
)
def test_an_uncertainty_may_differ_by_a_factor(stored, factor, faulty):
    faults, places = compared(
        stored, lambda results: results["sigma"].update(fx=factor * stored["calibration"]["sigma"]["fx"])
    )
    assert bool(faults) == faulty
    assert bool(places) != faulty


def test_words_may_hold_other_numbers_but_not_other_words(stored):
    had = {**stored, "gimbal_readings": {"why_not": "They contradict the stars: chi-square 2266."}}
    for words, faulty in (("They contradict the stars: chi-square 2264.", False), ("They agree.", True)):
        found = Findings()
        check_numbers(had, {**had, "gimbal_readings": {"why_not": words}}, found)
        assert bool(found.faults) == faulty


def test_facts_of_devices_have_no_excuse(stored):
    found = Findings()
    again = copy.deepcopy(stored)
    again["devices"]["camera"]["serial"] = "00050999"
    check_numbers(stored, again, found)
    assert found.faults


def test_a_table_is_named_once(stored):
    again = copy.deepcopy(stored)
    for row in again["calibration"]["budget_rows"]:
        row["name"] = "of another name"
    found = Findings()
    check_numbers(stored, again, found)
    assert not found.faults
    assert found.not_compared[0].count("budget_rows") == 1


def view(shift_px=0.0, count=100):
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 700, (100, 2))[:count] + shift_px
    targets, covariances = rng.uniform(0, 100, (100, 2))[:count], np.tile(np.eye(2), (count, 1, 1))
    return View("pose 1", (1280, 720), np.arange(count), points, targets, covariances)


@pytest.mark.parametrize(
    ("other", "same"),
    [(view(0.01), True), (view(0.03), False), (view(count=99), True), (view(count=90), False)],
)
def test_stars_of_another_program_lie_at_the_same_places(other, same):
    assert same_stars(view(), other) == same


def test_views_that_another_program_found_are_told_in_one_sentence():
    found = Findings()
    seen = [
        SeenView("pose 1", ["other covariances"], True),
        SeenView("pose 2", ["other covariances"], True),
        SeenView("pose 3", [], True),
    ]
    tell_views(seen, "recordings", found)
    assert found.not_compared == [
        "pose 1, pose 2 of views.h5 with the recordings: another program found the stars, with other covariances"
    ]
    tell_views([replace(seen[0], excused=False)], "recordings", found)
    assert [str(fault) for fault in found.faults] == [
        "views.h5: the recordings of pose 1 give other covariances"
    ]
