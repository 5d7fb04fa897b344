"""The parallax test: the place of the entrance pupil from drawn rims, with a sigma that holds."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from drawn_rims import HALF_FRAME_MM, framed_rim

import sequences
from calib import Collimator, View
from calib.errors import DegenerateViews, InputMismatch
from calib.model.rotation import euler_zxy
from calib.studies.parallax import PupilWalk, mean_of_axes, pupil_walk

R_MM = 255.0
COLLIMATOR = Collimator(97.0, 140.0, R_MM)
MIDDLE, RADIUS = np.array([97.0, 140.0]), 56.0
SHIPPED = yaml.safe_load((Path(sequences.__file__).parent / "parallax_test.yaml").read_text())["poses"]
POSES = [(pose["pan_deg"], pose["tilt_deg"]) for pose in (*SHIPPED["near"], *SHIPPED["far"])]


def rotation_of(pan, tilt):
    """Return camera <- target of a camera that is also rolled by 10 degrees."""
    return euler_zxy(-pan, -tilt, -10.0)


def draw(seed, walk, *, common=0.0, uneven=0.0, wander=0.0, sigma=0.1, poses=POSES):
    """Return views with rims of discs that walk, and their rotations; waves of the edge as shares of the radius."""
    rng = np.random.default_rng(seed)
    shared = common * rng.standard_normal(8)
    rotations = np.array([rotation_of(*pose) for pose in poses])
    offset = rng.normal(0.0, 3.0, 2)
    views = []
    for number, axis in enumerate(rotations[:, 2]):
        tangent = axis[:2] / axis[2]
        disc = MIDDLE + offset + np.asarray(walk) * tangent + wander * rng.standard_normal(2)
        waves = shared + uneven * rng.standard_normal(8)
        views.append(view_of(f"pose {number}", MIDDLE + R_MM * tangent, disc, waves, sigma, rng))
    return views, rotations


def view_of(name, look, disc, waves, sigma, rng):
    rim = replace(framed_rim(look, disc, RADIUS, waves, rng, sigma), lit_mm=np.zeros((0, 2)))
    stars = look + HALF_FRAME_MM * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, 0]])
    stars = stars[np.linalg.norm(stars - disc, axis=1) < 0.95 * RADIUS]
    n = len(stars)
    return View(name, (1280, 720), np.arange(n), stars, stars, np.tile(np.eye(2) * 1e-4, (n, 1, 1)), rim)


@pytest.mark.parametrize(
    ("errors", "largest_sigma"),
    [
        ({"common": 0.03}, 1.5),  # one stop, not round, as on a bench with a gimbal
        ({"uneven": 0.03, "wander": 5.0}, 20.0),  # rims that differ from view to view
    ],
    ids=["stop", "wandering"],
)
def test_the_stated_sigma_holds(errors, largest_sigma):
    scores, sigmas = [], []
    for seed in range(10):
        walk = np.random.default_rng((seed, 1)).uniform(-40.0, 40.0) * np.ones(2)
        walk_found = pupil_walk(*draw(seed, walk, **errors), COLLIMATOR)
        off = walk_found.walk_mm - walk
        scores.append(off @ np.linalg.solve(walk_found.covariance_mm2, off) / 2)
        scores.append(((walk_found.pupil_off_pivot_mm + walk[0]) / walk_found.sigma_mm) ** 2)
        sigmas.append(walk_found.sigma_mm)
    assert 0.3 < np.sqrt(np.mean(scores)) < 1.5
    assert np.median(sigmas) < largest_sigma


def test_an_error_of_the_radius_is_part_of_the_sigma():
    """With rims on one side only, radius and walk along x cannot be separated well."""
    both = pupil_walk(*draw(3, (-2, -2), common=0.03), COLLIMATOR)
    right = [pose for pose in POSES if pose[0] >= 0]
    one_side = pupil_walk(*draw(3, (-2, -2), common=0.03, poses=right), COLLIMATOR)
    assert one_side.walk_sigma_mm[0] > 1.5 * both.walk_sigma_mm[0]


def test_separate_pivots_are_noticed_and_covered():
    walk_found = pupil_walk(*draw(4, (-30.0, -5.0), common=0.02), COLLIMATOR)
    assert walk_found.axes_differ
    assert walk_found.difference_in_sigmas > 2.5
    assert abs(walk_found.pupil_off_pivot_mm - 30.0) < 1.5 * walk_found.sigma_mm
    assert abs(walk_found.pupil_off_pivot_mm - 5.0) < 1.5 * walk_found.sigma_mm
    assert any("separate pivots" in sentence for sentence in walk_found.says())
    same = pupil_walk(*draw(4, (-30.0, -30.0), common=0.02), COLLIMATOR)
    assert not same.axes_differ
    assert not any("separate pivots" in sentence for sentence in same.says())


def test_views_without_rim_are_named_and_do_not_disturb():
    views, rotations = draw(5, (-10.0, -10.0), common=0.02)
    near = view_of("near", MIDDLE, MIDDLE, np.zeros(8), 0.1, np.random.default_rng(1))
    bare = replace(near, rim=None)
    more = np.concatenate([rotations, [rotation_of(0, 0)] * 2])
    walk_found = pupil_walk([*views, near, bare], more, COLLIMATOR)
    assert walk_found.without_rim == ("near", "near")
    assert walk_found.views == len(views) + 2
    assert walk_found.pupil_off_pivot_mm == pytest.approx(10.0, abs=3 * walk_found.sigma_mm)
    assert "15 of 17 views" in walk_found.says()[0]


def test_too_few_rims_are_refused_with_advice():
    views, rotations = draw(6, (0.0, 0.0), poses=[(0, 0)] * 3 + [(13, 0), (-13, 0)])
    with pytest.raises(DegenerateViews, match=r"2 of 5 views .* farther"):
        pupil_walk(views, rotations, COLLIMATOR)
    with pytest.raises(InputMismatch, match="5 views, but 4 rotations"):
        pupil_walk(views, rotations[:4], COLLIMATOR)


def test_rims_along_one_axis_do_not_determine_the_other():
    poses = [(pan, 0) for pan in (-14, -13, -12, 12, 13, 14)]
    with pytest.raises(DegenerateViews, match=r"along y.*both axes"):
        pupil_walk(*draw(7, (-2.0, -2.0), uneven=0.03, wander=5.0, poses=poses), COLLIMATOR)


def walk_of(off, sigma):
    return PupilWalk(np.array([-off, -off]), np.eye(2) * 2 * sigma**2, off, sigma, 9, ())


@pytest.mark.parametrize(
    ("off", "sigma", "entry", "place"),
    [
        (1.94, 0.41, "{value: 1.94, sigma: 0.41}", "1.94 mm in front of the pivot"),
        (-43.6, 7.34, "{value: -43.6, sigma: 7.3}", "43.6 mm behind the pivot"),
        (2.67, 0.996, "{value: 2.7, sigma: 1.0}", "2.7 mm in front of the pivot"),
        (-0.01, 12.3, "{value: 0, sigma: 12}", "is on the pivot"),
    ],
)
def test_the_sentences_state_what_to_write_into_the_station_file(off, sigma, entry, place):
    walk_found = walk_of(off, sigma)
    assert walk_found.station_entry == f"gimbal: {{pupil_off_pivot_mm: {entry}}}"
    assert place in walk_found.says()[1]
    assert walk_found.advice.endswith(walk_found.station_entry)


def test_the_parallax_follows_from_the_defocus():
    parallax = walk_of(44.0, 2.0).parallax(0.066, 0.01, r_mm=255.0, fx_px=3345.0)
    assert parallax.share == pytest.approx(-0.066 * 44 / 255)
    expected = np.sqrt((0.066 * 2) ** 2 + (44 * 0.01) ** 2 + (0.01 * 2) ** 2) / 255
    assert parallax.share_sigma == pytest.approx(expected)
    assert parallax.fx_px == pytest.approx(38.1, abs=0.1)
    assert parallax.fx_sigma_px == pytest.approx(3345 * expected)
    assert parallax.bound.pupil_off_pivot_mm == 44.0


def test_correlated_errors_do_not_place_the_mean_beyond_both_values():
    value, sigma = mean_of_axes(np.array([51.7, 33.8]), np.array([[85.0, 120.0], [120.0, 340.0]]))
    assert (value, sigma) == pytest.approx((51.7, np.sqrt(85.0)))
    value, sigma = mean_of_axes(np.array([3.0, 5.0]), np.diag([1.0, 3.0]))
    assert (value, sigma) == pytest.approx((3.5, np.sqrt(0.75)))
