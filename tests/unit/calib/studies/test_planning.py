"""The expected uncertainty of planned poses."""

from dataclasses import replace

import numpy as np
import pytest

from calib.engine import CalibrationOptions, calibrate
from calib.errors import DegenerateViews, InputMismatch, TooFewStars
from calib.model.camera import CameraModel
from calib.model.collimator import Collimator
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.passport import Passport
from calib.model.type_b_terms import TypeBTerm
from calib.studies.collimator_errors import CollimatorErrors
from calib.studies.planning import forecast, next_poses
from calib.studies.predicted_views import RIM_IN_VIEW, ExpectedBench
from calib.uncertainty.budget_parts import PARALLAX_BOUND, PASSPORT, READINGS, STARS
from calib.uncertainty.common_errors import COMMON_ERRORS
from calib.uncertainty.covariance import INCONSISTENCY
from calib.uncertainty.passport_propagation import UNBOUNDED_PARALLAX
from calib.uncertainty.projection_uncertainty import projection_uncertainty

CAMERA = CameraModel(3345.0, 3345.0, 640.0, 360.0, (1280, 720), {"k1": 0.06, "k2": -0.9})
BENCH = ExpectedBench(CAMERA, Collimator(97.0, 140.1, 255.0), 12.0, 0.05, needs_tag=False)
POSES = [
    {"pan_deg": -5.0, "tilt_deg": 2.0},
    {"pan_deg": 0.5, "tilt_deg": -2.5, "roll_deg": 10.0},
    {"pan_deg": 5.0, "tilt_deg": 2.5, "roll_deg": -20.0},
]


def test_the_forecast_is_what_a_calibration_then_states(bench):
    result = calibrate(bench.views(np.random.default_rng(91), 0.05), CalibrationOptions(loss="l2"))
    expected = forecast(BENCH, POSES)
    for name, sigma in result.sigma.items():
        assert expected.sigma[name] == pytest.approx(sigma, rel=0.1)
    assert expected.projection_map.worst_px == pytest.approx(
        projection_uncertainty(result.camera, result.camera_covariance, 9).worst_px, rel=0.1
    )
    assert expected.stars == pytest.approx([view.n for view in result.views], abs=6)


def test_a_passport_lowers_what_is_expected():
    passport = Passport(("x", "y", "r"), np.array([97.0, 140.1, 255.0]), np.eye(3) * 1e-8)
    known = ExpectedBench(CAMERA, BENCH.collimator, 12.0, 0.05, passport=passport, needs_tag=False)
    assert forecast(known, POSES).sigma["fx"] < 0.1
    assert forecast(known, POSES[:1]).sigma["fx"] < 0.5


def test_the_next_pose_lowers_the_worst_uncertainty_more_than_any_other():
    candidates = [
        {"pan_deg": pan, "tilt_deg": tilt} for pan in (-6.0, -2.0, 2.0, 6.0) for tilt in (-2.5, 0.0, 2.5)
    ]
    (best,) = next_poses(BENCH, POSES[:2], candidates)
    worst = {
        i: forecast(BENCH, [*POSES[:2], pose]).projection_map.worst_px for i, pose in enumerate(candidates)
    }
    assert candidates.index(best.angles_deg) == min(worst, key=lambda i: worst[i])


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
    drawn = [
        forecast(
            BENCH, [candidates[i] for i in rng.choice(len(candidates), 3, replace=False)]
        ).projection_map.worst_px
        for _ in range(15)
    ]
    assert chosen <= np.quantile(drawn, 0.2)


def test_a_pose_that_loses_the_tag_is_named():
    careful = replace(BENCH, needs_tag=True)
    assert forecast(careful, [POSES[0], {"pan_deg": 5.0}]).stars
    with pytest.raises(TooFewStars, match="pose 2: The tag"):
        forecast(careful, [POSES[0], {"pan_deg": 14.0}])
    with pytest.raises(DegenerateViews, match="0 of the candidate poses"):
        next_poses(careful, POSES[:2], [{"pan_deg": 14.0}])


def test_one_pose_twice_will_not_constrain():
    square = {"pan_deg": 0.0}
    with pytest.raises(DegenerateViews, match="cannot separate fx and r"):
        forecast(BENCH, [square])


ERRORS = CollimatorErrors(rms_px=0.09)
REAL = replace(BENCH, star_sigma_px=0.014, model="radial", errors=ERRORS)
NINE = [{"pan_deg": pan, "tilt_deg": tilt} for pan in (-6.0, 0.0, 6.0) for tilt in (-2.5, 0.0, 2.5)]
CERTIFICATE = Passport.of_radius(255.0, 0.05)


