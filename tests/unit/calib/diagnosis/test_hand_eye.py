"""Hand-eye check: readings against the rotations seen; what explains them is named with what stands beside it."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_gimbal import AXES, DrawnGimbal, draw_gimbal
from slow_cases import first_quick

from calib.diagnosis.hand_eye import check_hand_eye
from calib.diagnosis.hand_eye_result import AGREES, AMBIGUOUS, OFF_SCALE, HandEyeCheck
from calib.errors import DegenerateViews, InputMismatch
from calib.model import cause as kinds
from calib.model.cause import cause_sentence
from calib.model.rotation import euler_zxy, exp_map


def quiet(seed: int, **drawn) -> DrawnGimbal:
    """Six poses seen to 2 arc seconds, and nothing that they share."""
    return draw_gimbal(seed, poses=6, range_deg=5.0, noise_arcsec=2.0, focal_sigma=0.0, **drawn)


def judged(bench: DrawnGimbal, **options) -> HandEyeCheck:
    return check_hand_eye(bench.rotations, bench.covariance, bench.readings, **options)


def test_a_scale_error_is_found_with_its_uncertainty():
    z = []
    for bench in (quiet(seed, scale_error=2e-3) for seed in range(8)):
        check = judged(bench)
        z += [(check.scale[AXES[i]] - bench.scales[i]) / check.scale_sigma[AXES[i]] for i in (0, 1)]
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.35)


def test_a_reading_that_is_off_shows_in_arc_seconds():
    bench = quiet(5)
    bench.angles[1, 0] += 60.0 / 3600
    check = judged(bench)
    assert check.verdict != AGREES
    assert np.linalg.norm(check.residuals_arcsec, axis=1).argmax() == 1
    assert np.abs(check.residuals_arcsec[1]).max() > 25


def test_a_turntable_has_one_scale_and_no_more():
    poses, sigma = [-5.0, -2.0, 1.0, 4.0], np.deg2rad(2.0 / 3600)
    turns = np.array([exp_map(np.array([0.01, 0.0, 0.02])) @ euler_zxy(1.001 * pan, 0.0) for pan in poses])
    check = check_hand_eye(turns, np.eye(12) * sigma**2, [{"pan_deg": pan} for pan in poses])
    assert list(check.scale) == ["pan_deg"]
    assert check.scale["pan_deg"] == pytest.approx(1.001, abs=1e-9)


def test_rotations_without_any_uncertainty_agree_with_their_readings():
    angles = np.array([[-5.0, 2.0], [0.0, -3.0], [4.0, 1.0], [2.0, 4.0]])
    turns = [exp_map(np.array([0.01, 0.0, 0.02])) @ euler_zxy(pan, tilt) for pan, tilt in angles]
    check = check_hand_eye(
        np.array(turns), np.zeros((12, 12)), [dict(zip(AXES, a, strict=False)) for a in angles]
    )
    assert check.verdict == AGREES
    assert list(check.scale.values()) == pytest.approx([1.0, 1.0], abs=1e-6)


@pytest.mark.parametrize(
    ("readings", "error", "match"),
    [
        ([{"pan_deg": 1.0}] * 5, InputMismatch, "6 rotations, but 5"),
        ([{"yaw_deg": 1.0}] * 6, InputMismatch, "Known: pan_deg"),
        ([{"pan_deg": 1.0}] * 6, DegenerateViews, "0 axes moved"),
    ],
)
def test_readings_that_say_nothing_are_refused(readings, error, match):
    bench = quiet(6)
    with pytest.raises(error, match=match):
        check_hand_eye(bench.rotations, bench.covariance, readings)


# ---------------------------------------------------------------- what explains rotations and readings


NINE = {"poses": 9, "raster": True, "range_deg": 6.0, "noise_arcsec": 2.0}
BIASED = {"bias_deg": 0.08, "focal_error": 0.029, "focal_sigma": 0.016}
#: 1 sigma of a reading, degrees.
READ = 0.0025


def seen(change, *, left=True):
    """Turn what the camera sees of each pose by a rotation vector, degrees, in its frame or in the target's."""

    def changed(bench, rng):
        turns = exp_map(np.radians([change(k, rng) for k in range(len(bench.angles))]))
        return replace(bench, rotations=turns @ bench.rotations if left else bench.rotations @ turns)

    return changed


