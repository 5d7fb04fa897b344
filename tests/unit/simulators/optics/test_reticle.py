"""The simulated reticle and printed target: irregular prints."""

from dataclasses import replace

import numpy as np
import pytest
from apparent import apparent_points
from hypothesis import given
from hypothesis import strategies as st

from calib.stars.detect import detect_stars
from calib.target import StarTarget
from simulators.optics.collimator_errors import (
    RIM_FROM,
    RIM_OUTWARDS,
    aberrations_of,
    displacement_field,
    field_coefficients,
    random_functions,
)
from simulators.optics.picture import pose_rotation, project, render, star_centres, true_rotation
from simulators.world.truth import CameraTruth, CollimatorTruth, OpticsTruth, ReticleTruth, Truth
from simulators.world.truth_config import truth_from_config

TRUTH = Truth(camera=CameraTruth(k1=0.0, k2=0.0))

TURN = true_rotation({"pan": 4.0, "tilt": -3.0, "roll": 12.0}, TRUTH)

AROUND = st.floats(0.0, 2.0 * np.pi)


@given(
    bow_mm=st.floats(-0.1, 0.1), bow_radius_mm=st.floats(10.0, 80.0), away_mm=st.floats(1.0, 60.0), phi=AROUND
)
def test_a_bowed_reticle_moves_a_point_by_its_height_times_its_angle(bow_mm, bow_radius_mm, away_mm, phi):
    c = CollimatorTruth()
    reticle = ReticleTruth(bow_mm=bow_mm, bow_radius_mm=bow_radius_mm)
    point = np.array([[c.x + away_mm * np.cos(phi), c.y + away_mm * np.sin(phi)]])
    moved = apparent_points(point, aberrations_of(c, np.eye(3), reticle)) - point
    height = bow_mm * (away_mm / bow_radius_mm) ** 2
    expected = height * (point - (c.x, c.y)) / c.r
    np.testing.assert_allclose(moved, expected, atol=1e-12)


@given(scale=st.floats(-0.01, 0.01))
def test_a_larger_print_is_a_collimator_with_a_smaller_radius(scale):
    printed = replace(TRUTH, reticle=ReticleTruth(print_scale=scale))
    nearer = replace(TRUTH, collimator=replace(TRUTH.collimator, r=255.0 / (1.0 + scale)))
    points = np.random.default_rng(1).uniform([40.0, 80.0], [140.0, 180.0], (20, 2))
    np.testing.assert_allclose(project(points, TURN, printed), project(points, TURN, nearer), atol=1e-8)


@pytest.mark.parametrize("reticle", [ReticleTruth(bow_mm=2.0), ReticleTruth(print_scale=0.03)])
def test_the_picture_shows_the_same_print_as_the_stars(reticle):
    small = CameraTruth(fx=330.0, fy=331.0, cx=63.5, cy=35.5, k1=0.0, k2=0.0, width=128, height=72)
    wrong = Truth(small, optics=OpticsTruth(psf_px=0.0, gradient_x=0.0, gradient_y=0.0), reticle=reticle)
    ids, points = star_centres(wrong, TURN)
    flat_ids, flat = star_centres(replace(wrong, reticle=ReticleTruth()), TURN)
    shared, here, other = np.intersect1d(ids, flat_ids, return_indices=True)
    assert len(shared) > 5
    assert np.abs(points[here] - flat[other]).max() > 0.05
    pictures = render(wrong, TURN), render(replace(wrong, reticle=ReticleTruth()), TURN)
    assert np.abs(pictures[0] - pictures[1]).max() > 0.1
    # the equivalent collimator gives the same picture
    c = wrong.collimator
    like = replace(c, r=c.r / (1.0 + reticle.print_scale), distortion=reticle.bow_mm * c.r / 1600.0)
    like = replace(like, half_angle_deg=np.degrees(np.arctan(c.r * np.tan(np.radians(12.0)) / like.r)))
    same = render(replace(wrong, reticle=ReticleTruth(), collimator=like), TURN)
    assert np.abs(pictures[0] - same).mean() < 2e-3


# ---------------------------------------------------------------- irregular prints

