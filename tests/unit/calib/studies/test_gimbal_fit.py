"""Fit of a gimbal to rotations: the lowest minimum is found, over drawn benches, and absurd ones are avoided."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from drawn_gimbal import DrawnGimbal, draw_gimbal

from calib.model.gimbal import mountings
from calib.model.rotation import exp_map
from calib.studies import gimbal_faults
from calib.studies.gimbal_model import GimbalModel
from calib.studies.hand_eye import check_hand_eye
from calib.studies.hand_eye_fit import (
    Metric,
    SeenRotations,
    first_explanation,
    global_fit,
    refine,
    scales_near,
    seen_minus_read,
)

KINDS = {
    "star noise": {},
    "scale errors": {"scale_error": 0.02},
    "large scale errors": {"scale_error": 0.1},
    "wrong focal length": {"focal_error": 0.03, "focal_sigma": 0.02},
    "biased views": {"bias_deg": 0.1, "focal_error": 0.03, "focal_sigma": 0.02},
    "camera rolled between poses": {"roll_range_deg": 80.0},
}


def model_of(bench: DrawnGimbal) -> GimbalModel:
    free = tuple(int(i) for i in np.flatnonzero(np.ptp(bench.angles, axis=0) > 0.5))
    return GimbalModel(bench.angles, free if 3 * len(bench.angles) > 6 + len(free) else ())


def found_and_lowest(bench: DrawnGimbal, tries: int) -> tuple[float, float]:
    """Chi-square of the fit, and the lowest one from a grid of random mountings, standings and scales."""
    model = model_of(bench)
    seen = SeenRotations(bench.rotations, bench.covariance)
    found = first_explanation(seen, model, model.start)
    rng = np.random.default_rng(1)
    lowest = np.inf
    for _ in range(tries):
        turned = [exp_map(np.pi * rng.uniform(-1, 1, 3)) for _ in range(2)]
        values = model.start * rng.uniform(0.8, 1.25, model.parameter_count)
        other = refine(bench.rotations, model, found.metric, *turned, values)
        if scales_near(other, model.start):
            lowest = min(lowest, other.chi_square)
    return found.fit.chi_square, lowest


@pytest.mark.parametrize("kind", KINDS)
def test_no_start_leads_to_a_lower_minimum(kind):
    for seed in (0, 3):
        found, lowest = found_and_lowest(draw_gimbal(seed, **KINDS[kind]), 25)
        assert found <= lowest + 1e-4 * (1 + lowest), seed


@pytest.mark.slow
@pytest.mark.parametrize("poses", [3, 4, 9, 25])
@pytest.mark.parametrize("kind", KINDS)
def test_none_of_hundreds_of_starts_leads_to_a_lower_minimum(kind, poses):
    for seed in range(10, 13):
        found, lowest = found_and_lowest(draw_gimbal(seed, poses=poses, **KINDS[kind]), 300)
        assert found <= lowest + 1e-4 * (1 + lowest), seed


def test_the_stated_covariance_alone_leads_to_absurd_scales():
    # Views that a collimator biases, and a shared uncertainty of the focal length: Peelle's pertinent puzzle.
    bench = draw_gimbal(
        5,
        poses=9,
        raster=True,
        range_deg=6,
        bias_deg=0.1,
        focal_error=0.03,
        focal_sigma=0.016,
        noise_arcsec=10,
    )
    model, stated = model_of(bench), Metric.of(bench.covariance)
    alone = global_fit(bench.rotations, model, stated, model.start)
    lowest = min(alone, key=lambda fit: fit.chi_square)
    assert np.abs(lowest.values[:2]).max() < 0.9
    found = check_hand_eye(bench.rotations, bench.covariance, bench.readings)
    assert list(found.scale.values()) == pytest.approx([1.03, 1.03], abs=0.02)
    assert found.excess_arcsec == pytest.approx(360, rel=0.5)


def test_the_closed_form_start_is_exact_without_noise():
    bench = draw_gimbal(2, poses=8, noise_arcsec=1e-6)
    model = model_of(bench)
    pairs = zip(*mountings(bench.rotations, model.heads(model.start)[0]), strict=True)
    off = [seen_minus_read(bench.rotations, model, *pair, model.start)[0] for pair in pairs]
    assert min(np.abs(one).max() for one in off) < 1e-9


def test_derivatives_are_those_of_differences():
    bench = draw_gimbal(4, poses=7, roll_range_deg=30.0)
    model = GimbalModel(bench.angles, (0, 1, 2), slips=((0, 3), (2, 5)), squareness=True, smooth=True)
    rng = np.random.default_rng(0)
    values = model.start
    values[3:6] = (0.02, -0.03, 0.01)
    a, b = exp_map(rng.standard_normal(3)), exp_map(rng.standard_normal(3))
    off, jacobian = seen_minus_read(bench.rotations, model, a, b, values)
    # At seen = read the logarithm is linear, so the rotations are those that are read.
    read = exp_map(-off.reshape(-1, 3)) @ bench.rotations
    for column in range(6, 6 + model.parameter_count):
        shifted = values.copy()
        shifted[column - 6] += 1e-6
        there, _ = seen_minus_read(read, model, a, b, shifted)
        assert -there / 1e-6 == pytest.approx(jacobian[:, column], abs=1e-5), column
    for column, (turned_a, turned_b) in enumerate(
        [(exp_map(1e-6 * axis) @ a, b) for axis in np.eye(3)]
        + [(a, exp_map(1e-6 * axis) @ b) for axis in np.eye(3)]
    ):
        there, _ = seen_minus_read(read, model, turned_a, turned_b, values)
        assert -there / 1e-6 == pytest.approx(jacobian[:, column], abs=1e-5), column


def test_the_excess_makes_the_chi_square_equal_to_its_degrees_of_freedom():
    bench = draw_gimbal(6, poses=12, bias_deg=0.05)
    model = model_of(bench)
    seen = SeenRotations(bench.rotations, bench.covariance)
    found = first_explanation(seen, model, model.start)
    assert found.fit.chi_square == pytest.approx(found.fit.degrees_of_freedom(), rel=0.02)
    assert replace(found.metric, excess=0.0).whitening.max() > found.metric.whitening.max()


def test_mirror_images_are_not_rivals():
    # A mounting turned by half a turn about x with a negative scale of pan gives the same rotations.
    bench = draw_gimbal(7, poses=9, raster=True, range_deg=6, noise_arcsec=2)
    found = check_hand_eye(bench.rotations, bench.covariance, bench.readings)
    assert found.verdict.kind == "agrees"
    assert all(scale == pytest.approx(1.0, abs=0.01) for scale in found.scale.values())


def test_an_error_that_all_poses_share_does_not_blur_one_of_them():
    poses, common, own = 6, 1e-3, 1e-5
    covariance = np.kron(common**2 * np.ones((poses, poses)) + own**2 * np.eye(poses), np.eye(3))
    seen = SimpleNamespace(covariance=covariance)
    null = SimpleNamespace(kept=np.arange(poses))
    sigma = gimbal_faults.sigma_of_pose(seen, null, 2, 0.0)
    # The mean of five others is known to own / sqrt(5).
    assert sigma == pytest.approx(own * np.sqrt(1 + 1 / 5), rel=0.01)
