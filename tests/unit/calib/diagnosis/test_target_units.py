"""Target positions in another unit than millimetres."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.target_units import check_target_units, closed_form_radius
from tests.unit.calib.conftest import Bench

UNITS = [("metres", 1000.0), ("centimetres", 10.0), ("inches", 25.4), ("micrometres", 0.001)]


@pytest.fixture
def views():
    return Bench().views(np.random.default_rng(1), 0.02)


def in_unit(views, length_mm):
    return [replace(view, target_mm=view.target_mm / length_mm) for view in views]


@pytest.mark.parametrize(("unit", "length"), UNITS)
def test_a_known_radius_names_the_unit(views, unit, length):
    for r_mm in (None, 255.0 / length):
        found = check_target_units(in_unit(views, length), r_mm=r_mm, known_r_mm=255.0)
        assert found.unit == unit
        assert f"The target positions look like {unit}; give them in mm." in found.sentence


@pytest.mark.parametrize(("unit", "length"), [("metres", 1000.0), ("micrometres", 0.001)])
def test_an_implausible_pitch_needs_no_known_radius(views, unit, length):
    assert check_target_units(in_unit(views, length)).unit == unit


@pytest.mark.parametrize("length", [25.4, 10.0])
def test_inches_without_a_known_radius_cannot_be_noticed(views, length):
    assert check_target_units(in_unit(views, length)) is None


def test_an_implausible_radius_is_noticed(views):
    found = check_target_units(views, r_mm=3.0)
    assert found.unit == ""
    assert found.sentence.endswith("Check that the target positions are in mm.")
    assert check_target_units(views, r_mm=0.255).unit == "metres"
    assert check_target_units(views, r_mm=2.55e5).unit == "micrometres"


@pytest.mark.parametrize("known", [None, 255.0, 200.0, 300.0])
def test_millimetres_are_not_doubted(views, known):
    assert check_target_units(views, known_r_mm=known) is None


def test_one_view_has_no_closed_form_and_no_doubt(views):
    assert closed_form_radius(views[:1]) is None
    assert check_target_units(views[:1], known_r_mm=255.0) is None
