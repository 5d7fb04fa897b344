"""Results held against those calculated again, by this program and by another, and against the simulated truth."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from report_sample import sample

from bench.evidence.findings import Findings
from bench.measure.views_file import StoredView, views_file
from bench.solve.compare_numbers import check_numbers, differences, same_stars, tolerance
from bench.solve.compare_trees import compare_views
from bench.solve.results_content import other_software, software
from bench.solve.solution import compare_with_truth
from calib.view import View
from simulators.config import bench_config


def compared(stored, again):
    """What is said of stored results beside those calculated again: faults, and what was found."""
    findings, other = Findings(), other_software(stored["run"]["software"])
    check_numbers(stored, again, findings, other, "recordings")
    return [str(fault) for fault in findings.faults], findings


def changed(results, part, name, sigmas):
    again = copy.deepcopy(results)
    again["calibration"][part][name] += sigmas * results["calibration"]["sigma"][name]
    return again


@pytest.fixture(scope="module")
def stored():
    whole = sample(size=(160, 90)).results
    whole = {**whole, "run": {**whole["run"], "software": software()}}
    return {name: value for name, value in whole.items() if name != "previous"}


@pytest.fixture(scope="module")
def by_another(stored):
    """The same results, made by another program."""
    return {**stored, "run": {**stored["run"], "software": {**software(), "program": "an earlier one"}}}


def test_the_same_numbers_are_equal_to_the_last_bit(stored):
    faults, findings = compared(stored, copy.deepcopy(stored))
    assert faults == []
    assert any("equal to the last bit" in remark for remark in findings.remarks)


@pytest.mark.parametrize(("part", "name"), [("camera", "k2"), ("collimator", "r"), ("sigma", "fx")])
def test_what_differs_by_more_than_rounding_is_told(stored, part, name):
    assert compared(stored, changed(stored, part, name, 1e-5))[0] == []
    (fault,) = compared(stored, changed(stored, part, name, 0.01))[0]
    assert f"calibration.{part}.{name} is " in fault
    assert compared(changed(stored, part, name, float("nan")), stored)[0]


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
    faults = compared(stored, again)[0]
    assert faults
    assert all(str(path[-2] if isinstance(path[-1], int) else path[-1]) in fault for fault in faults)


def test_a_part_that_follows_from_nothing_or_was_removed_is_told(stored):
    (fault,) = compared({**stored, "approved_by": "nobody"}, stored)[0]
    assert 'approved_by is "nobody", which follows from nothing' in fault
    (fault,) = compared({name: value for name, value in stored.items() if name != "gates"}, stored)[0]
    assert "gates is missing" in fault


def test_the_number_of_iterations_may_differ_by_rounding(stored):
    again = copy.deepcopy(stored)
    again["calibration"]["iterations"] += 1
    assert compared(stored, again)[0] == []


def test_what_another_program_does_not_state_is_not_compared_and_that_is_told(by_another):
    less = {name: value for name, value in by_another.items() if name != "gates"}
    faults, findings = compared(less, by_another)
    assert faults == []
    assert findings.not_compared == [
        "results.json with the recordings: another program calculated it, with differences in gates"
    ]
    assert compared(changed(by_another, "camera", "fx", 1), by_another)[
        0
    ]  # a number that both state is the same


def test_notes_of_another_program_may_have_other_words_but_not_those_of_the_same_program(stored, by_another):
    def noted(results, note):
        return {**results, "calibration": {**results["calibration"], "notes": [note]}}

    assert compared(noted(stored, "As it is."), noted(stored, "As it was."))[0]
    faults, findings = compared(noted(by_another, "As it is."), noted(by_another, "As it was."))
    assert faults == []
    assert "calibration.notes[0]" in findings.not_compared[0]
    assert not any("rounding" in remark for remark in findings.remarks)


# ---------------------------------------------------------------- how far numbers may differ
def results(fx, rms_px):
    return {"calibration": {"camera": {"fx": fx}, "sigma": {"fx": 1.0}, "rms_px": rms_px}}


def places(stored, derived):
    return [
        difference.where
        for difference in differences(stored, derived, tolerance(derived["calibration"]["sigma"]))
    ]


def test_values_may_differ_by_a_thousandth_of_their_uncertainty():
    derived = results(3345.0, 0.08)
    assert places(results(3345.0009, 0.08), derived) == []
    assert places(results(3345.0011, 0.08), derived) == ["calibration.camera.fx"]


def test_other_numbers_of_the_calibration_may_differ_by_a_millionth():
    derived = results(3345.0, 0.08)
    assert places(results(3345.0, 0.08000007), derived) == []
    assert places(results(3345.0, 0.0800001), derived) == ["calibration.rms_px"]


# ---------------------------------------------------------------- the simulated truth
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "x", "y", "r")

CALIBRATION = SimpleNamespace(
    parameter_names=NAMES, values=dict(zip(NAMES, range(1, 10), strict=True)), sigma=dict.fromkeys(NAMES, 0.5)
)


def rows(collimator: str):
    truth = bench_config({"collimator": collimator}).truth.to_dict()
    return {row["name"]: row for row in compare_with_truth(CALIBRATION, truth)}


def test_each_value_is_compared_in_its_unit_and_in_its_uncertainty():
    row_of = rows("ideal")
    assert tuple(row_of) == NAMES
    assert row_of["fx"]["error"] == pytest.approx(1.0 - 3345.06)
    assert row_of["fx"]["error_sigmas"] == pytest.approx(2 * (1.0 - 3345.06))


def test_the_apparent_centre_is_not_compared_with_that_of_an_ideal_collimator():
    assert tuple(rows("like-bench")) == ("fx", "fy", "cx", "cy", "k1", "k2", "r")


# ---------------------------------------------------------------- another program


def test_a_value_of_another_program_within_a_quarter_of_its_uncertainty_is_not_compared_beyond_it_is_a_fault(
    by_another,
):
    faults, findings = compared(by_another, changed(by_another, "camera", "fx", 0.2))
    assert faults == []
    assert findings.not_compared == [
        (
            "results.json with the recordings: another program calculated it, with differences in 1 number (fx differs "
            "most, by 0.2 of its standard uncertainty)"
        )
    ]
    (fault,), findings = compared(by_another, changed(by_another, "camera", "fx", 0.3))
    assert "calibration.camera.fx is " in fault
    assert any("the results were made with program an earlier one" in remark for remark in findings.remarks)


@pytest.mark.parametrize(
    ("factor", "faulty"), [(1.3, False), (3.9, False), (4.2, True), (0.2, True), (0.0, True)]
)
def test_an_uncertainty_may_differ_by_a_factor(by_another, factor, faulty):
    faults, findings = compared(by_another, changed(by_another, "sigma", "fx", factor - 1))
    assert bool(faults) == faulty
    assert bool(findings.not_compared) != faulty


def test_words_may_hold_other_numbers_but_not_other_words(by_another):
    had = {**by_another, "gimbal_readings": {"why_not": "They contradict the stars: chi-square 2266."}}
    for words, faulty in (("They contradict the stars: chi-square 2264.", False), ("They agree.", True)):
        assert bool(compared(had, {**had, "gimbal_readings": {"why_not": words}})[0]) == faulty


def test_facts_of_devices_have_no_excuse(by_another):
    again = copy.deepcopy(by_another)
    again["devices"]["camera"]["serial"] = "00050999"
    assert compared(by_another, again)[0]


def test_a_table_is_named_once(by_another):
    again = copy.deepcopy(by_another)
    for row in again["calibration"]["budget_rows"]:
        row["name"] = "of another name"
    faults, findings = compared(by_another, again)
    assert not faults
    assert findings.not_compared[0].count("budget_rows") == 1


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


def stored_views(*views):
    """Views named ``pose 1`` and so on, without residuals worth the name and without images."""
    named = (replace(view, name=f"pose {number}") for number, view in enumerate(views, 1))
    return [StoredView(view, np.zeros((len(view), 2))) for view in named]


def test_views_that_another_program_found_are_told_in_one_sentence(tmp_path):
    rounder = replace(view(), covariances_px2=2 * view().covariances_px2)
    (tmp_path / "views.h5").write_bytes(views_file(stored_views(rounder, rounder, view())))
    again, used = stored_views(view(), view(), view()), {**software(), "program": "an earlier one"}
    findings = Findings()
    compare_views(tmp_path / "views.h5", again, used, "recordings", findings)
    assert (findings.faults, findings.not_compared) == (
        [],
        [
            "pose 1, pose 2 of views.h5 with the recordings: another program found the stars, with other covariances"
        ],
    )
    findings = Findings()
    compare_views(
        tmp_path / "views.h5",
        again[:2] + stored_views(view(), view(), view(1.0))[2:],
        used,
        "recordings",
        findings,
    )
    assert [str(fault) for fault in findings.faults] == [
        "views.h5: the recordings of pose 3 give other image points"
    ]
