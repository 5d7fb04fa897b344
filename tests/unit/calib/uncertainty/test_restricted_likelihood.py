"""Variances of maximum likelihood: pose by pose and with whole matrices."""

import numpy as np
import pytest

from calib.uncertainty.restricted_likelihood import DenseForms, PoseForms, maximum_likelihood

RNG = np.random.default_rng(11)
NOISE = 0.3


def poses(sizes=(5, 7, 6), shared=3):
    """Blocks of poses with different numbers of coefficients, and what the poses share."""
    blocks = []
    for size in sizes:
        own = RNG.normal(size=(40, size))
        blocks.append(own.T @ own)
    coupling = RNG.normal(size=(sum(sizes), shared))
    core = coupling.T @ coupling + 50.0 * np.eye(shared)
    group = np.concatenate([np.arange(size) % 3 for size in sizes])
    return blocks, coupling, core, group


def both(blocks, coupling, core, group, score):
    """The same likelihood in both forms."""
    width, sizes = max(map(len, blocks)), [len(block) for block in blocks]
    at = np.concatenate([i * width + np.arange(size) for i, size in enumerate(sizes)])
    whole, padded = np.zeros((len(score), len(score))), np.zeros((len(blocks), width, width))
    for i, block in enumerate(blocks):
        rows = slice(sum(sizes[:i]), sum(sizes[: i + 1]))
        whole[rows, rows] = padded[i, : len(block), : len(block)] = block
    normal = whole - coupling @ np.linalg.solve(core, coupling.T)
    count = len(blocks) * width
    groups, scores, rows = np.full(count, -1), np.zeros(count), np.zeros((count, coupling.shape[1]))
    groups[at], scores[at], rows[at] = group, score, coupling
    by_pose = PoseForms(scores, padded, rows, core, groups, NOISE)
    root = np.linalg.cholesky(normal).T
    parts = [root[:, group == kind] @ root[:, group == kind].T for kind in range(group.max() + 1)]
    return by_pose, DenseForms(np.linalg.solve(root.T, score), parts, NOISE * np.eye(len(score))), normal


def test_pose_by_pose_and_with_whole_matrices_are_the_same():
    given = poses()
    score = RNG.normal(size=len(given[3])) * 20.0
    by_pose, dense, _ = both(*given, score)
    for variances in (np.array([0.1, 2.0, 30.0]), np.array([1e-30, 1.0, 1e-8])):
        for one, other in zip(by_pose(variances), dense(variances), strict=True):
            assert one == pytest.approx(other, rel=1e-9)
        assert by_pose.information() == pytest.approx(dense.information(), rel=1e-7, abs=1e-12)
    start = np.full(3, 0.5)
    for one, other in zip(maximum_likelihood(by_pose, start), maximum_likelihood(dense, start), strict=True):
        assert one == pytest.approx(other, rel=1e-7)


def test_variances_that_made_the_scores_are_found():
    given = poses(sizes=(30,) * 12)
    true, group = np.array([0.2, 1.0, 5.0]), given[3]
    *_, normal = both(*given, np.zeros(len(group)))
    score = normal @ (np.sqrt(true[group]) * RNG.normal(size=len(group)))
    score += np.sqrt(NOISE) * np.linalg.cholesky(normal) @ RNG.normal(size=len(group))
    by_pose, _, _ = both(*given, score)
    found, fisher = maximum_likelihood(by_pose, np.ones(3))
    assert (np.abs(np.log(found / true)) < 4.0 / np.sqrt(np.diag(fisher))).all()


def test_a_component_that_starts_at_zero_stays_there():
    given = poses()
    by_pose, _, _ = both(*given, RNG.normal(size=len(given[3])))
    found, fisher = maximum_likelihood(by_pose, np.array([0.0, 1.0, 1.0]))
    assert found[0] == 0.0
    assert np.isfinite(found).all()
    assert not fisher[0].any()
