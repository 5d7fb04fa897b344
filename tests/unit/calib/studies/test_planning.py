"""The expected uncertainty of planned poses."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib import CalibrationOptions, CameraModel, Collimator, Passport, calibrate
from calib.errors import DegenerateViews, InputMismatch, TooFewStars
from calib.model.gimbal_readings import AXES, GimbalReadings, ParallaxBound
from calib.model.result_parts import PARALLAX, PASSPORT, POSE_FIELDS, STARS, TURN_FIELDS, UNBOUNDED_PARALLAX
from calib.studies.planning import forecast, next_poses
from calib.studies.predicted_views import CollimatorErrors, ExpectedBench

CAMERA = CameraModel(3345.0, 3345.0, 640.0, 360.0, (1280, 720), {"k1": 0.06, "k2": -0.9})
BENCH = ExpectedBench(CAMERA, Collimator(97.0, 140.1, 255.0), 12.0, 0.05, needs_tag=False)
POSES = [
    {"pan_deg": -5.0, "tilt_deg": 2.0},
    {"pan_deg": 0.5, "tilt_deg": -2.5, "roll_deg": 10.0},
    {"pan_deg": 5.0, "tilt_deg": 2.5, "roll_deg": -20.0},
]


@pytest.mark.slow  # the next test compares fx of three poses
def test_the_forecast_is_what_a_calibration_then_states(bench):
    """Nine poses show that no hand moves the camera; fewer may leave that open, and then U is larger than expected.

    The views also show small errors, so U of cy is smaller than its forecast: by a factor of 1.54.
    """
    rolls = (0.0, 10.0, -20.0, 45.0, 90.0, 0.0, -60.0, 20.0, 0.0)
    angles = [(pan, tilt) for tilt in (-2.5, 0.0, 2.5) for pan in (-5.0, 0.5, 5.0)]
    poses = [(*pose, roll) for pose, roll in zip(angles, rolls, strict=True)]
    result = calibrate(bench.views(np.random.default_rng(91), 0.05, poses), CalibrationOptions("joint"))
    expected = forecast(BENCH, [dict(zip(AXES, pose, strict=True)) for pose in poses])
    for name in ("fx", "fy", "cx", "cy", "r"):
        stated = result.coverage_factors[name] * result.sigma[name]
        forecast_u = expected.coverage_factors.get(name, expected.coverage_factor) * expected.sigma[name]
        assert stated / 1.5 < forecast_u < (1.6 if name == "cy" else 1.5) * stated, name
    assert expected.stars == pytest.approx([view.n for view in result.views], rel=0.1)


def test_the_sizes_of_errors_that_a_run_found_replace_the_expected_ones(bench):
    result = calibrate(bench.views(np.random.default_rng(91), 0.05), CalibrationOptions("joint"))
    amplitudes = {amplitude.name: amplitude.plain for amplitude in result.amplitudes}
    wrong = replace(BENCH, errors=CollimatorErrors(rms_px=0.5))
    known = forecast(replace(wrong, amplitudes=amplitudes), POSES)
    assert 1 / 1.5 < known.sigma["fx"] / result.sigma["fx"] < 1.5
    assert forecast(wrong, POSES).sigma["fx"] > 5 * known.sigma["fx"]


def poses_of(pans, tilts):
    return [{"pan_deg": pan, "tilt_deg": tilt} for pan in pans for tilt in tilts]


def test_the_next_pose_lowers_the_worst_uncertainty_more_than_any_other():
    candidates = poses_of((-6.0, 2.0, 6.0), (-2.5, 2.5))
    (best,) = next_poses(BENCH, POSES[:2], candidates)
    worst = [forecast(BENCH, [*POSES[:2], pose]).projection_map.worst_px for pose in candidates]
    assert worst[candidates.index(best.angles_deg)] <= 1.02 * min(worst)


@pytest.mark.slow
def test_poses_chosen_at_once_are_as_good_as_those_chosen_one_by_one():
    candidates = poses_of(np.linspace(-6, 6, 9), np.linspace(-3, 3, 5))
    at_once = next_poses(BENCH, POSES, candidates, 8)
    taken = list(POSES)
    for _ in at_once:
        (choice,) = next_poses(BENCH, taken, candidates)
        taken.append(choice.angles_deg)
    assert at_once[-1].after.worst_px == pytest.approx(choice.after.worst_px, rel=0.01)
    assert len({tuple(pose.angles_deg.values()) for pose in at_once}) == 8


@pytest.mark.slow
def test_poses_chosen_from_nothing_beat_random_ones():
    rng = np.random.default_rng(92)
    candidates = [
        {"pan_deg": pan, "tilt_deg": tilt, "roll_deg": roll}
        for pan in (-6.0, 0.0, 6.0)
        for tilt in (-3.0, 0.0, 3.0)
        for roll in (0.0, 90.0)
    ]
    suggested = next_poses(BENCH, [], candidates, 3)
    chosen = forecast(BENCH, [pose.angles_deg for pose in suggested]).projection_map.worst_px
    drawn = []
    for _ in range(15):
        chosen_at = rng.choice(len(candidates), 3, replace=False)
        drawn.append(forecast(BENCH, [candidates[i] for i in chosen_at]).projection_map.worst_px)
    assert chosen <= np.quantile(drawn, 0.2)


def test_a_pose_that_loses_the_tag_is_named():
    careful = replace(BENCH, needs_tag=True)
    assert forecast(careful, [POSES[0], {"pan_deg": 5.0}]).stars
    with pytest.raises(TooFewStars, match="pose 2: The tag"):
        forecast(careful, [POSES[0], {"pan_deg": 14.0}])
    with pytest.raises(DegenerateViews, match="0 of the candidate poses"):
        next_poses(careful, POSES[:2], [{"pan_deg": 14.0}])


@pytest.mark.parametrize(
    ("poses", "refused", "fault"),
    [
        ([], DegenerateViews, "No pose is planned"),
        ([{"pan": 5.0}], InputMismatch, "Unknown axis 'pan'"),
        ([{"pan_deg": np.nan}], InputMismatch, "not a finite number"),
    ],
)
def test_poses_without_meaning_are_refused(poses, refused, fault):
    with pytest.raises(refused, match=fault):
        forecast(BENCH, poses)


def test_one_pose_twice_will_not_constrain():
    square = {"pan_deg": 0.0}
    with pytest.raises(DegenerateViews, match="show the same pose"):
        forecast(BENCH, [square])


ERRORS = CollimatorErrors(rms_px=0.09)
REAL = replace(BENCH, star_sigma_px=0.014, errors=ERRORS)
NINE = poses_of((-6.0, 0.0, 6.0), (-2.5, 0.0, 2.5))
CERTIFICATE = Passport.of_radius(255.0, 0.05, length="seen")


def readings(bound):
    return GimbalReadings((), 0.002, parallax=bound, source="test")


BOUNDED = readings(ParallaxBound(0.066, 0.001, 0.0, 0.05))
KNOWN = {
    "nothing": {},
    "certificate": {"passport": CERTIFICATE},
    "bounded": {"readings": BOUNDED},
    "both": {"passport": CERTIFICATE, "readings": BOUNDED},
}


@cache
def of_nine(known):
    """The forecast of nine poses, with what is known."""
    return forecast(replace(REAL, **KNOWN[known]), NINE)


def test_a_certificate_that_does_not_say_its_length_is_expected_to_tell_less():
    """Either meaning counts by half: then the focal length, of which defocus makes another length, is open by percents."""
    seen, unsaid = (
        forecast(replace(BENCH, passport=passport), POSES)
        for passport in (CERTIFICATE, Passport.of_radius(255.0, 0.05))
    )
    assert unsaid.sigma["r"] > 5.0 * seen.sigma["r"]
    assert unsaid.sigma["fx"] > 1.5 * seen.sigma["fx"]


def largest(planned):
    return max(planned.budget_rows, key=lambda row: row.share["fx"]).name


def test_errors_of_the_collimator_dominate_and_more_poses_lower_them():
    ideal = forecast(replace(REAL, errors=CollimatorErrors()), NINE)
    three, nine = forecast(REAL, POSES), of_nine("nothing")
    assert nine.limited["expanded_fx"] > 2.5 * ideal.limited["expanded_fx"]
    assert nine.limited["expanded_fx"] < three.limited["expanded_fx"]
    assert nine.limited["worst_corner"] < three.limited["worst_corner"]
    rows = {row.name: row.contribution["fx"] for row in nine.budget_rows}
    assert rows[TURN_FIELDS] > rows[STARS] > 0
    assert rows[UNBOUNDED_PARALLAX] > 0.2 * rows[STARS]
    assert sum(row.share["fx"] for row in nine.budget_rows) == pytest.approx(1.0)


def of_pose_fields(planned):
    """What the fields of the poses add to cy."""
    return next(row.contribution["cy"] for row in planned.budget_rows if row.name == POSE_FIELDS)


def test_errors_that_differ_from_pose_to_pose_average_out():
    hand_moved = replace(REAL, errors=CollimatorErrors(rms_px=0.09, pupil_wander_mm=8.0))
    many = poses_of(np.linspace(-5, 5, 6), np.linspace(-2.5, 2.5, 6))
    parts = [of_pose_fields(forecast(hand_moved, poses)) for poses in (NINE, many)]
    assert parts[1] < 0.8 * parts[0]
    assert parts[0] > 3 * of_pose_fields(of_nine("nothing"))


@pytest.mark.parametrize(
    "bench", [REAL, replace(REAL, errors=CollimatorErrors()), replace(REAL, passport=CERTIFICATE)]
)
def test_repeats_of_a_pose_count_as_one(bench):
    once, often = forecast(bench, POSES), forecast(bench, [*POSES, *POSES, {**POSES[0], "pan_deg": -5.1}])
    assert often.limited == pytest.approx(once.limited)
    assert len(often.stars) == 7


def test_more_knowledge_never_widens_a_forecast():
    nothing, certified, read, both = (of_nine(known).limited for known in KNOWN)
    for name in ("expanded_fx", "expanded_fy", "worst_corner"):
        assert both[name] < 1.01 * min(certified[name], read[name])
        assert max(certified[name], read[name]) < 1.01 * nothing[name]


def test_a_certificate_leaves_its_own_uncertainty():
    rows = {row.name: row.contribution["fx"] for row in of_nine("certificate").budget_rows}
    assert rows[PASSPORT] == pytest.approx(3345 * 0.05 / 255, rel=0.1)


def test_parallax_dominates_if_its_bound_is_wide():
    narrow = of_nine("bounded")
    wide = forecast(replace(REAL, readings=readings(ParallaxBound(0.066, 0.005, 5.0, 4.0))), NINE)
    assert largest(wide) == PARALLAX
    assert largest(narrow) != PARALLAX
    assert narrow.limited["expanded_fx"] < wide.limited["expanded_fx"]
    assert narrow.remarks == wide.remarks == ()


def test_what_leaves_the_focal_length_to_the_stars_is_named():
    assert "Nothing but the stars" in of_nine("nothing").remarks[0]
    assert of_nine("certificate").remarks == ()
    assert "bound the parallax" in forecast(replace(REAL, readings=readings(None)), POSES).remarks[0]


def test_a_passport_from_views_makes_one_pose_enough():
    names = ("x", "y", "r", "radial", "radial_4")
    values = np.array([97.0, 140.1, 255.0, 0.1, 0.0])
    passport = Passport(names, values, np.diag([0.01, 0.01, 0.01, 1e-4, 1e-2]), (97.0, 140.1, 255.0))
    planned = forecast(replace(REAL, passport=passport), POSES[:1])
    assert planned.sigma["radial"] <= 0.01
    assert planned.sigma["fx"] < 10
    with pytest.raises(DegenerateViews):
        forecast(REAL, POSES[:1])


@pytest.mark.parametrize("bench", [BENCH, REAL])
def test_no_suggested_pose_repeats_another_one(bench):
    near = [{**pose, "pan_deg": pose["pan_deg"] + 0.1} for pose in POSES]
    far = [{"pan_deg": 3.0, "tilt_deg": -2.0}, {"pan_deg": 3.1, "tilt_deg": -2.1}]
    (only,) = next_poses(bench, POSES, [*POSES, *near, *far])
    assert only.angles_deg in far
    with pytest.raises(DegenerateViews, match="Only 1 of the"):
        next_poses(bench, POSES, [*POSES, *near, *far], 2)


def test_impossible_errors_are_refused():
    for wrong in (
        {"rms_px": -0.1},
        {"pupil_wander_mm": -1.0},
        {"defocus": float("nan")},
        {"pose_rms_px": -1},
    ):
        with pytest.raises(InputMismatch):
            CollimatorErrors(**wrong)
