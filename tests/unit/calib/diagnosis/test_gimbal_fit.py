"""Fit of a gimbal to rotations: the lowest minimum is found, over drawn benches, and absurd ones are avoided."""

import numpy as np
import pytest
from drawn_gimbal import DrawnGimbal, draw_gimbal
from slow_cases import first_quick

from calib.diagnosis.gimbal_model import GimbalModel, fit_at, global_fit, refine, scales_near
from calib.diagnosis.hand_eye import check_hand_eye
from calib.diagnosis.hand_eye_result import AGREES
from calib.diagnosis.suspects import Suspect
from calib.diagnosis.weighed_suspects import Explanation, SeenRotations
from calib.model import cause as kinds
from calib.model.gimbal import mountings
from calib.model.rotation import exp_map

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
    n = len(bench.angles)
    return GimbalModel(bench.angles, np.linspace(0, 1, n), free if 3 * n > 6 + len(free) else ())


def explained(bench: DrawnGimbal) -> Explanation:
    model = model_of(bench)
    start = global_fit(bench.rotations, model, np.eye(len(bench.covariance)), model.start)[0]
    return SeenRotations(bench.rotations, bench.covariance, start).explain(model, start)


def found_and_lowest(bench: DrawnGimbal, tries: int) -> tuple[float, float]:
    """Chi-square of the fit, and the lowest one from a grid of random mountings, standings and scales."""
    model = model_of(bench)
    explanation = explained(bench)
    rng = np.random.default_rng(1)
    lowest = np.inf
    for _ in range(tries):
        turned = [exp_map(np.pi * rng.uniform(-1, 1, 3)) for _ in range(2)]
        values = model.start * rng.uniform(0.8, 1.25, len(model.start))
        other = refine(bench.rotations, model, explanation.scatter.whitening, (*turned, values))
        if scales_near(other, model.start):
            lowest = min(lowest, other.chi_square)
    return explanation.fit.chi_square, lowest


@pytest.mark.parametrize("kind", first_quick(KINDS, 2))
def test_no_start_leads_to_a_lower_minimum(kind):
    for seed in (0, 3):
        chi_square, lowest = found_and_lowest(draw_gimbal(seed, **KINDS[kind]), 25)
        assert chi_square <= lowest + 1e-4 * (1 + lowest), seed


def test_the_stated_covariance_alone_leads_to_absurd_scales():
    # Views that a collimator biases, and a shared uncertainty of the focal length: Peelle's pertinent puzzle.
    drawn = {"poses": 9, "raster": True, "range_deg": 6, "bias_deg": 0.1, "noise_arcsec": 10}
    bench = draw_gimbal(5, **drawn, focal_error=0.03, focal_sigma=0.016)
    model = model_of(bench)
    whitening = np.linalg.inv(np.linalg.cholesky(bench.covariance))
    alone = global_fit(bench.rotations, model, whitening, model.start)
    lowest = min(alone, key=lambda fit: fit.chi_square)
    assert np.abs(lowest.values[:2]).max() < 0.9
    check = check_hand_eye(bench.rotations, bench.covariance, bench.readings)
    assert list(check.scale.values()) == pytest.approx([1.03, 1.03], abs=0.02)
    assert check.excess_arcsec == pytest.approx(360, rel=0.5)


def test_the_closed_form_start_is_exact_without_noise():
    bench = draw_gimbal(2, poses=8, noise_arcsec=1e-6)
    model, equal = model_of(bench), np.eye(24)
    pairs = zip(*mountings(bench.rotations, model.heads(model.start)), strict=True)
    off = [fit_at(bench.rotations, model, equal, (*pair, model.start)).off for pair in pairs]
    assert min(np.abs(by_start).max() for by_start in off) < 1e-9


def test_derivatives_are_those_of_differences():
    bench = draw_gimbal(4, poses=7, roll_range_deg=30.0)
    suspects = (
        Suspect(kinds.SLIPPED, 0, 3),
        Suspect(kinds.ONE_POSE, pose=2),
        Suspect(kinds.NOT_SQUARE),
        Suspect(kinds.MOVED, pose=4),
        Suspect(kinds.SLIPPED, 2, 5),
    )
    times = np.linspace(0, 1, len(bench.angles))
    model, equal = GimbalModel(bench.angles, times, (0, 1, 2), suspects), np.eye(21)
    rng = np.random.default_rng(0)
    values = model.start
    values[[3, 7, 11]] = (0.02, 0.01, -0.03)
    a, b = exp_map(rng.standard_normal(3)), exp_map(rng.standard_normal(3))
    fit = fit_at(bench.rotations, model, equal, (a, b, values))
    # At seen = read the logarithm is linear, so the rotations are those that are read.
    read = exp_map(-fit.off.reshape(-1, 3)) @ bench.rotations
    steps = 1e-6 * np.eye(6 + len(values))
    for step, slopes in zip(steps, fit.jacobian.T, strict=True):
        moved = exp_map(step[:3]) @ a, exp_map(step[3:6]) @ b, values + step[6:]
        there = fit_at(read, model, equal, moved).off
        assert -there / 1e-6 == pytest.approx(slopes, abs=1e-5)


def test_mirror_images_are_not_rivals():
    # A mounting turned by half a turn about x with a negative scale of pan gives the same rotations.
    bench = draw_gimbal(7, poses=9, raster=True, range_deg=6, noise_arcsec=2)
    check = check_hand_eye(bench.rotations, bench.covariance, bench.readings)
    assert check.verdict == AGREES
    assert all(scale == pytest.approx(1.0, abs=0.01) for scale in check.scale.values())