def read(change):
    return lambda bench, rng: replace(bench, angles=change(bench.angles.copy(), rng))


def stepped(axis, deg, last=9):
    def change(angles, _):
        angles[4:last, axis] += deg
        return angles

    return read(change)


AXIS = np.array([0.6, 0.8, 0.0])
MISTAKES = {
    "camera knocked": (kinds.TURNED, seen(lambda k, _: 0.05 * (k >= 4) * AXIS)),
    "collimator knocked": (kinds.MOVED, seen(lambda k, _: 0.1 * (k >= 4) * AXIS, left=False)),
    "target turned": (kinds.HELD, seen(lambda k, _: [0.0, 0.0, 0.3 * (k >= 4)], left=False)),
    "target turned in a holder that leans": (
        kinds.HELD,
        seen(lambda k, _: 0.3 * (k >= 4) * np.array([0.0, 0.1, 1.0]), left=False),
    ),
    "camera creeps": (kinds.CREEPS, seen(lambda k, _: 0.02 * k * AXIS)),
    "collimator creeps": (kinds.SHIFTS, seen(lambda k, _: 0.02 * k * AXIS, left=False)),
    "camera loose": (kinds.LOOSE, seen(lambda _, rng: rng.normal(0, 0.02, 3))),
    "readings scatter": (kinds.SCATTERED, read(lambda a, rng: a + rng.normal(0, 0.02, a.shape) * (1, 1, 0))),
    "pan slips": (kinds.SLIPPED, stepped(0, 0.3)),
    "tilt slips": (kinds.SLIPPED, stepped(1, 0.05)),
    "one reading wrong": (kinds.ONE_POSE, stepped(0, 0.2, 5)),
    "sign of tilt": (kinds.REVERSED, read(lambda a, _: a * (1, -1, 1))),
    "axes exchanged": (kinds.EXCHANGED, read(lambda a, _: a[:, [1, 0, 2]])),
    "one pose late": (kinds.LATE, read(lambda a, _: np.roll(a, 1, axis=0))),
    "one pose early": (kinds.LATE, read(lambda a, _: np.roll(a, -1, axis=0))),
    "scale of pan": (kinds.AXIS_SCALE, read(lambda a, _: a * (1.05, 1, 1))),
    "tilt halved": (kinds.AXIS_SCALE, read(lambda a, _: a * (1, 0.5, 1))),
    "gon": (kinds.UNITS, read(lambda a, _: a / 0.9)),
    "readings of other poses": (kinds.NONE_FITS, read(lambda a, _: a[[4, 7, 1, 0, 8, 3, 6, 2, 5]])),
}


@pytest.mark.parametrize("name", first_quick(MISTAKES, 4))
def test_a_mistake_is_named_alone_or_as_one_of_three(name):
    kind, change = MISTAKES[name]
    rng = np.random.default_rng(5)
    bench = change(draw_gimbal(1, **NINE, focal_sigma=1e-4), rng)
    readings = [{axis: deg + rng.normal(0, READ) for axis, deg in one.items()} for one in bench.readings]
    check = check_hand_eye(bench.rotations, bench.covariance, readings, reading_sigma_deg=READ)
    first = check.causes[0]
    assert kind in {first.kind, *first.beside}
    assert len(first.beside) <= 2
    assert ("One of these" in check.says[0] or "one of these" in check.says[0]) == bool(first.beside)


@pytest.mark.parametrize(("left", "kind"), [(True, kinds.CREEPS), (False, kinds.SHIFTS)])
def test_what_creeps_goes_by_the_times_of_the_poses_and_repeated_poses_show_it(left, kind):
    times = np.array([0.0, 0.04, 0.08, 0.12, 0.16, 0.2, 0.9, 0.95, 1.0])
    bench = draw_gimbal(1, **NINE, focal_sigma=1e-4)
    again = np.array([0, 1, 2, 3, 4, 5, 0, 1, 2])
    bench = replace(bench, rotations=bench.rotations[again], angles=bench.angles[again])
    bench = seen(lambda k, _: 0.1 * times[k] * AXIS, left=left)(bench, None)
    (cause,) = judged(bench, reading_sigma_deg=READ, times=times).causes
    assert (cause.kind, cause.value) == (kind, pytest.approx(0.1, abs=1.5 * cause.expanded))


