"""Variances of maximum likelihood of normally distributed scores.

Two forms of the same equations: scores of many poses, of which each has its own coefficients, and scores of a few
common coefficients. This module is linear algebra only: it does not know where the scores come from.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ROUNDS = 100
#: The iteration ends when no standard deviation changes by more than this share.
_CONVERGED = 5e-3
#: The iteration ends, too, when no component changes by more than this share of what it explains: others have vanished.
_SETTLED = 1e-9
#: A variance that falls by more than this factor does not keep the iteration going.
_VANISHING = 1e-3


class PoseForms:
    """Quadratic forms of the scores of many poses' coefficients, for `maximum_likelihood`.

    The normal matrix of the coefficients is N = B - R S^-1 R^T: one block for each pose, and what all poses share. With
    variances D = W^2 of the coefficients and the noise v, the scores s have the covariance v N + N D N. Own derivation:
    with M = v I + W N W, the observed forms are the squares of M^-1 W s and the expected ones the diagonal of
    M^-1 W N W, both over D. M is inverted pose by pose (Woodbury's identity; Hager, 1989).

    score: (P F,) float64 scores.
    blocks: (P, F, F) float64 blocks B.
    rows: (P F, R) float64 R.
    core: (R, R) float64 S.
    group: (P F,) int64 variance component of each coefficient; -1 for a coefficient that a pose does not
      have.
    noise: Variance v.
    """

    def __init__(
        self, score: Array, blocks: Array, rows: Array, core: Array, group: NDArray[np.int64], noise: float
    ) -> None:
        self._score, self._blocks, self._rows, self._core, self._noise = score, blocks, rows, core, noise
        self._group, self._own_noise = group, noise * np.eye(blocks.shape[1])
        self._of_group = (group[:, None] == np.arange(group.max() + 1)).astype(np.float64)
        self._inverse = blocks, rows, rows

    def __call__(self, variances: Array) -> tuple[Array, Array]:
        """Return the quadratic forms of each component, each multiplied by the variance of the component.

        variances: (K,) float64.
        Returns: (K,) observed and (K,) expected forms.
        """
        poses, width, _ = self._blocks.shape
        w = np.sqrt(variances)[self._group]
        by_pose = w.reshape(poses, width)
        own = self._blocks * (by_pose[:, :, None] * by_pose[:, None])
        inverse = np.linalg.inv(own + self._own_noise)
        rows, score = w[:, None] * self._rows, w * self._score
        solved = (inverse @ rows.reshape(poses, width, -1)).reshape(rows.shape)
        weighted = solved @ np.linalg.inv(self._core - rows.T @ solved)
        answer = (inverse @ score.reshape(poses, width, 1)).reshape(-1) + weighted @ (score @ solved)
        diagonal = np.einsum("pij,pij->pi", inverse, own).reshape(-1)
        diagonal -= self._noise * np.einsum("cr,cr->c", weighted, solved)
        self._inverse = inverse, weighted, solved
        return (answer * answer) @ self._of_group, diagonal @ self._of_group

    def information(self) -> Array:
        """Return the information on the logarithms of the variances of the last call (Patterson and Thompson, 1971).

        Returns: (K, K) float64.
        """
        inverse, weighted, solved = self._inverse
        poses, width, _ = inverse.shape
        whole = weighted @ solved.T
        for i in range(poses):
            own = slice(i * width, (i + 1) * width)
            whole[own, own] += inverse[i]
        explained = np.eye(len(whole)) - self._noise * whole
        return 0.5 * self._of_group.T @ (explained * explained) @ self._of_group


class DenseForms:
    """Quadratic forms of z ~ N(0, sum_k v_k parts_k + noise), for `maximum_likelihood`.

    z: (C,) float64 whitened scores.
    parts: For each of K components the (C, C) float64 covariance of z for a unit variance.
    noise: (C, C) float64 part of the covariance of z that the components do not explain.
    """

    def __init__(self, z: Array, parts: Sequence[Array], noise: Array) -> None:
        self._z, self._noise = z, noise
        self._flat = np.array(parts).reshape(len(parts), -1)
        self._inverse, self._variances = noise, np.zeros(len(parts))

    def __call__(self, variances: Array) -> tuple[Array, Array]:
        """See `PoseForms.__call__`."""
        self._variances = variances
        fields = (variances @ self._flat).reshape(self._noise.shape)
        self._inverse = np.asarray(np.linalg.inv(fields + self._noise), np.float64)
        answer = self._inverse @ self._z
        observed = self._flat @ np.outer(answer, answer).reshape(-1)
        return variances * observed, variances * (self._flat @ self._inverse.reshape(-1))

    def information(self) -> Array:
        """See `PoseForms.information`."""
        parts = self._flat.reshape(-1, *self._noise.shape)
        by_log = self._variances[:, None, None] * (self._inverse @ parts)
        swapped = np.swapaxes(by_log, 1, 2).reshape(len(parts), -1)
        return 0.5 * by_log.reshape(len(parts), -1) @ swapped.T


def maximum_likelihood(forms: PoseForms | DenseForms, start: Array) -> tuple[Array, Array]:
    """Return the variances of maximum likelihood, and their information.

    Each iteration multiplies a variance by the square root of the observed over the expected quadratic form; the
    likelihood grows in every iteration (Zhou, Hu, Zhou and Lange, 2019).

    start: (K,) float64 variances to begin with; a component that starts at zero stays there.
    Returns: (K,) float64 variances, and the (K, K) information on their logarithms.
    """
    variances: Array = start
    factors: Array = np.ones_like(start)
    for _ in range(_ROUNDS):
        observed, expected = forms(variances)
        known = (expected > 0.0) & (observed > 0.0)
        factors = np.asarray(
            np.sqrt(np.divide(observed, expected, out=np.ones_like(start), where=known)), np.float64
        )
        variances = variances * factors
        change = np.abs(np.sqrt(factors) - 1.0)
        if (change * (factors > _VANISHING)).max() < _CONVERGED or (change * expected).max() < _SETTLED:
            break
    return variances, forms.information() * np.outer(factors, factors)
