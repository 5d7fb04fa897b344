"""Hand-eye check: readings against the rotations seen; faults are named with axis, pose and size; a good gimbal is not blamed."""

import numpy as np
import pytest
from drawn_gimbal import AXES, DrawnGimbal, draw_gimbal

from calib.diagnosis import gimbal_faults
from calib.diagnosis.hand_eye import check_hand_eye
from calib.diagnosis.hand_eye_verdict import HandEyeCheck, angle, angle_and_uncertainty
from calib.errors import DegenerateViews, InputMismatch
from calib.model.cause import EXCHANGED, REVERSED, Cause, cause_sentence
from calib.model.rotation import euler_zxy, exp_map


def quiet(seed: int, **drawn) -> DrawnGimbal:
    """Six poses seen to 2 arc seconds, and nothing that they share."""
    return draw_gimbal(seed, poses=6, range_deg=5.0, noise_arcsec=2.0, focal_sigma=0.0, **drawn)


def checked(bench: DrawnGimbal) -> HandEyeCheck:
    return check_hand_eye(bench.rotations, bench.covariance, bench.readings)


def test_a_true_gimbal_is_consistent_within_the_cameras_own_noise():
    benches = [quiet(seed) for seed in range(30)]
    checks = [checked(bench) for bench in benches]
    off = [np.deg2rad(check.residuals_arcsec.ravel() / 3600) for check in checks]
    squares = [o @ np.linalg.solve(bench.covariance, o) for o, bench in zip(off, benches, strict=True)]
    # 18 components, and 8 unknowns: mounting, standing and two scales.
    assert np.mean(squares) == pytest.approx(10, abs=3.5)
    assert sum(check.verdict.kind == "agrees" for check in checks) >= 29
    assert checks[0].rms_arcsec < 6


def test_a_scale_error_is_found_with_its_uncertainty():
    z = []
    for bench in (quiet(seed, scale_error=2e-3) for seed in range(30)):
        check = checked(bench)
        z += [(check.scale[AXES[i]] - bench.scales[i]) / check.scale_sigma[AXES[i]] for i in (0, 1)]
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.35)


def test_a_reading_that_is_off_shows_in_arc_seconds():
    bench = quiet(5)
    bench.angles[1, 0] += 60.0 / 3600
    check = checked(bench)
    assert check.verdict.kind != "agrees"
    assert np.linalg.norm(check.residuals_arcsec, axis=1).argmax() == 1
    assert np.abs(check.residuals_arcsec[1]).max() > 25


def test_a_turntable_has_one_scale_and_no_more():
    poses, sigma = [-5.0, -2.0, 1.0, 4.0], np.deg2rad(2.0 / 3600)
    turns = np.array([exp_map(np.array([0.01, 0.0, 0.02])) @ euler_zxy(1.001 * pan, 0.0) for pan in poses])
    check = check_hand_eye(turns, np.eye(12) * sigma**2, [{"pan_deg": pan} for pan in poses])
    assert list(check.scale) == ["pan_deg"]
    assert check.scale["pan_deg"] == pytest.approx(1.001, abs=1e-9)


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


# ---------------------------------------------------------------- the verdict


NINE = {"poses": 9, "raster": True, "range_deg": 6.0, "noise_arcsec": 2.0}
BIASED = {"bias_deg": 0.08, "focal_error": 0.029, "focal_sigma": 0.016}


def judged(bench: DrawnGimbal, *, birge_ratio: float = 1.0, **options) -> HandEyeCheck:
    return check_hand_eye(
        bench.rotations,
        bench.covariance,
        bench.readings,
        focal_uncertainty=3 * bench.focal_sigma,
        birge_ratio=birge_ratio,
        **options,
    )


def text_of(check: HandEyeCheck) -> str:
    return " ".join(check.verdict.says)


@pytest.mark.parametrize(
    ("seed", "slip", "others"),
    [
        (1, (0, 4, 0.05), {}),
        (2, (1, 6, 0.3), {}),
        (3, (0, 4, -12.0), {}),
        (4, (1, 4, 0.05), {"wrong": (7, 0.3)}),
        (5, (0, 4, 0.3), {"wrong": (1, 0.5)}),
        (6, (2, 5, 0.2), {"roll_range_deg": 90.0}),
        (7, (0, 2, 0.2), {"poses": 5}),
    ],
)
def test_a_slip_is_named_with_axis_pose_and_size(seed, slip, others):
    check = judged(draw_gimbal(seed, **(NINE | others), slip=slip))
    assert check.verdict.kind == "slip"
    (fault,) = [each for each in check.faults if each.kind == "slip"]
    assert (fault.axis, fault.pose) == slip[:2]
    assert fault.size_deg == pytest.approx(-slip[2], abs=5 * fault.sigma_deg)
    assert fault.probability < 1e-4
    bad = [each.pose for each in check.faults if each.kind == "pose"]
    assert bad == ([others["wrong"][0]] if "wrong" in others else [])
    assert f"between pose {slip[1]} and pose {slip[1] + 1}" in text_of(check)
    assert ("more" if slip[2] > 0 else "less") + " than the axis turned" in text_of(check)


