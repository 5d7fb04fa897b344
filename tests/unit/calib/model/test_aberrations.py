"""Aberrations of real collimators, as displacements."""

import itertools

import numpy as np
import pytest

from calib.errors import InputMismatch
from calib.model.aberrations import EXPECTED_SIGMA, LADDER, displacements, needs_rim
from calib.model.beam import Disc

REFERENCE = (10.0, 20.0, 250.0)
DISC = Disc(np.array([15.0, 18.0]), 50.0, 0.3)
POINTS = np.array([[10.0, 20.0], [60.0, 20.0], [30.0, -10.0], [65.0, 18.0]])


def shift(term):
    return displacements(POINTS, DISC, REFERENCE, [term])[:, :, 0]


def test_the_pupil_shifts_all_points_alike_along_the_disc():
    assert np.allclose(shift("pupil_shift"), [5.0, -2.0])


def test_distortion_is_radial_about_the_reference_and_cubic():
    assert np.allclose(shift("radial")[0], 0.0)
    assert np.allclose(shift("radial")[1], [50.0 * (50 / 250) ** 2, 0.0])


def test_tilt_grows_along_its_own_axis_only():
    assert np.allclose(shift("tilt_x")[1], np.array([5.0, -2.0]) * 50 / 250)
    assert np.allclose(shift("tilt_y")[1], 0.0)


def test_rim_terms_act_at_the_rim_along_the_discs_radius():
    assert np.allclose(shift("rim_10")[3], [50.0, 0.0])
    assert np.linalg.norm(shift("rim_10")[0]) < 1e-6


def test_terms_stand_in_the_order_asked_for():
    both = displacements(POINTS, DISC, REFERENCE, ["coma", "radial"])
    assert np.allclose(both[:, :, 1], shift("radial"))
    assert displacements(POINTS, DISC, REFERENCE, []).shape == (4, 2, 0)


def test_each_rung_of_the_ladder_with_a_rim_contains_the_one_before():
    rungs = [terms for name, terms in LADDER.items() if name != "radial"]
    assert all(set(low) < set(high) for low, high in itertools.pairwise(rungs))
    assert set(rungs[-1]) <= set(EXPECTED_SIGMA)


def test_an_unknown_aberration_is_refused():
    with pytest.raises(InputMismatch, match="Known: "):
        displacements(POINTS, DISC, REFERENCE, ["ghost"])


def test_radial_terms_and_parallax_need_no_disc():
    found = displacements(
        POINTS, None, REFERENCE, ["radial", "radial_4", "parallax_x", "parallax_y"], (0.1, -0.2)
    )
    x, y, r = REFERENCE
    h = (POINTS - [x, y]) / r
    h2 = (h**2).sum(axis=1, keepdims=True)
    assert np.allclose(found[:, :, 0], r * h2 * h)
    assert np.allclose(found[:, :, 1], r * h2**2 * h)
    assert np.allclose(found[:, :, 2], [0.1 * r, 0.0])
    assert np.allclose(found[:, :, 3], [0.0, -0.2 * r])
    assert not needs_rim(["radial", "radial_4", "parallax_x"])
    assert needs_rim(["radial", "pupil_shift"])