def test_few_poses_do_not_tell_a_loose_camera_from_errors_of_the_collimator():
    loose = seen(lambda _, rng: rng.normal(0, 0.05, 3))
    bench = loose(draw_gimbal(1, **(NINE | {"poses": 5})), np.random.default_rng(5))
    (cause,) = judged(bench, reading_sigma_deg=READ).causes
    assert (cause.kind, cause.beside) == (kinds.LOOSE, (kinds.BIASED,))


@pytest.mark.parametrize(
    ("seed", "slip", "others"),
    first_quick(
        [
            (1, (0, 4, 0.05), {}),
            (3, (0, 4, -6.0), {}),
            (4, (1, 4, 0.05), {"wrong": (7, 0.3)}),
            (5, (0, 4, 0.3), {"wrong": (1, 0.5)}),
            (6, (2, 5, 0.2), {"roll_range_deg": 90.0}),
            (7, (0, 2, 0.2), {"poses": 5}),
        ],
        2,
    ),
)
def test_a_slip_is_named_with_axis_pose_and_size(seed, slip, others):
    check = judged(draw_gimbal(seed, **(NINE | others), slip=slip))
    (found,) = [each for each in check.found if each.suspect.kind == kinds.SLIPPED]
    assert (found.suspect.axis, found.suspect.pose) == slip[:2]
    assert np.degrees(found.size_rad) == pytest.approx(-slip[2], abs=5 * np.degrees(found.sigma_rad))
    wrong = [each.suspect.pose for each in check.found if each.suspect.kind == kinds.ONE_POSE]
    assert wrong == ([others["wrong"][0]] if "wrong" in others else [])
    told = next(sentence for sentence in check.says if "slipped between" in sentence)
    assert f"'{slip[1]}' and '{slip[1] + 1}'" in told
    assert ("more" if slip[2] > 0 else "less") + " than the axis turned" in told


@pytest.mark.parametrize("birge_ratio", [1.0, 7.0])
@pytest.mark.parametrize("poses", first_quick([3, 9]))
def test_biased_views_show_no_fault_of_the_gimbal(poses, birge_ratio):
    for seed in (20, 21):
        check = judged(draw_gimbal(seed, **(NINE | {"poses": poses}), **BIASED), birge_ratio=birge_ratio)
        assert not check.found
        assert check.verdict in (AGREES, kinds.BIASED, kinds.LOOSE), seed
        assert all(0.9 < scale < 1.2 for scale in check.scale.values())


def scattered(readings, sigma_deg, rng):
    return [{axis: deg + sigma_deg * rng.normal() for axis, deg in reading.items()} for reading in readings]


def test_scatter_below_what_is_stated_of_the_readings_is_no_fault_and_scatter_above_it_is_told():
    bench, rng = draw_gimbal(31, **NINE), np.random.default_rng(31)
    readings = scattered(bench.readings, 0.005, rng)

    def check_with(**stated):
        return check_hand_eye(bench.rotations, bench.covariance, readings, **stated)

    assert check_with(reading_sigma_deg=0.006).verdict == AGREES
    assert check_with().verdict == kinds.SCATTERED


@pytest.mark.slow
def test_an_error_of_the_encoder_that_a_row_of_a_raster_shares_is_no_slip():
    bench = draw_gimbal(31, **(NINE | {"poses": 25}))
    last = max(reading["tilt_deg"] for reading in bench.readings)

    def check_with(shared_deg):
        rng = np.random.default_rng(5)
        readings = scattered(bench.readings, READ, rng)
        for reading, true in zip(readings, bench.readings, strict=True):
            reading["tilt_deg"] += shared_deg * (true["tilt_deg"] > last - 0.01)
        return check_hand_eye(bench.rotations, bench.covariance, readings, reading_sigma_deg=READ)

    assert check_with(3.0 * READ).verdict == AGREES
    assert check_with(40.0 * READ).causes[0].kind == kinds.SLIPPED


