"""Errors of the reticle: a bow acts as distortion, and a larger print as a smaller radius of the collimator."""

from dataclasses import replace

import numpy as np
import pytest
from apparent import apparent_points
from hypothesis import given
from hypothesis import strategies as st

from simulators.errors import ConfigError
from simulators.optics.collimator_errors import aberrations_of, reticle_point
from simulators.optics.picture import project, projection_of, render, star_centres, true_rotation
from simulators.world.truth import CameraTruth, CollimatorTruth, OpticsTruth, ReticleTruth, Truth
from simulators.world.truth_config import truth_from_config

TRUTH = Truth(camera=CameraTruth(k1=0.0, k2=0.0))
TURN = true_rotation({"pan": 4.0, "tilt": -3.0, "roll": 12.0}, TRUTH)
AROUND = st.floats(0.0, 2.0 * np.pi)


@given(
    bow_mm=st.floats(-0.1, 0.1), bow_radius_mm=st.floats(10.0, 80.0), away_mm=st.floats(1.0, 60.0), phi=AROUND
)
def test_a_bowed_reticle_moves_a_point_by_its_height_times_its_field_angle(
    bow_mm, bow_radius_mm, away_mm, phi
):
    c = CollimatorTruth()
    reticle = ReticleTruth(bow_mm=bow_mm, bow_radius_mm=bow_radius_mm)
    point = np.array([[c.x + away_mm * np.cos(phi), c.y + away_mm * np.sin(phi)]])
    moved = apparent_points(point, aberrations_of(c, np.eye(3), reticle)) - point
    height = bow_mm * (away_mm / bow_radius_mm) ** 2
    expected = height * (point - (c.x, c.y)) / c.r
    np.testing.assert_allclose(moved, expected, atol=1e-12)


def test_a_bow_of_10_um_at_40_mm_is_a_distortion_of_bow_times_r_over_the_radius_squared():
    c = CollimatorTruth()
    bowed = aberrations_of(c, TURN, ReticleTruth(bow_mm=0.01, bow_radius_mm=40.0))
    assert bowed.distortion == pytest.approx(0.01 * 255.0 / 1600.0)
    assert bowed == aberrations_of(replace(c, distortion=bowed.distortion), TURN)
    seen = project(
        np.array([[c.x + 40.0, c.y]]), np.eye(3), replace(TRUTH, reticle=ReticleTruth(bow_mm=0.01))
    )
    flat = project(np.array([[c.x + 40.0, c.y]]), np.eye(3), TRUTH)
    assert (seen - flat)[0, 0] == pytest.approx(
        3345.06 * 0.01 * 40.0 / 255.0**2, rel=1e-9
    )  # 0.0206 px outwards


@given(scale=st.floats(-0.01, 0.01))
def test_a_larger_print_is_a_collimator_with_a_smaller_radius(scale):
    printed = replace(TRUTH, reticle=ReticleTruth(print_scale=scale))
    nearer = replace(TRUTH, collimator=replace(TRUTH.collimator, r=255.0 / (1.0 + scale)))
    points = np.random.default_rng(1).uniform([40.0, 80.0], [140.0, 180.0], (20, 2))
    np.testing.assert_allclose(project(points, TURN, printed), project(points, TURN, nearer), atol=1e-8)


@given(x=st.floats(40, 150), y=st.floats(80, 200))
def test_the_inverse_holds_with_an_imperfect_print(x, y):
    reticle = ReticleTruth(bow_mm=0.05, print_scale=2e-4)
    aberrations = aberrations_of(truth_from_config({"collimator": "S1"}).collimator, TURN, reticle)
    p = np.array(reticle_point(x, y, aberrations))
    np.testing.assert_allclose(apparent_points(p[None], aberrations)[0], [x, y], atol=1e-5)


@pytest.mark.parametrize("reticle", [ReticleTruth(bow_mm=2.0), ReticleTruth(print_scale=0.03)])
def test_the_picture_shows_the_same_print_as_the_stars(reticle):
    small = CameraTruth(fx=330.0, fy=331.0, cx=63.5, cy=35.5, k1=0.0, k2=0.0, width=128, height=72)
    wrong = Truth(small, optics=OpticsTruth(psf_px=0.0, gradient_x=0.0, gradient_y=0.0), reticle=reticle)
    ids, points = star_centres(wrong, TURN)
    flat_ids, flat = star_centres(replace(wrong, reticle=ReticleTruth()), TURN)
    shared, one, other = np.intersect1d(ids, flat_ids, return_indices=True)
    assert len(shared) > 5
    assert np.abs(points[one] - flat[other]).max() > 0.05
    pictures = render(wrong, TURN), render(replace(wrong, reticle=ReticleTruth()), TURN)
    assert np.abs(pictures[0] - pictures[1]).max() > 0.1
    # the equivalent collimator gives the same picture
    c = wrong.collimator
    like = replace(c, r=c.r / (1.0 + reticle.print_scale), distortion=reticle.bow_mm * c.r / 1600.0)
    like = replace(like, half_angle_deg=np.degrees(np.arctan(c.r * np.tan(np.radians(12.0)) / like.r)))
    same = render(replace(wrong, reticle=ReticleTruth(), collimator=like), TURN)
    assert np.abs(pictures[0] - same).mean() < 2e-3


def test_a_flat_print_of_the_right_size_changes_nothing():
    aberrations = projection_of(TRUTH, TURN).aberrations
    assert aberrations.distortion == aberrations.print_scale == 0.0
    assert (
        projection_of(replace(TRUTH, reticle=ReticleTruth(bow_radius_mm=10.0)), TURN).aberrations.distortion
        == 0.0
    )


@pytest.mark.parametrize(
    ("section", "key"),
    [
        ({"bow": 0.1}, "reticle.bow"),
        ({"bow_radius_mm": 0}, "reticle.bow_radius_mm"),
        ({"print_scale": "large"}, "reticle.print_scale"),
        (None, "reticle"),
    ],
)
def test_a_wrong_configuration_of_the_reticle_names_its_key(section, key):
    with pytest.raises(ConfigError) as error:
        truth_from_config({"reticle": section})
    assert error.value.where == key