def readings(bound):
    return GimbalReadings((), 0.002, parallax=bound, source="test")


def largest(found):
    return max(found.budget_rows, key=lambda row: row.share["fx"]).name


def test_errors_of_the_collimator_dominate_and_more_poses_lower_them():
    ideal = forecast(replace(REAL, errors=CollimatorErrors()), NINE)
    three, nine = forecast(REAL, POSES), forecast(REAL, NINE)
    assert ideal.coverage_factor == pytest.approx(2.0, abs=0.01)
    assert min(nine.coverage_factor, three.coverage_factor) > 2.1
    assert nine.limited["expanded_fx"] > 10 * ideal.limited["expanded_fx"]
    assert nine.limited["expanded_fx"] < three.limited["expanded_fx"]
    assert largest(nine) == UNBOUNDED_PARALLAX
    assert "parallax of about 1 % cannot be excluded" in nine.remarks[1]
    rows = {row.name: row.contribution["fx"] for row in nine.budget_rows}
    assert rows[UNBOUNDED_PARALLAX] == pytest.approx(33.45, rel=0.01)
    assert rows[INCONSISTENCY] > 5 * rows[STARS]
    assert UNBOUNDED_PARALLAX not in {row.name for row in ideal.budget_rows}
    assert sum(row.share["fx"] for row in nine.budget_rows) == pytest.approx(1.0)


def test_errors_that_all_views_share_do_not_average_out():
    bench = replace(REAL, passport=CERTIFICATE)
    many = [
        {"pan_deg": pan, "tilt_deg": tilt}
        for pan in np.linspace(-5, 5, 6)
        for tilt in np.linspace(-2.5, 2.5, 6)
    ]
    parts = []
    for poses in (NINE, many):
        rows = {row.name: row.contribution["cy"] for row in forecast(bench, poses).budget_rows}
        parts.append((rows[COMMON_ERRORS], rows[INCONSISTENCY]))
    (few_shared, few_own), (many_shared, many_own) = parts
    assert many_shared > 0.8 * few_shared > 0
    assert many_own < 0.7 * few_own
    assert many_shared > many_own


def test_few_poses_and_views_with_a_centre_each_show_no_shared_errors():
    for bench, poses in (
        (REAL, POSES),
        (replace(REAL, errors=CollimatorErrors()), NINE),
        (replace(REAL, model="drift"), NINE),
    ):
        assert COMMON_ERRORS not in {row.name for row in forecast(bench, poses).budget_rows}


@pytest.mark.parametrize(
    "bench", [REAL, replace(REAL, errors=CollimatorErrors()), replace(REAL, passport=CERTIFICATE)]
)
def test_repeats_of_a_pose_count_as_one(bench):
    once, often = forecast(bench, POSES), forecast(bench, [*POSES, *POSES, {**POSES[0], "pan_deg": -5.1}])
    assert often.limited == pytest.approx(once.limited)
    assert len(often.stars) == 7


def test_a_certificate_leaves_its_own_uncertainty_and_that_of_the_effective_radius():
    found = forecast(replace(REAL, passport=CERTIFICATE), NINE)
    rows = {row.name: row.contribution["fx"] for row in found.budget_rows}
    assert rows[PASSPORT] == pytest.approx(3345 * 0.05 / 255, rel=0.02)
    assert largest(found) == "effective radius"
    stated = TypeBTerm("effective radius", "effective_radius", 1e-5, "test")
    better = forecast(replace(REAL, passport=CERTIFICATE, terms=(stated,)), NINE)
    assert largest(better) == PASSPORT
    assert better.limited["expanded_fx"] < found.limited["expanded_fx"]


def test_a_certificate_and_readings_share_the_focal_length_by_their_weights():
    bound = readings(ParallaxBound(0.066, 0.001, 0.0, 0.05))
    certified = forecast(replace(REAL, passport=CERTIFICATE), NINE)
    read = forecast(replace(REAL, readings=bound), NINE)
    both = forecast(replace(REAL, passport=CERTIFICATE, readings=bound), NINE)
    rows = {row.name: row.contribution["fx"] for row in both.budget_rows}
    assert both.limited["expanded_fx"] < min(
        certified.limited["expanded_fx"], read.limited["expanded_fx"] + 0.01
    )
    assert 0 < rows["effective radius"] < 1
    assert 0 < rows[PASSPORT] < rows["effective radius"]
    assert sum(row.share["fx"] for row in both.budget_rows) == pytest.approx(1.0)


