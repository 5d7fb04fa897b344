"""What views disagree on, by each view's own pull at the shared parameters: the sandwich covariance, made unbiased.

Knows linear algebra only. At the optimum each view still pulls at the parameters, s_i; the squares of these pulls say
what the views' errors are worth, whatever their cause: H^-1 (sum of s_i s_i^T) H^-1. With few views that is too little,
as the optimum has followed each of them: a view's pull is smaller the more the parameters rest on it. Bell and
McCaffrey (Survey Methodology 28, 2002) enlarge each, s_i -> B_i s_i, such that the sandwich has no bias where a working
covariance of the pulls is right; where it is only roughly so, little bias is left. The jackknife enlarges them further,
by the inverse of what the other views know alone, and overstates.

With A_i a view's information, H all together, M_i the working covariance of its pull, K_i = A_i H^-1 and T the sum of
all M and the prior's: the pulls at the optimum have covariances
C_ij = d_ij M_i - K_i M_j - M_i K_j^T + K_i T K_j^T,
and B_i is the symmetric-rooted solution of B_i C_ii B_i^T = M_i. Directions that one view tells alone show nothing
there; the working covariance stands for them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Directions in which a view's pull varies by less than this share of the most are told by that view alone.
_DETERMINED = 1e-9


@dataclass(frozen=True)
class ClusterRobustCovariance:
    """Variances of the shared parameters by the views' pulls.

    Attributes
    ----------
    variances
        (G,) of each parameter.
    degrees_of_freedom
        (G,) degrees of freedom behind each (Satterthwaite, were the working covariance right); 0: no pull shows it.
    """

    variances: Array
    degrees_of_freedom: Array


def cluster_robust_covariance(
    scores: Array, informations: Array, working: Array, prior: Array, prior_score_covariance: Array
) -> ClusterRobustCovariance:
    """Return the variances that the views' own pulls show.

    Parameters
    ----------
    pulls
        (n, G) each view's pull at the shared parameters at the optimum, its own parameters eliminated.
    informations
        (n, G, G) its information on them.
    working
        (n, G, G) what the covariance of its pull is taken for; its size counts only where the pull shows nothing.
    prior, prior_pull
        (G, G) information known beforehand, and the covariance of its pull.
    """
    # Scaled to a unit diagonal: the parameters differ by many orders of magnitude.
    scale = 1.0 / np.sqrt(np.diag(informations.sum(axis=0) + prior))
    both = np.outer(scale, scale)
    own, noise, known = informations * both, working * both, prior_score_covariance * both
    inverse = np.linalg.inv(own.sum(axis=0) + prior * both)
    leverage = own @ inverse
    total = noise.sum(axis=0) + known
    crossed = leverage @ noise
    left = noise - crossed - crossed.transpose(0, 2, 1) + leverage @ total @ leverage.transpose(0, 2, 1)
    larger = np.array([_enlarged(m, c) for m, c in zip(noise, left, strict=True)])
    answers = inverse @ larger
    lost = (noise - larger @ left @ larger.transpose(0, 2, 1)).sum(axis=0) + known
    shown = np.einsum("njg,ng->nj", answers, scores * scale)
    variances = (shown**2).sum(axis=0) + np.maximum(np.diag(inverse @ lost @ inverse), 0.0)
    return ClusterRobustCovariance(variances * scale**2, _freedom(answers, leverage, noise, total))


def _enlarged(noise: Array, left: Array) -> Array:
    """Return B with B C B^T = M on what the pull can show: M^1/2 (M^1/2 C M^1/2)^-1/2 M^1/2."""
    root = _root(noise, 0.5)
    return np.asarray(root @ _root(root @ left @ root, -0.5) @ root)


def _root(matrix: Array, power: float) -> Array:
    """Return a power of a symmetric, not negative matrix on the directions it tells."""
    eigenvalues, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    determined = eigenvalues > _DETERMINED * eigenvalues[-1]
    return np.asarray((vectors[:, determined] * eigenvalues[determined] ** power) @ vectors[:, determined].T)


def _freedom(answers: Array, leverage: Array, noise: Array, total: Array) -> Array:
    """Return 2 E^2 / Var of the sum of squares of each parameter's answers, were the working covariance right."""
    by_all, by_own = answers @ leverage, answers @ noise
    crossed = np.einsum("njg,mjg->jnm", by_all, by_own)
    covariances = np.einsum("njg,gh,mjh->jnm", by_all, total, by_all) - crossed - crossed.transpose(0, 2, 1)
    each = np.arange(len(answers))
    covariances[:, each, each] += np.einsum("njg,njg->jn", by_own, answers)
    expected, squares = np.trace(covariances, axis1=1, axis2=2), (covariances**2).sum(axis=(1, 2))
    return np.asarray(np.divide(expected**2, squares, out=np.zeros_like(squares), where=squares > 0))
