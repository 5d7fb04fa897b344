"""Readings of the gimbal as observations of the adjustment."""

import numpy as np
import pytest
from slow_cases import first_quick, slow

from calib import CalibrationOptions, Passport, calibrate
from calib.errors import InputMismatch
from calib.model.gimbal import Gimbal, aligned_gimbal
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.rotation import exp_map
from tests.support.drawn_benches import NINE, THREE, GimbalErrors, draw_bench

ON_PIVOT = ParallaxBound(0.066, 0.01, 0.0, 0.05)


def readings(bench, bound=ON_PIVOT, sigma_deg=0.002, scale_sigma=0.0, change=list):
    angles = tuple(change([dict(pose) for pose in bench.readings_deg]))
    return GimbalReadings(angles, sigma_deg, scale_sigma, 0.0, bound, "drawn")


def each(change):
    return lambda poses: [change(pose) for pose in poses]


def solved(bench, given, model="auto"):
    return calibrate(bench.views, CalibrationOptions(model=model, gimbal=given))


@pytest.mark.parametrize("profile", ["ideal", slow("S3")])
def test_readings_determine_the_focal_length_without_a_certificate(profile):
    bench = draw_bench(profile, NINE, 11)
    result = solved(bench, readings(bench))
    expanded = result.coverage_factor * result.sigma["fx"]
    assert result.gimbal is not None
    assert result.gimbal.entered
    assert abs(result.camera.fx - bench.truth.camera.fx) < min(expanded, 2.5)
    assert expanded < 3.0


@pytest.mark.slow
def test_without_a_bound_of_the_parallax_readings_say_less_of_the_focal_length():
    bench = draw_bench("S3", THREE, 12)
    unbounded, bounded = solved(bench, readings(bench, bound=None)), solved(bench, readings(bench))
    alone = calibrate(bench.views, CalibrationOptions())
    assert bounded.sigma["fx"] < 0.5 * unbounded.sigma["fx"] < alone.sigma["fx"]
    expanded = unbounded.coverage_factor * unbounded.sigma["fx"]
    assert abs(unbounded.camera.fx - bench.truth.camera.fx) < expanded


@pytest.mark.slow
def test_poses_at_neighbouring_angles_of_an_axis_share_what_its_encoder_is_off():
    """Nine poses of a grid read three angles of each axis; nine poses apart read nine. There is no step between."""
    grids = [
        [
            {"pan": pose["pan"] + apart * (k // 3), "tilt": pose["tilt"] + apart * (k % 3)}
            for k, pose in enumerate(NINE)
        ]
        for apart in (0.0, 0.03, 0.1, 1.1)
    ]
    same, close, near, far = np.mean(
        [
            [
                solved(bench, readings(bench, sigma_deg=0.005)).sigma["fx"]
                for bench in (draw_bench("ideal", poses, seed) for poses in grids)
            ]
            for seed in (11, 12, 13)
        ],
        axis=0,
    )
    assert same > 1.25 * far
    assert close == pytest.approx(same, rel=0.1)
    assert near == pytest.approx(close, rel=0.1)


def test_the_scale_of_the_encoders_enters_as_stated():
    bench = draw_bench("S3", NINE, 14)
    result = solved(bench, readings(bench, scale_sigma=1e-3))
    assert 0.5e-3 < result.sigma["fx"] / bench.truth.camera.fx < 1.25e-3
    assert abs(result.camera.fx - bench.truth.camera.fx) < 2.0 * result.sigma["fx"]


@pytest.fixture(scope="module")
def certified():
    """A bench with a certificate, and its calibration without readings."""
    bench, certificate = draw_bench("S3", NINE, 15), Passport.of_radius(255.0, 0.05, length="seen")
    return bench, certificate, calibrate(bench.views, CalibrationOptions(passport=certificate))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (each(lambda pose: {**pose, "pan_deg": 1.05 * pose["pan_deg"]}), "The pan axis turns 0.95"),
        slow(
            each(lambda pose: {**pose, "tilt_deg": pose["tilt_deg"] + (0.3 if pose["pan_deg"] > 1 else 0.0)}),
            "readings contradict the stars",
        ),
        slow(lambda poses: [poses[0], poses[2], poses[1], *poses[3:]], "The pose 'pose 3' does not fit"),
        # A scale of one axis fits them a little better than none.
        slow(lambda poses: [*poses[4:], *poses[:4]], "times as far as its readings say"),
    ],
    ids=["a wrong scale", "an axis that slips", "two poses swapped", "of other poses"],
)
def test_readings_that_contradict_the_stars_are_named_and_change_nothing(certified, change, words):
    bench, certificate, alone = certified
    options = CalibrationOptions(gimbal=readings(bench, change=change), passport=certificate)
    result = calibrate(bench.views, options)
    assert result.gimbal is not None
    assert not result.gimbal.entered
    assert result.camera.fx == alone.camera.fx
    assert result.sigma["fx"] == alone.sigma["fx"]
    assert any(words in note for note in result.notes)


@pytest.mark.slow
def test_readings_that_scatter_more_than_stated_get_less_weight_and_the_result_says_so():
    bench = draw_bench("S3", NINE, 16, errors=GimbalErrors(reading_sigma_deg=0.0065))
    result = solved(bench, readings(bench))
    assert result.gimbal is not None
    assert result.gimbal.entered
    assert 1.5 < result.gimbal.scatter < 4.0
    assert any("times more than stated" in note for note in result.notes)
    assert abs(result.camera.fx - bench.truth.camera.fx) < result.coverage_factor * result.sigma["fx"]


@pytest.mark.parametrize("roll_deg", first_quick([100.0, 0.0, 180.0, -60.0]))
def test_mounting_and_standing_are_found_however_the_camera_hangs(roll_deg):
    rng = np.random.default_rng(int(roll_deg) + 200)
    angles = np.array([[p["pan"], p["tilt"], 0.0] for p in NINE])
    mounting = exp_map(np.radians([0.0, 0.0, roll_deg])) @ exp_map(rng.normal(scale=0.02, size=3))
    gimbal = Gimbal(mounting, exp_map(rng.normal(scale=0.05, size=3)))
    aligned = aligned_gimbal(gimbal.rotations(angles), angles)
    assert np.allclose(aligned.rotations(angles), gimbal.rotations(angles), atol=1e-6)


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        ({"reading_sigma_deg": 0.0}, "reading_sigma_deg is 0.0; it must be positive"),
        ({"scale_sigma": -1e-4}, "scale_sigma is -0.0001; it must not be negative"),
        ({"eccentricity_deg": -1.0}, "eccentricity_deg"),
        ({"angles_deg": ({"yaw_deg": 1.0},)}, "Unknown axis 'yaw_deg'"),
        ({"angles_deg": ({"pan_deg": np.nan},)}, "An angle is not a finite number"),
        ({"angles_deg": ({"pan_deg": 1.0, "tilt_deg": 0.0}, {"pan_deg": 2.0})}, "Reading 2 has no tilt_deg"),
    ],
)
def test_statements_out_of_range_are_refused(changed, fault):
    with pytest.raises(InputMismatch, match=fault):
        GimbalReadings(**{"angles_deg": ({"pan_deg": 1.0},), "reading_sigma_deg": 0.002, **changed})
    with pytest.raises(InputMismatch, match="must not be negative"):
        ParallaxBound(0.0, -0.1, 0.0, 0.0)
