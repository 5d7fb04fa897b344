"""Normal equations of many views, reduced to the parameters that the views share.

The views share few parameters, and each has its own rotation (and a centre, if it is free). The system is therefore
solved by the Schur complement onto the shared parameters: the reduced camera system of bundle adjustment (Brown, 1976;
Triggs et al., 2000). This module is linear algebra only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NormalEquations:
    """J^T W J and J^T W e, split into blocks of shared and of local (per-view) parameters."""

    # shared, shared_gradient: (G, G) and (G,) float64 blocks of the G shared parameters.
    shared: Array
    shared_gradient: Array
    # local, local_gradient: (n, L, L) and (n, L) float64 blocks of the L local parameters of each of n views.
    local: Array
    local_gradient: Array
    coupling: Array  # (n, G, L) float64 blocks between shared and local parameters

    def damped(self, damping: float) -> NormalEquations:
        """Return the equations with Marquardt's damping: diagonals times 1 + damping (Marquardt, 1963).

        damping: Damping factor, at least 0.
        """
        diagonal = np.arange(self.local.shape[1])
        local, shared = self.local.copy(), self.shared.copy()
        local[:, diagonal, diagonal] *= 1.0 + damping
        shared[np.diag_indices_from(shared)] *= 1.0 + damping
        return replace(self, shared=shared, local=local)

    def reduced(self) -> Array:
        """Return the Schur complement onto the shared parameters, which is their information.

        Source: Triggs et al. (2000), section 6.1; Brown (1976).

        Returns: (G, G) information matrix.
        """
        solved = np.linalg.solve(self.local, np.swapaxes(self.coupling, 1, 2))
        return np.asarray(self.shared - (self.coupling @ solved).sum(axis=0))

    def step(self) -> tuple[Array, Array]:
        """Solve the equations.

        The shared parameters are solved by the Schur complement, the local ones by back-substitution (Triggs et al.,
        2000, section 6.1; Brown, 1976). The reduced system is scaled to a unit diagonal (van der Sluis, 1969).

        Returns: (G,) step of the shared parameters; (n, L) step of the local ones.
        Raises numpy.linalg.LinAlgError: If the equations are singular.
        """
        right = np.concatenate([np.swapaxes(self.coupling, 1, 2), self.local_gradient[:, :, None]], axis=2)
        solved = np.linalg.solve(self.local, right)
        eliminated = (self.coupling @ solved).sum(axis=0)
        information, right = self.shared - eliminated[:, :-1], self.shared_gradient - eliminated[:, -1]
        # Scaled to a unit diagonal: the parameters differ by many orders of magnitude.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
        shared = scale * np.linalg.solve(information * np.outer(scale, scale), scale * right)
        return shared, solved[:, :, -1] - solved[:, :, :-1] @ shared

    def decrement(self, shared: Array, local: Array) -> float:
        """Return gradient times step, which is twice the predicted reduction of the cost.

        Own derivation: a step d that solves N d = g lowers the quadratic model g.d - d.(N d) / 2 by g.d / 2.

        shared: (G,) step of the shared parameters.
        local: (n, L) step of the local parameters.
        """
        return float(self.shared_gradient @ shared + (self.local_gradient * local).sum())


@dataclass(frozen=True)
class ViewScores:
    """Information and scores of n views for the G shared parameters, with their L local parameters eliminated."""

    information: Array  # (n, G, G) float64 information
    score: Array  # (n, G) float64 contribution to the negative gradient of the cost
    # (n, L, G) float64: the local parameters change by minus this times a change of the shared ones.
    answer: Array

    @classmethod
    def of(cls, normal: Array, gradient: Array, count: int) -> ViewScores:
        """Eliminate the local parameters of each view by the Schur complement (Triggs et al., 2000, section 6.1).

        normal, gradient: (n, G + L, G + L) normal matrices and (n, G + L) negative gradients.
        """
        coupling = normal[:, :count, count:]
        right = np.concatenate([np.swapaxes(coupling, 1, 2), gradient[:, count:, None]], axis=2)
        solved = np.linalg.solve(normal[:, count:, count:], right)
        eliminated = coupling @ solved
        return cls(
            normal[:, :count, :count] - eliminated[:, :, :count],
            gradient[:, :count] - eliminated[:, :, count],
            solved[:, :, :count],
        )
