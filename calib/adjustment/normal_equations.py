"""Normal equations of many views, reduced to the parameters that the views share.

The views share few parameters, and each has its own rotation (and a centre, if it is free). The system is therefore
solved by the Schur complement onto the shared parameters: the reduced camera system of bundle adjustment (Brown, 1976;
Triggs et al., 2000). This module is linear algebra only.
"""

from __future__ import annotations

from dataclasses import dataclass

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

    def reduced(self) -> Array:
        """Return the Schur complement onto the shared parameters, which is their information.

        Source: Triggs et al. (2000), section 6.1; Brown (1976).

        Returns: (G, G) information matrix.
        """
        solved = np.linalg.solve(self.local, np.swapaxes(self.coupling, 1, 2))
        return np.asarray(self.shared - (self.coupling @ solved).sum(axis=0))


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