def test_a_wrong_pose_at_an_end_may_be_a_step_there():
    for pose, beside in ((3, ()), (8, (kinds.TURNED, kinds.MOVED))):
        check = judged(draw_gimbal(9, **NINE, wrong=(pose, 0.2)), names=list("abcdefghi"))
        (cause,) = check.causes
        assert (cause.kind, cause.pose, cause.beside) == (kinds.ONE_POSE, "abcdefghi"[pose], beside)
        assert cause.value == pytest.approx(0.2, abs=0.01)


def test_two_faults_that_hide_each_other_are_both_named():
    bench = draw_gimbal(16, **NINE, wrong=(2, 0.1))
    bench.angles[6, 0] += 0.1
    found = {(each.suspect.kind, each.suspect.pose) for each in judged(bench).found}
    assert found == {(kinds.ONE_POSE, 2), (kinds.ONE_POSE, 6)}
    bench = draw_gimbal(17, **NINE)
    bench.angles[3:, 0] += 0.1
    bench.angles[5:, 1] -= 0.15
    assert {(each.suspect.axis, each.suspect.pose) for each in judged(bench).found} == {(0, 3), (1, 5)}


def test_axes_that_are_not_at_right_angles_are_measured():
    (found,) = judged(draw_gimbal(10, **NINE, square_deg=0.1)).found
    assert found.suspect.kind == kinds.NOT_SQUARE
    assert np.degrees(found.size_rad) == pytest.approx(0.1, abs=4 * np.degrees(found.sigma_rad))


@pytest.mark.slow
def test_a_scale_that_the_focal_length_or_what_is_stated_explains_is_no_fault():
    assert judged(draw_gimbal(11, **NINE, focal_error=0.029, focal_sigma=0.016)).verdict == AGREES
    bench = quiet(5, scale_error=5e-4)
    assert judged(bench).verdict == OFF_SCALE
    assert judged(bench, scale_sigma=5e-4).verdict == AGREES
    known = draw_gimbal(12, **NINE, focal_error=0.029, focal_sigma=1e-4)
    assert {cause.kind for cause in judged(known).causes} == {kinds.AXIS_SCALE}


@pytest.mark.parametrize(
    ("signs", "axes"),
    first_quick(
        [
            ((-1, 1, 0), "pan or of tilt"),
            ((1, 1, -1), "roll"),
            ((-1, 1, 1), "pan or of tilt"),
            ((-1, 1, -1), "roll and of one other axis"),
            ((1, 1, 1), ""),
            ((-1, -1, 0), ""),  # a camera mounted upside down
        ]
    ),
)
def test_a_wrong_sign_is_named(signs, axes):
    rng = np.random.default_rng(3)
    true = rng.uniform(-1, 1, (6, 3)) * (6, 4, 60 * abs(signs[2]))
    mounted, standing = exp_map(np.array([0.02, -0.03, 0.4])), euler_zxy(3, -4, 12)
    turns = np.array([mounted @ euler_zxy(*row) @ standing for row in true])
    sigma = np.deg2rad(2 / 3600)
    rotations = exp_map(sigma * rng.standard_normal((6, 3))) @ turns
    readings = [dict(zip(AXES[: 2 + abs(signs[2])], row, strict=False)) for row in true * signs]
    check = check_hand_eye(rotations, np.eye(18) * sigma**2, readings)
    assert [(cause.kind, cause.axis) for cause in check.causes] == ([(kinds.REVERSED, axes)] if axes else [])
    assert not axes or f"sign of {axes} is wrong" in cause_sentence(check.causes[0])


def test_mountings_that_cannot_be_told_apart_give_no_scale():
    rng = np.random.default_rng(4)
    true = np.array([(0.0, 0.0), (5.0, 5.0), (0.0, 0.0), (5.0, 5.0)])
    sigma = np.deg2rad(2.0 / 3600)
    rotations = exp_map(sigma * rng.standard_normal((4, 3))) @ np.array([euler_zxy(*row) for row in true])
    readings = [dict(zip(AXES, row, strict=False)) for row in true]
    check = check_hand_eye(rotations, np.eye(12) * sigma**2, readings)
    assert check.verdict == AMBIGUOUS
    assert check.scale == {}
    assert check.pairs.ratio == pytest.approx(1.0, abs=1e-3)