GRID = np.stack(np.meshgrid(np.linspace(-1, 1, 61), np.linspace(-1, 1, 61)), axis=-1).reshape(-1, 2)

DISC = GRID[np.hypot(*GRID.T) <= 1.0]

POSES = np.random.default_rng(4).uniform(-0.45, 0.45, (150, 2))


def over(points, drawn):
    """Displacements at points of the disc."""
    return np.column_stack(displacement_field(*points.T, drawn))


def test_the_displacement_has_the_rms_asked_for_over_disc_and_poses():
    fields = (over(DISC[::7], field_coefficients(tuple(pose), 0.02, 0.0, 1)) for pose in POSES)
    squares = [(field**2).sum(axis=1).mean() for field in fields]
    assert np.sqrt(np.mean(squares)) == pytest.approx(0.02, rel=0.15)


def test_near_poses_have_like_errors_and_distant_poses_do_not():
    drawn = np.array([random_functions(tuple(pose), 60, 1) for pose in POSES])
    nearby = np.array([random_functions((x + 0.02, y), 60, 1) for x, y in POSES])
    assert np.mean(drawn * nearby) / np.mean(drawn**2) > 0.7
    assert abs(np.mean(drawn[1:] * drawn[:-1])) < 0.1
    assert not np.allclose(drawn, [random_functions(tuple(pose), 60, 2) for pose in POSES], atol=0.5)


def test_only_the_rim_scatters_and_mostly_outwards():
    turns = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    circle = np.column_stack([np.cos(turns), np.sin(turns)])
    at_edge = np.array([over(circle, field_coefficients(tuple(pose), 0.0, 0.05, 1)) for pose in POSES])
    outwards = (at_edge * circle).sum(axis=2)
    assert outwards.mean() == pytest.approx(0.05 * RIM_OUTWARDS, rel=0.25)
    assert (at_edge - 0.05 * RIM_OUTWARDS * circle).std() == pytest.approx(0.05, rel=0.2)
    assert np.abs(over(0.99 * RIM_FROM * circle, field_coefficients((0.1, 0.2), 0.0, 0.05, 1))).max() == 0.0


# ---------------------------------------------------------------- printed targets

SMALL = {"squares": [32, 30], "pitch_mm": 4.0, "tag_square": [14, 13]}


@pytest.mark.parametrize(
    ("family", "tag", "side", "segments", "polarity"),
    [
        ("36h11", 586, 4, 16, "negative"),
        ("36h10", 2000, 5, 12, "positive"),
        ("25h9", 7, 4, 16, "positive"),
        ("16h5", 11, 3, 16, "negative"),
    ],
)
def test_every_star_of_a_target_of_its_own_is_found_with_its_id(family, tag, side, segments, polarity):
    own = {**SMALL, "tag_family": family, "tag_id": tag, "tag_squares": side, "segments": segments}
    truth = truth_from_config({"target": own, "reticle": {"polarity": polarity}})
    assert truth.target.tag_family == family
    rotation = pose_rotation({"pan": 3.0, "tilt": -2.0}, truth.optics)
    detection = detect_stars(render(truth, rotation), truth.target)
    ids, points = star_centres(truth, rotation, clearance=1.0, border_px=36.0)
    assert detection.named_by == "tag"
    assert len(ids) > 150
    assert set(ids) <= set(detection.view.ids)
    of_found = detection.view.points_px[np.searchsorted(detection.view.ids, ids)]
    assert np.abs(of_found - points).max() < 0.05


def test_the_axis_of_the_collimator_stays_near_the_tag_unless_its_place_is_given():
    standard = truth_from_config({}).collimator
    own = truth_from_config({"target": SMALL}).collimator
    middle, own_middle = StarTarget().tag_centre_mm, truth_from_config({"target": SMALL}).target.tag_centre_mm
    assert own.x - own_middle[0] == pytest.approx(standard.x - middle[0])
    assert own.y - own_middle[1] == pytest.approx(standard.y - middle[1])
    assert truth_from_config({"target": SMALL, "collimator": {"x": 5.0}}).collimator.x == 5.0
    assert truth_from_config({"target": {"squares": [50, 72]}}).collimator == standard
