"""Cluster-robust covariance over views, with the CR2 correction of Bell and McCaffrey (2002).

At the optimum each view contributes a score s_i to the gradient. The sandwich covariance H^-1 (sum of s_i s_i^T) H^-1
(Liang and Zeger, 1986) estimates the covariance of the parameters, whatever causes the errors of the views. With few
views it is too small, because the optimum has followed each of them: the more the parameters depend on a view, the
smaller its score. Bell and McCaffrey (Survey Methodology 28, 2002) enlarge the scores, s_i -> B_i s_i, such that the
sandwich is unbiased if a working covariance of the scores is right, and nearly unbiased if it is roughly right. The
jackknife enlarges them more and overestimates.

Let A_i be the information of a view, H the information of all views and the prior, M_i the working covariance of the
score, K_i = A_i H^-1, and T the sum of all M_i and the covariance of the prior's score. The scores at the optimum have
covariances C_ij = d_ij M_i - K_i M_j - M_i K_j^T + K_i T K_j^T, and B_i is the symmetric solution of
B_i C_ii B_i^T = M_i. A direction that only one view determines has no score at the optimum; the working covariance
replaces it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: A direction in which the variance of a score is below this share of the largest is determined by that view alone.
_DETERMINED = 1e-9


@dataclass(frozen=True)
class ClusterRobustCovariance:
    """Diagonal of the cluster-robust covariance of the shared parameters."""

    variances: Array  # (G,) float64 variance of each parameter, in the square of its unit
    # (G,) float64 degrees of freedom of each variance (Satterthwaite, 1946), if the working covariance is
    # right; 0 if no score shows the parameter.
    degrees_of_freedom: Array


def cluster_robust_covariance(
    scores: Array, informations: Array, working: Array, prior: Array, prior_score_covariance: Array
) -> ClusterRobustCovariance:
    """Return the variances that the scores of the views show: CR2, Bell and McCaffrey (2002).

    scores: (n, G) score of each view at the optimum for the shared parameters, its local parameters
      eliminated.
    informations: (n, G, G) information of each view on the shared parameters.
    working: (n, G, G) working covariance of each score. Its scale matters only in directions that no score
      shows.
    prior: (G, G) prior information.
    prior_score_covariance: (G, G) covariance of the prior's score.
    """
    # Scaled to a unit diagonal: the parameters differ by many orders of magnitude.
    scale = 1.0 / np.sqrt(np.diag(informations.sum(axis=0) + prior))
    both = np.outer(scale, scale)
    own, noise, known = informations * both, working * both, prior_score_covariance * both
    inverse = np.linalg.inv(own.sum(axis=0) + prior * both)
    leverage = own @ inverse
    total = noise.sum(axis=0) + known
    crossed = leverage @ noise
    remaining = noise - crossed - crossed.transpose(0, 2, 1) + leverage @ total @ leverage.transpose(0, 2, 1)
    adjustments = np.array([_adjustment(m, c) for m, c in zip(noise, remaining, strict=True)])
    responses = inverse @ adjustments
    unseen = (noise - adjustments @ remaining @ adjustments.transpose(0, 2, 1)).sum(axis=0) + known
    contributions = np.einsum("njg,ng->nj", responses, scores * scale)
    variances = (contributions**2).sum(axis=0) + np.maximum(np.diag(inverse @ unseen @ inverse), 0.0)
    return ClusterRobustCovariance(variances * scale**2, _satterthwaite(responses, leverage, noise, total))


def _adjustment(noise: Array, remaining: Array) -> Array:
    """Return the CR2 matrix B with B C B^T = M on the range of the score: M^1/2 (M^1/2 C M^1/2)^-1/2 M^1/2.

    Source: Bell and McCaffrey (2002). This solution is the geometric mean of M and C^-1 (Bhatia, 2007, chapter 4).
    """
    root = _matrix_power(noise, 0.5)
    return np.asarray(root @ _matrix_power(root @ remaining @ root, -0.5) @ root)


def _matrix_power(matrix: Array, power: float) -> Array:
    """Return a power of a symmetric positive semidefinite matrix on its numerical range.

    Powers of the eigenvalues above the limit; the others give zero, as in a pseudoinverse.
    """
    eigenvalues, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    determined = eigenvalues > _DETERMINED * eigenvalues[-1]
    return np.asarray((vectors[:, determined] * eigenvalues[determined] ** power) @ vectors[:, determined].T)


def _satterthwaite(responses: Array, leverage: Array, noise: Array, total: Array) -> Array:
    """Return 2 E^2 / Var of each sum of squares, if the working covariance is right (Satterthwaite, 1946)."""
    by_all, by_own = responses @ leverage, responses @ noise
    crossed = np.einsum("njg,mjg->jnm", by_all, by_own)
    covariances = np.einsum("njg,gh,mjh->jnm", by_all, total, by_all) - crossed - crossed.transpose(0, 2, 1)
    each = np.arange(len(responses))
    covariances[:, each, each] += np.einsum("njg,njg->jn", by_own, responses)
    expected, squares = np.trace(covariances, axis1=1, axis2=2), (covariances**2).sum(axis=(1, 2))
    return np.asarray(np.divide(expected**2, squares, out=np.zeros_like(squares), where=squares > 0))