def test_a_slip_is_seen_through_the_errors_of_a_collimator():
    check = judged(draw_gimbal(8, **NINE, bias_deg=0.05, slip=(0, 4, 0.5)), birge_ratio=7.0)
    assert check.verdict.kind == "slip"
    assert check.faults[0].size_deg == pytest.approx(-0.5, abs=4 * check.faults[0].sigma_deg)


@pytest.mark.parametrize("birge_ratio", [1.0, 7.0])
@pytest.mark.parametrize("poses", [3, 9])
def test_biased_views_show_no_fault_of_the_gimbal(poses, birge_ratio):
    for seed in (20, 21):
        check = judged(draw_gimbal(seed, **(NINE | {"poses": poses}), **BIASED), birge_ratio=birge_ratio)
        assert not check.faults
        assert check.verdict.kind in ("agrees", "views_biased", "scatter"), seed
        assert "slipped between" not in text_of(check)
        assert all(0.9 < scale < 1.2 for scale in check.scale.values())


def test_without_its_threshold_the_search_finds_faults_that_are_not_there(monkeypatch):
    monkeypatch.setattr(gimbal_faults, "needed", lambda places: -20.0 / places)
    assert judged(draw_gimbal(20, **NINE, **BIASED)).faults


@pytest.mark.parametrize("poses", [5, 9])
@pytest.mark.parametrize("noise_arcsec", [3.0, 20.0, 100.0])
def test_readings_that_scatter_show_no_fault(poses, noise_arcsec):
    for seed in range(30, 32):
        bench, rng = draw_gimbal(seed, **(NINE | {"poses": poses})), np.random.default_rng(seed)
        readings = [
            {axis: deg + noise_arcsec / 3600 * rng.standard_normal() for axis, deg in reading.items()}
            for reading in bench.readings
        ]
        check = check_hand_eye(bench.rotations, bench.covariance, readings, focal_uncertainty=6e-4)
        assert not check.faults, seed


def test_scatter_below_what_is_stated_of_the_readings_is_no_fault_and_scatter_above_it_is_told():
    bench, rng = draw_gimbal(31, **NINE), np.random.default_rng(31)
    readings = [
        {axis: deg + 0.005 * rng.standard_normal() for axis, deg in reading.items()}
        for reading in bench.readings
    ]

    def check_with(**stated):
        return check_hand_eye(bench.rotations, bench.covariance, readings, focal_uncertainty=6e-4, **stated)

    assert check_with(reading_sigma_deg=0.006).verdict.kind == "agrees"
    assert "slipped" not in text_of(check_with(reading_sigma_deg=0.006))
    for stated in ({}, {"reading_sigma_deg": 0.001}):
        assert check_with(**stated).verdict.kind == "scatter"
        assert "differ more than their stated uncertainties explain, by" in text_of(check_with(**stated))


def test_an_error_of_the_encoder_that_a_row_of_a_raster_shares_is_no_slip():
    bench = draw_gimbal(31, **(NINE | {"poses": 25}))
    sigma_deg, last = 0.0025, max(reading["tilt_deg"] for reading in bench.readings)

    def check_with(shared_deg):
        rng = np.random.default_rng(5)
        readings = [
            {axis: deg + sigma_deg * rng.standard_normal() for axis, deg in reading.items()}
            for reading in bench.readings
        ]
        for reading, true in zip(readings, bench.readings, strict=True):
            reading["tilt_deg"] += shared_deg * (true["tilt_deg"] > last - 0.01)
        return check_hand_eye(
            bench.rotations, bench.covariance, readings, reading_sigma_deg=sigma_deg, focal_uncertainty=6e-4
        )

    assert check_with(3.0 * sigma_deg).verdict.kind == "agrees"
    assert check_with(40.0 * sigma_deg).verdict.kind == "slip"


def test_a_mount_that_creeps_shows_no_fault():
    for seed in range(40, 44):
        bench, rng = draw_gimbal(seed, **NINE), np.random.default_rng(seed)
        creep = np.linspace(0, np.deg2rad(0.02), 9)[:, None] * rng.standard_normal(3)
        check = check_hand_eye(
            exp_map(creep) @ bench.rotations, bench.covariance, bench.readings, focal_uncertainty=6e-4
        )
        assert not check.faults, seed


