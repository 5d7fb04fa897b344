"""Two calibrations held against each other, as results.json tells them."""

import copy

import pytest
from report_sample import sample

from bench.results.reproduce import _differences_between


@pytest.fixture(scope="module")
def stored():
    return sample(size=(160, 90)).results["calibration"]


def changed(calibration, part, name, sigmas):
    again = copy.deepcopy(dict(calibration))
    again[part][name] += sigmas * calibration["sigma"][name]
    return again


def test_the_same_calibration_does_not_differ(stored):
    assert _differences_between(stored, copy.deepcopy(stored)) == []


@pytest.mark.parametrize(("part", "name"), [("camera", "k2"), ("collimator", "r"), ("sigma", "fx")])
def test_what_differs_by_more_than_rounding_is_told(stored, part, name):
    assert _differences_between(stored, changed(stored, part, name, 1e-5)) == []
    (found,) = _differences_between(stored, changed(stored, part, name, 0.01))
    assert found.startswith(f"the recordings give {name}")
    assert ("the standard uncertainty" in found) == (part == "sigma")


def test_what_is_no_number_differs(stored):
    assert _differences_between(changed(stored, "camera", "fx", float("nan")), stored) != []


def test_another_model_or_lens_is_told(stored):
    for again in ({**stored, "model": "planar"}, {**stored, "sigma": {"fx": 1.0}}):
        (found,) = _differences_between(stored, again)
        assert found.startswith(
            f"the recordings give the model {again['model']} in {', '.join(again['sigma'])}"
        )