def test_readings_that_repeat_share_their_error():
    """A grid of nine poses has three readings of each axis; poses that differ in every reading give more."""
    bench = replace(
        REAL, errors=CollimatorErrors(), readings=readings(ParallaxBound(0.066, 0.001, 0.0, 0.05))
    )
    apart = [{axis: angle + 0.03 * i for axis, angle in pose.items()} for i, pose in enumerate(NINE)]
    rows = [
        next(row for row in forecast(bench, poses).budget_rows if row.name == READINGS)
        for poses in (NINE, apart)
    ]
    grid, scattered = (row.contribution["fx"] for row in rows)
    assert 1.1 < grid / scattered < 2


def test_parallax_dominates_if_its_bound_is_wide():
    narrow = forecast(replace(REAL, readings=readings(ParallaxBound(0.066, 0.001, 0.0, 0.05))), NINE)
    wide = forecast(replace(REAL, readings=readings(ParallaxBound(0.066, 0.005, 5.0, 4.0))), NINE)
    assert largest(wide) == PARALLAX_BOUND
    assert largest(narrow) != PARALLAX_BOUND
    assert narrow.limited["expanded_fx"] < 4 < wide.limited["expanded_fx"]
    assert narrow.remarks == wide.remarks == ()


def test_readings_that_will_not_enter_are_named():
    alone = forecast(REAL, NINE)
    assert "Nothing but the stars" in alone.remarks[0]
    unbounded = forecast(replace(REAL, readings=readings(None)), NINE)
    hand_held = replace(REAL, errors=replace(ERRORS, pupil_wander_mm=8.0))
    bound = ParallaxBound(0.066, 0.001, 0.0, 0.05)
    wandering = forecast(replace(hand_held, readings=readings(bound)), NINE)
    assert unbounded.limited == pytest.approx(alone.limited)
    assert "does not bound their parallax" in unbounded.remarks[0]
    assert "times more than stated" in wandering.remarks[0]
    assert wandering.limited == pytest.approx(forecast(hand_held, NINE).limited)


@pytest.mark.parametrize("model", ["spherical", "drift", "planar", "auto", "pupil", "field", "coma"])
def test_every_model_has_a_forecast(model):
    found = forecast(replace(REAL, model=model), NINE)
    assert found.model == ("radial" if model == "auto" else model)
    assert 0.1 < found.sigma["fx"] < 1000
    assert found.sigma.keys().isdisjoint({"parallax_x", "mounting_x"})


def test_a_passport_from_views_holds_its_terms():
    names = ("x", "y", "r", "radial", "radial_4")
    values = np.array([97.0, 140.1, 255.0, 0.1, 0.0])
    passport = Passport(names, values, np.diag([0.01, 0.01, 0.01, 1e-4, 1e-2]), (97.0, 140.1, 255.0))
    found = forecast(replace(REAL, passport=passport), POSES[:1])
    assert largest(found) == PASSPORT
    assert found.sigma["radial"] == pytest.approx(0.01)


@pytest.mark.parametrize("bench", [BENCH, REAL])
def test_no_suggested_pose_repeats_another_one(bench):
    near = [{**pose, "pan_deg": pose["pan_deg"] + 0.1} for pose in POSES]
    far = [{"pan_deg": 3.0, "tilt_deg": -2.0}, {"pan_deg": 3.1, "tilt_deg": -2.1}]
    (only,) = next_poses(bench, POSES, [*POSES, *near, *far])
    assert only.angles_deg in far
    with pytest.raises(DegenerateViews, match="Only 1 of the candidate poses"):
        next_poses(bench, POSES, [*POSES, *near, *far], 2)


def test_poses_that_show_the_rim_come_first_if_the_model_needs_it():
    candidates = [
        {"pan_deg": pan, "tilt_deg": tilt} for pan in (-9.0, -3.0, 3.0, 9.0) for tilt in (-3.0, 3.0)
    ]
    inside = [{"pan_deg": pan, "tilt_deg": tilt} for pan, tilt in ((-1.0, 0.0), (1.0, 0.5), (0.0, -0.5))]
    field = replace(REAL, model="field")
    (first,) = next_poses(field, inside, candidates)
    assert first.rim_share >= RIM_IN_VIEW
    assert "field model needs" in first.rim_reason
    assert "only 0 of 3 poses" in " ".join(forecast(field, inside).remarks)
    assert (
        "nothing but the stars" in next_poses(replace(REAL, model="auto"), inside, candidates)[0].rim_reason
    )
    known = replace(REAL, model="auto", passport=CERTIFICATE)
    assert next_poses(known, inside, candidates)[0].rim_reason == ""


def test_impossible_errors_are_refused():
    for wrong in ({"rms_px": -0.1}, {"pupil_wander_mm": -1.0}, {"defocus": float("nan")}):
        with pytest.raises(InputMismatch):
            CollimatorErrors(**wrong)
