"""Where the adjustment starts, and what no start can help."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from slow_cases import slow

from calib import CalibrationOptions, Collimator, Passport, calibrate
from calib.adjustment.initialization import (
    initialized,
    passport_starts,
    planar_starts,
    spherical_starts,
    with_distorted_glass,
)
from calib.errors import CalibrationError, DegenerateViews
from calib.model.closed_forms import camera_matrix_from_centre, linear_solution, zhang_matrix
from calib.model.homography import view_homography
from tests.unit.calib.conftest import Bench, rotation

SIZE = (1280, 720)

#: Three poses, pan, tilt and roll in degrees, that determine a camera without any doubt.
WELL_SPREAD = np.array([[-5.0, 2.0, 0.0], [0.5, -2.5, 10.0], [5.0, 2.5, -20.0]])

#: So near to each other that a step of the search joins or parts their poses.
NEARLY_ONE_POSE = np.array(
    [
        [0.01257302, -0.01321049, 0.06404227],
        [0.01049001, -0.05356694, 0.03615951],
        [0.1304, 0.0947081, -0.07037352],
    ]
)

#: Turns of a set of views: anything, the same pose again and again, about one axis, a roll, and all but these.
ANGLE = st.floats(-12.0, 12.0)

NEARLY = st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 1e-3, 1e-1])


@st.composite
def poses(draw, fewest=1, most=5):
    n = draw(st.integers(fewest, most))
    kind = draw(st.sampled_from(["any", "same", "one axis", "roll"]))
    base = np.array([draw(ANGLE), draw(ANGLE), draw(st.floats(-180, 180))])
    turns = np.array([[draw(ANGLE), draw(ANGLE), draw(st.floats(-180, 180))] for _ in range(n)])
    along = {"any": [1, 1, 1], "same": [0, 0, 0], "one axis": [1, 0, 0], "roll": [0, 0, 1]}[kind]
    noise = draw(NEARLY) * np.random.default_rng(draw(st.integers(0, 99))).standard_normal((n, 3))
    return (base if kind != "any" else 0.0) + turns * along + noise


def mappings(turns, focal, centre=(97.0, 140.1, -255.0)):
    """Exact homographies of a camera about a centre, determinant 1."""
    matrix = np.array([[focal, 0, 640.0], [0, focal, 360.0], [0, 0, 1.0]])
    frame = np.eye(3)
    frame[:, 2] = -np.array(centre)
    h = np.array([matrix @ rotation(*turn) @ frame for turn in turns])
    return h / np.cbrt(np.linalg.det(h))[:, None, None]


def closed_forms(h):
    """For each closed form that these views suffice for: the camera matrices and centres it gives."""
    answers_of = {}
    for free in (True, False):
        if len(h) >= (3 if free else 2):
            answers_of["linear", free] = [linear_solution(h, SIZE, free_principal_point=free)]
        matrix = zhang_matrix(h, SIZE, free_principal_point=free)
        answers_of["zhang", free] = [None if matrix is None else (matrix, None)]
    matrix = camera_matrix_from_centre(h, Collimator(97.0, 140.1, 255.0))
    answers_of["known centre"] = [None if matrix is None else (matrix, None)]
    return {name: [one for one in answers if one is not None] for name, answers in answers_of.items()}


def assert_real(matrix, collimator=None):
    numbers = np.append(matrix, collimator.values if collimator else [])
    assert np.isrealobj(numbers)
    assert np.isfinite(numbers).all()
    assert (np.diag(matrix) > 0).all()
    assert collimator is None or collimator.r > 0


@settings(max_examples=150, deadline=None)
@given(turns=poses(), focal=st.floats(200, 50_000), blur=st.sampled_from([0.0, 1e-9, 1e-6, 1e-3, 0.1]))
@example(turns=np.zeros((2, 3)), focal=3345.0, blur=0.0)
@example(turns=np.zeros((3, 3)), focal=3345.0, blur=0.0)
@example(turns=np.array([[0.0, 0.0, 1.0]]), focal=200.0, blur=1e-6)  # w11 came out as zero
def test_no_closed_form_gives_a_camera_that_is_not_real(turns, focal, blur):
    h = mappings(turns, focal) * (1 + blur * np.random.default_rng(7).standard_normal((len(turns), 3, 3)))
    h = h / np.cbrt(np.linalg.det(h))[:, None, None]
    for answers in closed_forms(h).values():
        for matrix, collimator in answers:
            assert_real(matrix, collimator)


@settings(max_examples=80, deadline=None)
@given(turns=poses(), focal=st.floats(200, 50_000), known=st.booleans())
@example(turns=np.zeros((2, 3)), focal=3345.0, known=False)
@example(turns=np.zeros((1, 3)), focal=3345.0, known=True)
def test_there_is_always_somewhere_to_begin(turns, focal, known):
    h = mappings(turns, focal)
    passport = Passport.of_radius(255.0, 0.1, length="seen")
    lists = [planar_starts(h, SIZE, ("k1", "k2"))]
    if known or len(h) == 1:
        lists.append(passport_starts(h, SIZE, ("k1", "k2"), passport))
    else:
        lists.append(spherical_starts(h, SIZE, ("k1", "k2")))
    for states in lists:
        assert states
        for parameters in states:
            assert_real(parameters.camera.matrix)
            assert np.isfinite(parameters.rotations).all()
            assert np.isfinite(parameters.centres).all()
            assert np.linalg.det(parameters.rotations) == pytest.approx(1.0)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(turns=poses(most=3), noise=st.sampled_from([0.0, 0.05, 2.0]), known=st.booleans())
@example(turns=np.zeros((3, 3)), noise=0.0, known=False)
@example(turns=WELL_SPREAD, noise=0.05, known=False)
@example(turns=WELL_SPREAD, noise=0.05, known=True)
def test_a_calibration_ends_in_finite_numbers_or_a_named_reason(turns, noise, known):
    bench = Bench(fx=2000.0, fy=2001.0, half_angle_deg=5.0, poses=tuple(map(tuple, np.clip(turns, -60, 60))))
    views = [view for view in bench.views(np.random.default_rng(3), noise) if len(view) >= 4]
    passport = Passport.of_radius(255.0, 0.1, length="seen") if known else None
    try:
        result = calibrate(views, CalibrationOptions(distortion="k1", passport=passport))
    except CalibrationError:
        # Every such error says what is wrong; any other one fails here, and so does a refusal of good views.
        assert not np.array_equal(turns, WELL_SPREAD)
        return
    numbers = np.concatenate([result.estimates, result.covariance.ravel(), result.rotations.ravel()])
    assert np.isrealobj(numbers)
    assert np.isfinite(numbers).all()
    assert min(result.camera.fx, result.camera.fy) > 0
    known_to = max(result.sigma[name] / getattr(result.camera, name) for name in ("fx", "fy"))
    assert known_to < 0.01 or any(note.startswith("Weak geometry") for note in result.notes)


@pytest.mark.parametrize("focal", [900.0, 3345.0, 20_000.0])
@pytest.mark.parametrize("centre", [(97.0, 140.1, -255.0), (0.0, 0.0, -5000.0), (-3000.0, 40.0, -60.0)])
def test_closed_forms_are_exact_whatever_the_scales(focal, centre):
    turns = np.array([[-5, 2, 0], [0.5, -2.5, 10], [5, 2.5, -20], [2, 1, 70]])
    matrix, collimator = linear_solution(mappings(turns, focal, centre), SIZE, free_principal_point=True)
    assert np.diag(matrix)[:2] == pytest.approx([focal, focal], rel=1e-5)
    assert collimator.values == pytest.approx([centre[0], centre[1], -centre[2]], rel=1e-4, abs=1e-3)
    for h in mappings(turns, focal, centre):
        alone = camera_matrix_from_centre(h[None], Collimator(centre[0], centre[1], -centre[2]))
        assert np.diag(alone)[:2] == pytest.approx([focal, focal], rel=1e-6)


def test_one_view_of_a_known_collimator_begins_at_its_camera(bench):
    h = np.array([view_homography(view) for view in bench.views()[:1]])
    known = Passport(("x", "y", "r"), np.array([97.0, 140.1, 255.0]), 1e-4 * np.eye(3))
    first = passport_starts(h, SIZE, (), known)[0]
    assert first.camera.fx == pytest.approx(bench.fx, rel=0.05)
    assert first.collimator.r == 255.0


# ---------------------------------------------------------------- degenerate views


@pytest.mark.parametrize("noise_px", [slow(0.0), 0.05])
@pytest.mark.parametrize(
    ("poses", "reason"),
    [
        ((), "0 views"),
        (((0, 0),), "1 view given; at least 2"),
        slow(((1, 1), (1, 1)), "All 2 views show the same pose"),
        (((1, 1), (1, 1.1), (1.1, 1)), "All 3 views show the same pose"),
        (((0, 0, 0), (0, 0, 30)), "roll about the optical axis"),
        slow(((0, 0, 0), (0, 0, 30), (0, 0, -50)), "roll about the optical axis"),
    ],
)
def test_views_that_do_not_constrain_are_named(bench, poses, reason, noise_px):
    views = bench.views(np.random.default_rng(31), noise_px, poses=poses)
    with pytest.raises(DegenerateViews, match=reason):
        calibrate([view.part(np.arange(len(view)) % 4 == 0) for view in views])


@pytest.mark.slow
def test_a_beam_too_narrow_is_named(make_bench):
    bench = make_bench(centre=(60, 60, -255), half_angle_deg=1.9, poses=((0, 0), (1, 0.5, 20), (-0.5, 1)))
    with pytest.raises(DegenerateViews, match="beam is too narrow"):
        calibrate(bench.views(np.random.default_rng(32), 0.2))


def test_square_on_views_are_not_enough_for_the_planar_model(bench):
    views = bench.views(np.random.default_rng(33), 0.05, poses=((0, 0), (0, 0, 40)))
    with pytest.raises(DegenerateViews, match="roll about"):
        calibrate(views, CalibrationOptions(model="planar"))


def test_a_turntable_is_enough(bench):
    views = bench.views(np.random.default_rng(34), 0.05, poses=((-4, 1), (0, 1), (4, 1)))
    result = calibrate(views)
    assert result.camera.fx == pytest.approx(bench.fx, abs=4 * result.sigma["fx"])
    assert result.sigma["fx"] < 0.015 * bench.fx  # The parallax is not bounded


class DistortedBench(Bench):
    """The same behind a single doublet, which shows stars 1 + 1.4 |h|^2 times as far from its axis."""

    distortion = 1.4

    def project(self, target_mm, turn, centre):
        foot, r = np.asarray(centre)[:2], -centre[2]
        h = (target_mm - foot) / r
        seen = foot + r * h * (1.0 + self.distortion * (h * h).sum(axis=1, keepdims=True))
        return super().project(seen, turn, centre)


def test_glass_that_distorts_is_no_error_of_camera_and_centre():
    bench = DistortedBench(
        fx=7100.0,
        fy=7097.0,
        cx=632.0,
        cy=360.0,
        k=(0.23, -30.0),
        centre=(70.0, 120.0, -582.0),
        poses=((3.2, 2.3), (0.1, -2.7), (-3.3, 2.4), (3.0, -2.5), (-3.0, -2.3), (-0.3, 2.5)),
        half_angle_deg=9.0,
    )
    views = bench.views(np.random.default_rng(1), 0.04)
    bundle, plain = initialized(views, ("k1", "k2"), Passport.of_radius(582.0, 0.1))
    start = with_distorted_glass(bundle, plain)
    assert abs(plain.camera.cx - bench.cx) > 50.0
    assert start.camera.fx == pytest.approx(bench.fx, abs=5.0)
    assert start.camera.cx == pytest.approx(bench.cx, abs=5.0)
    assert start.collimator.aberrations == {"radial": pytest.approx(1.4, abs=0.01)}
    assert (start.collimator.x, start.collimator.y) == pytest.approx((70.0, 120.0), abs=0.5)


def test_glass_that_does_not_distort_leaves_the_start_as_it_is(bench):
    bundle, start = initialized(bench.views(np.random.default_rng(2), 0.05), ("k1", "k2"), None)
    assert with_distorted_glass(bundle, start) is start


@pytest.mark.slow
def test_poses_that_the_search_parts_stay_as_they_were_found():
    bench = Bench(fx=2000.0, fy=2001.0, half_angle_deg=5.0, poses=tuple(map(tuple, NEARLY_ONE_POSE)))
    views = bench.views(np.random.default_rng(3), 2.0)
    with pytest.raises(CalibrationError, match="determine"):
        calibrate(views, CalibrationOptions(distortion="k1"))
    certificate = Passport.of_radius(255.0, 0.1, length="seen")
    result = calibrate(views, CalibrationOptions(distortion="k1", passport=certificate))
    assert np.isfinite(result.estimates).all()