def test_a_wrong_pose_is_named():
    check = judged(draw_gimbal(9, **NINE, wrong=(3, 0.2)), names=["a", "b", "c", "left", "e"])
    assert check.verdict.kind == "wrong_pose"
    assert [fault.pose for fault in check.faults] == [3]
    assert check.faults[0].size_deg == pytest.approx(0.2, abs=0.01)
    assert "Pose 4 (left) does not fit" in text_of(check)


def test_two_faults_that_hide_each_other_are_both_named():
    bench, readings = draw_gimbal(16, **NINE, wrong=(2, 0.1)), []
    for number, reading in enumerate(bench.readings):
        readings.append(reading | {"pan_deg": reading["pan_deg"] + 0.1 * (number == 6)})
    check = check_hand_eye(bench.rotations, bench.covariance, readings, focal_uncertainty=6e-4)
    assert {(fault.kind, fault.pose) for fault in check.faults} == {("pose", 2), ("pose", 6)}
    readings = []
    for number, reading in enumerate(draw_gimbal(17, **NINE).readings):
        slipped = {"pan_deg": 0.1 * (number >= 3), "tilt_deg": -0.15 * (number >= 5)}
        readings.append({axis: deg + slipped[axis] for axis, deg in reading.items()})
    bench = draw_gimbal(17, **NINE)
    check = check_hand_eye(bench.rotations, bench.covariance, readings, focal_uncertainty=6e-4)
    assert {(fault.axis, fault.pose) for fault in check.faults} == {(0, 3), (1, 5)}


def test_axes_that_are_not_at_right_angles_are_measured():
    check = judged(draw_gimbal(10, **NINE, square_deg=0.1))
    assert check.verdict.kind == "not_square"
    assert check.faults[0].size_deg == pytest.approx(0.1, abs=4 * check.faults[0].sigma_deg)


def test_a_common_ratio_within_the_uncertainty_of_the_focal_length_is_not_the_gimbals():
    bench = draw_gimbal(11, **NINE, focal_error=0.029, focal_sigma=0.016)
    check = judged(bench)
    assert check.verdict.kind == "agrees"
    assert check.pairs.ratio == pytest.approx(1.029, abs=1e-3)
    assert "too short" in text_of(check)
    assert "So the two agree. If the gimbal is right" in text_of(check)
    assert "too long" in text_of(judged(draw_gimbal(11, **NINE, focal_error=-0.029, focal_sigma=0.016)))
    # The same ratio far outside the uncertainty of the focal length is the gimbal's.
    known = check_hand_eye(
        bench.rotations, np.eye(27) * np.deg2rad(2 / 3600) ** 2, bench.readings, focal_uncertainty=4e-4
    )
    assert known.verdict.kind == "gimbal_scale"
    assert "the scale of the gimbal is in question" in " ".join(known.verdict.says)


def test_a_scale_within_what_is_stated_of_the_axes_is_no_fault():
    bench = quiet(5, scale_error=5e-4)
    given = bench.rotations, bench.covariance, bench.readings
    assert check_hand_eye(*given, focal_uncertainty=1e-4).verdict.kind == "scale_or_parallax"
    assert check_hand_eye(*given, focal_uncertainty=1e-4, scale_sigma=5e-4).verdict.kind == "agrees"
    assert (
        check_hand_eye(*given, focal_uncertainty=1e-4, scale_sigma=5e-5).verdict.kind == "scale_or_parallax"
    )


def test_a_small_ratio_can_be_parallax_too():
    bench = draw_gimbal(12, **NINE, focal_error=0.008, focal_sigma=1e-4)
    check = check_hand_eye(
        bench.rotations, np.eye(27) * np.deg2rad(2 / 3600) ** 2, bench.readings, focal_uncertainty=4e-4
    )
    assert check.verdict.kind == "scale_or_parallax"
    assert "Below about 1 % nothing tells the two apart" in " ".join(check.verdict.says)


def test_axes_with_different_ratios_show_the_scale_of_the_gimbal():
    bench = draw_gimbal(13, **NINE)
    readings = [reading | {"pan_deg": reading["pan_deg"] / 1.05} for reading in bench.readings]
    check = check_hand_eye(bench.rotations, bench.covariance, readings, focal_uncertainty=4e-4)
    assert check.verdict.kind == "gimbal_scale"
    assert check.scale["pan_deg"] == pytest.approx(1.05, abs=0.002)
    assert "not the same along all axes" in " ".join(check.verdict.says)


