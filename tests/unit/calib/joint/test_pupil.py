"""The middles of the visible discs: estimated from all views, so that discs the image cuts off do not seem to wander."""

from __future__ import annotations

import numpy as np
import pytest

from calib.joint.pupil import estimated
from calib.model.beam import Disc

TURNS = np.tan(np.radians([[-6, 2], [6, 2], [0, -4], [-3, 4], [3, -3], [5, 4], [-5, -3], [2, 0], [-1, 1]]))
POSES = np.arange(len(TURNS))
WALK = np.array([[-44.0, 0.0], [0.0, -18.0]])  # mm, with the tangent of the turn


def drawn(seed, noise_mm, wander_mm):
    """Return discs as seen, and the truth; their fit says too small sigmas, as on benches with an uneven edge."""
    rng = np.random.default_rng(seed)
    truth = [3.0, -2.0] + TURNS @ WALK + wander_mm * rng.standard_normal(TURNS.shape)
    sigmas = noise_mm * rng.uniform(0.3, 1.5, len(TURNS))
    discs = [
        Disc(
            middle + sigma * rng.standard_normal(2),
            22.0,
            sigma,
            covariance_mm2=(sigma / 1.5) ** 2 * np.eye(2),
        )
        for middle, sigma in zip(truth, sigmas, strict=True)
    ]
    return discs, truth


@pytest.mark.parametrize("noise_mm", [0.5, 3.0, 9.0])
@pytest.mark.parametrize("seed", range(4))
def test_discs_that_are_known_badly_do_not_wander(noise_mm, seed):
    discs, _ = drawn(seed, noise_mm, 0.0)
    assert estimated(discs, POSES, TURNS).wander_mm < 2.5


@pytest.mark.parametrize("noise_mm", [0.5, 3.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_pupil_moved_by_hand_wanders(noise_mm, seed):
    discs, truth = drawn(seed, noise_mm, 12.0)
    aside = truth - truth.mean(axis=0)
    true_mm = np.sqrt((aside**2).sum(axis=1).mean())
    assert 0.6 * true_mm < estimated(discs, POSES, TURNS).wander_mm < 1.1 * true_mm


@pytest.mark.parametrize(("wander_mm", "share"), [(0.0, 0.6), (3.0, 0.9), (12.0, 1.0)])
def test_estimated_middles_are_nearer_to_the_truth_than_the_discs(wander_mm, share):
    seen, found = [], []
    for seed in range(20):
        discs, truth = drawn(seed, 5.0, wander_mm)
        seen.append(np.array([disc.centre_mm for disc in discs]) - truth)
        found.append(estimated(discs, POSES, TURNS).middles - truth)
    assert np.std(found) < share * np.std(seen)


def test_copies_of_a_disc_change_nothing():
    discs, _ = drawn(0, 5.0, 3.0)
    once = estimated(discs, POSES, TURNS)
    twice = estimated([*discs, *discs], np.concatenate([POSES, POSES]), TURNS)
    assert twice.middles == pytest.approx(once.middles)
    assert twice.wander_mm == pytest.approx(once.wander_mm)
