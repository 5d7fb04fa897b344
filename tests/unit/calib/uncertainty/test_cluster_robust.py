"""The cluster-robust covariance: unbiased if the working covariance is right, nearly unbiased otherwise."""

import numpy as np
import pytest

from calib.uncertainty.cluster_robust import cluster_robust_covariance

NOTHING = np.zeros((3, 3))


def experiment(rng, views=5, shared=3):
    """Views with very unequal information, and the covariance of the score of each."""
    columns = rng.standard_normal((views, 12, shared)) * rng.uniform(0.2, 2.0, (views, 1, shared))
    informations = columns.transpose(0, 2, 1) @ columns
    field = columns.transpose(0, 2, 1) @ rng.standard_normal((views, 12, 2)) * 3.0
    return informations, informations + field @ field.transpose(0, 2, 1)


def repeated(rng, informations, truth, working, prior=NOTHING, prior_score_covariance=NOTHING, runs=600):
    """Mean over runs of the stated variances, of those of the plain sandwich, and the true variances."""
    roots, prior_root = (
        np.linalg.cholesky(truth),
        np.linalg.cholesky(prior_score_covariance + 1e-12 * np.eye(3)),
    )
    inverse = np.linalg.inv(informations.sum(axis=0) + prior)
    stated, plain = [], []
    for _ in range(runs):
        drawn = np.einsum("nij,nj->ni", roots, rng.standard_normal(roots.shape[:2]))
        off = inverse @ (drawn.sum(axis=0) + prior_root @ rng.standard_normal(3))
        scores = drawn - informations @ off
        stated.append(
            cluster_robust_covariance(scores, informations, working, prior, prior_score_covariance).variances
        )
        plain.append(((scores @ inverse) ** 2).sum(axis=0))
    true = np.diag(inverse @ (truth.sum(axis=0) + prior_score_covariance) @ inverse)
    return np.mean(stated, axis=0), np.mean(plain, axis=0), true


def test_of_equal_views_it_is_the_scatter_of_their_means():
    values = np.array([1.0, 4.0, 2.0, 9.0])[:, None]
    one = np.ones((4, 1, 1))
    found = cluster_robust_covariance(values - values.mean(), one, one, np.zeros((1, 1)), np.zeros((1, 1)))
    assert found.variances == pytest.approx(values.var(ddof=1) / 4)
    assert found.degrees_of_freedom == pytest.approx(3.0)


def test_it_has_no_bias_where_the_working_covariance_is_right_in_shape():
    rng = np.random.default_rng(120)
    informations, truth = experiment(rng)
    stated, plain, true = repeated(rng, informations, truth, 7.0 * truth)
    assert stated / true == pytest.approx(np.ones(3), rel=0.12)
    assert (plain / true).min() < 0.75


def test_stars_noise_as_the_working_covariance_leaves_little_bias_of_ten_views():
    rng = np.random.default_rng(121)
    informations, truth = experiment(rng, views=10)
    stated, _, true = repeated(rng, informations, truth, informations, runs=300)
    assert stated / true == pytest.approx(np.ones(3), rel=0.2)


def test_what_is_known_beforehand_is_part_of_it():
    rng = np.random.default_rng(122)
    informations, truth = experiment(rng)
    prior = np.diag([30.0, 0.1, 5.0])
    stated, _, true = repeated(rng, informations, truth, truth, prior, prior)
    assert stated / true == pytest.approx(np.ones(3), rel=0.12)


def test_what_one_view_alone_determines_comes_from_the_working_covariance():
    informations = np.array([np.diag([1.0, 4.0]), np.diag([1.0, 0.0]), np.diag([1.0, 0.0])])
    scores = np.array([[0.5, 0.0], [-0.25, 0.0], [-0.25, 0.0]])
    found = cluster_robust_covariance(
        scores, informations, 2.0 * informations, np.zeros((2, 2)), np.zeros((2, 2))
    )
    # The first: the sample's variance over 3. The second: 2 * 4 / 4^2, as no score shows it.
    assert found.variances == pytest.approx([0.1875 / 3, 0.5])
    assert found.degrees_of_freedom == pytest.approx([2.0, 0.0])


def test_units_are_of_no_matter():
    rng = np.random.default_rng(123)
    informations, truth = experiment(rng)
    scores = rng.standard_normal((5, 3))
    scores -= informations @ np.linalg.solve(informations.sum(axis=0), scores.sum(axis=0))
    units = np.array([1e-5, 1.0, 1e4])
    here = cluster_robust_covariance(scores, informations, truth, NOTHING, NOTHING)
    there = cluster_robust_covariance(
        scores * units, *(each * np.outer(units, units) for each in (informations, truth, NOTHING, NOTHING))
    )
    assert there.variances == pytest.approx(here.variances / units**2)
    assert there.degrees_of_freedom == pytest.approx(here.degrees_of_freedom)