@pytest.mark.parametrize(
    ("signs", "axes"),
    [
        ((-1, 1, 0), "pan or of tilt"),
        ((1, -1, 0), "pan or of tilt"),
        ((1, 1, -1), "roll"),
        ((-1, 1, 1), "pan or of tilt"),
        ((-1, 1, -1), "roll and of one other axis"),
        ((1, 1, 1), ""),
        ((-1, -1, 0), ""),  # a camera mounted upside down
    ],
)
def test_a_wrong_sign_is_named(signs, axes):
    rng = np.random.default_rng(3)
    true = rng.uniform(-1, 1, (10, 3)) * (6, 4, 60 * abs(signs[2]))
    mounted, standing = exp_map(np.array([0.02, -0.03, 0.4])), euler_zxy(3, -4, 12)
    turns = np.array([mounted @ euler_zxy(*row) @ standing for row in true])
    sigma = np.deg2rad(2 / 3600)
    rotations = exp_map(sigma * rng.standard_normal((10, 3))) @ turns
    readings = [dict(zip(AXES[: 2 + abs(signs[2])], row, strict=False)) for row in true * signs]
    check = check_hand_eye(rotations, np.eye(30) * sigma**2, readings, focal_uncertainty=4e-4)
    assert check.verdict.kind == ("wrong_sign" if axes else "agrees")
    assert not axes or text_of(check).startswith(f"The sign of {axes} is reversed")


def test_exchanged_axes_are_told_with_a_wrong_sign_which_looks_the_same():
    rng = np.random.default_rng(3)
    true = rng.uniform(-1, 1, (10, 2)) * (6, 4)
    mounted, standing = exp_map(np.array([0.02, -0.03, 0.4])), euler_zxy(3, -4, 12)
    rotations = np.array([mounted @ euler_zxy(*row, 0.0) @ standing for row in true])
    readings = [dict(zip(AXES[:2], row[::-1], strict=True)) for row in true]
    check = check_hand_eye(rotations, np.eye(30) * 1e-10, readings, focal_uncertainty=4e-4)
    assert check.verdict.kind == "wrong_sign"
    assert "Two axes whose cables or addresses are exchanged look the same" in text_of(check)
    assert "exchanged look the same" in cause_sentence(
        Cause(REVERSED, 50.0, axis="pan or of tilt", beside=(EXCHANGED,))
    )
    assert "exchanged" not in cause_sentence(Cause(REVERSED, 50.0, axis="roll"))


def test_mountings_that_cannot_be_told_apart_give_no_scale():
    rng = np.random.default_rng(4)
    true = np.array([(0.0, 0.0), (5.0, 5.0), (0.0, 0.0), (5.0, 5.0)])
    sigma = np.deg2rad(2 / 3600)
    rotations = exp_map(sigma * rng.standard_normal((4, 3))) @ np.array([euler_zxy(*row) for row in true])
    readings = [dict(zip(AXES, row, strict=False)) for row in true]
    check = check_hand_eye(rotations, np.eye(12) * sigma**2, readings)
    assert check.verdict.kind == "ambiguous"
    assert check.scale == {}
    assert check.pairs.ratio == pytest.approx(1.0, abs=1e-3)


def test_three_poses_that_disagree_are_too_few_to_name_the_cause():
    bench = draw_gimbal(14, **(NINE | {"poses": 3}))
    readings = [dict(reading) for reading in bench.readings]
    readings[1]["pan_deg"] += 0.1
    check = check_hand_eye(bench.rotations, bench.covariance, readings, focal_uncertainty=4e-4)
    assert check.verdict.kind == "scatter"
    assert "too few to tell which" in " ".join(check.verdict.says)


def test_angles_are_degrees_from_a_tenth_on_and_arc_seconds_below():
    assert angle(0.1) == "0.10 degrees"
    assert angle(-12.34) == "12. degrees" or angle(-12.34) == "12 degrees"
    assert angle(0.05) == "180 arc seconds"
    assert angle_and_uncertainty(-0.30001, 0.005) == "0.300 ± 0.010 degrees (k = 2)"
    assert angle_and_uncertainty(0.01, 0.0002) == "36.0 ± 1.4 arc seconds (k = 2)"


@pytest.mark.parametrize("seed", [1, 2])
def test_a_camera_that_turned_in_its_mount_is_told_from_a_slipped_axis(seed):
    bench, turn = draw_gimbal(seed, **NINE), exp_map(np.radians([0.1, -0.2, 0.15]))
    seen = [turn @ rotation if k >= 4 else rotation for k, rotation in enumerate(bench.rotations)]
    check = check_hand_eye(np.array(seen), bench.covariance, bench.readings, focal_uncertainty=6e-4)
    assert check.verdict.kind == "camera_turned"
    (fault,) = check.faults
    assert (fault.kind, fault.pose, fault.rival) == ("mount", 4, None)
    assert fault.size_deg == pytest.approx(np.linalg.norm([0.1, 0.2, 0.15]), abs=0.01)
    assert "The camera turned in its mount between pose 4 and pose 5" in text_of(check)
