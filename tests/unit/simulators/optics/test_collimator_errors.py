"""The collimator's errors: third-order aberrations, their inverse, and that picture and star positions agree."""

from dataclasses import replace

import numpy as np
import pytest
from apparent import apparent_points
from hypothesis import given
from hypothesis import strategies as st

from simulators.optics import picture as optics
from simulators.optics.collimator_errors import aberrations_of, disc_of, reticle_point
from simulators.world.truth import COLLIMATORS, CameraTruth, CollimatorTruth, OpticsTruth, ReticleTruth, Truth
from simulators.world.truth_config import truth_from_config

COEFFICIENT = st.floats(-0.3, 0.3)
TURN = optics.pose_rotation({"pan": 6.0, "tilt": -4.0, "roll": 15.0}, OpticsTruth())


def wave_aberration(h, b, c):
    """Seidel's wave aberration over field h and pupil b, with coefficients by name."""
    hh, bb, hb = h @ h, b @ b, h @ b
    return (
        c["spherical"] * bb**2 / 4
        + c["coma"] * hb * bb
        + c["astigmatism"] * hb**2
        + c["field_curvature"] * hh * bb
        + c["distortion"] * hh * hb
        + c["defocus"] * bb / 2
    )


@given(
    values=st.tuples(*[COEFFICIENT] * 6),
    point=st.tuples(st.floats(-60, 60), st.floats(-60, 60)),
    pupil=st.tuples(st.floats(-30, 30), st.floats(-30, 30)),
)
def test_displacement_is_the_gradient_of_the_wave_aberration(values, point, pupil):
    names = ("defocus", "spherical", "coma", "astigmatism", "field_curvature", "distortion")
    c = dict(zip(names, values, strict=True))
    collimator = CollimatorTruth(disc_x=pupil[0], disc_y=pupil[1], **c)
    p = np.array([collimator.x, collimator.y]) + point
    moved = apparent_points(p[None], aberrations_of(collimator, np.eye(3)))[0] - p
    h, b, step = np.array(point) / collimator.r, np.array(pupil) / collimator.r, 1e-4
    ways = step * np.eye(2)
    gradient = [wave_aberration(h, b + way, c) - wave_aberration(h, b - way, c) for way in ways]
    np.testing.assert_allclose(moved, collimator.r * np.array(gradient) / (2 * step), atol=1e-5)


@pytest.mark.parametrize("reticle", [ReticleTruth(), ReticleTruth(bow_mm=0.05, print_scale=2e-4)])
@given(x=st.floats(40, 150), y=st.floats(80, 200))
def test_the_reticle_point_seen_somewhere_appears_there(reticle, x, y):
    aberrations = aberrations_of(COLLIMATORS["like-real"], TURN, reticle)
    p = np.array(reticle_point(x, y, aberrations))
    np.testing.assert_allclose(apparent_points(p[None], aberrations)[0], [x, y], atol=1e-5)
    assert np.hypot(*(p - [x, y])) > 1e-4


def test_the_disc_walks_with_the_turn_of_the_camera():
    collimator = CollimatorTruth(disc_walk=(40.0, -10.0), disc_y=3.0)
    still, turned = disc_of(collimator, np.eye(3)), disc_of(collimator, TURN)
    assert (still.x, still.y) == (collimator.x, collimator.y + 3.0)
    axis = TURN.T @ [0.0, 0.0, 1.0]
    assert turned.x - still.x == pytest.approx(40.0 * axis[0] / axis[2])
    assert turned.y - still.y == pytest.approx(-10.0 * axis[1] / axis[2])
    assert turned.radius == still.radius


def test_the_disc_wanders_and_breathes_by_its_sigmas_and_alike_in_like_poses():
    collimator = CollimatorTruth(disc_wander_mm=5.0, disc_breathing=0.1)
    poses = np.random.default_rng(1).uniform(-25.0, 25.0, (600, 2))
    turns = [optics.pose_rotation({"pan": pan, "tilt": tilt}, OpticsTruth()) for pan, tilt in poses]
    discs = np.array([disc_of(collimator, turn)[:3] for turn in turns])
    np.testing.assert_allclose(discs[:, :2].std(axis=0), 5.0, rtol=0.25)
    assert discs[:, 2].std() / discs[:, 2].mean() == pytest.approx(0.1, rel=0.25)
    near, there = (disc_of(collimator, optics.pose_rotation({"pan": p}, OpticsTruth())) for p in (3.0, 3.2))
    assert np.hypot(near.x - there.x, near.y - there.y) < 1.5
    assert near[:3] != there[:3]


def test_points_roll_outwards_with_the_fourth_power():
    collimator = CollimatorTruth(rim_roll_mm=0.2)
    aberrations = aberrations_of(collimator, np.eye(3))
    radius = disc_of(collimator, np.eye(3)).radius
    points = np.array([[collimator.x + share * radius, collimator.y] for share in (0.0, 0.5, 1.0)])
    moved = apparent_points(points, aberrations) - points
    np.testing.assert_allclose(moved, [[0.0, 0.0], [0.2 / 16, 0.0], [0.2, 0.0]], atol=1e-12)


def test_stray_light_lifts_every_pixel():
    camera = CameraTruth(fx=330.0, fy=331.0, cx=64.0, cy=36.0, width=128, height=72)
    without, lifted = (optics.render(Truth(camera, optics=OpticsTruth(stray=s)), TURN) for s in (0.0, 0.05))
    np.testing.assert_allclose(lifted - without, 0.05, atol=1e-6)


def test_a_profile_is_named_alone_or_beside_what_differs_from_it():
    assert truth_from_config({"collimator": "like-real"}).collimator == COLLIMATORS["like-real"]
    mixed = truth_from_config({"collimator": {"profile": "like-real", "r": 700}}).collimator
    assert mixed == replace(COLLIMATORS["like-real"], r=700.0)
