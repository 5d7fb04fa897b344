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

_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class ViewScores:
    """Information and scores of n views for the G shared parameters, with their L local parameters eliminated."""

    information: Array  # (n, G, G) float64 information
    score: Array  # (n, G) float64 contribution to the negative gradient of the cost
    # answer, own: (n, L, G) and (n, L) float64. If the shared parameters step by s, a view steps by own - answer s.
    answer: Array
    own: Array


@dataclass(frozen=True)
class ViewEquations:
    """The normal equations of n views: G shared parameters, then the L local ones of each view."""

    normal: Array  # (n, G + L, G + L) float64
    right: Array  # (n, G + L) float64 negative gradients of the cost
    count: int  # G

    @property
    def local(self) -> Array:
        """(n, L, L) float64 block of the local parameters."""
        return self.normal[:, self.count :, self.count :]

    @property
    def coupling(self) -> Array:
        """(n, L, G) float64 block between the local and the shared parameters."""
        return self.normal[:, self.count :, : self.count]

    def eliminated(self, damping: float = 0.0) -> ViewScores:
        """Eliminate the local parameters of each view by the Schur complement (Triggs et al., 2000, section 6.1).

        damping: Share by which the diagonal of the local block grows (Marquardt, 1963).
        Raises numpy.linalg.LinAlgError: If a view does not determine its local parameters.
        """
        count = self.count
        local = self.local * (1.0 + damping * np.eye(len(self.right[0]) - count))
        known = np.concatenate([self.coupling, self.right[:, count:, None]], axis=2)
        solved = np.linalg.solve(local, known)
        eliminated = np.swapaxes(self.coupling, 1, 2) @ solved
        return ViewScores(
            self.normal[:, :count, :count] - eliminated[:, :, :count],
            self.right[:, :count] - eliminated[:, :, count],
            solved[:, :, :count],
            solved[:, :, count],
        )

    def step(self, damping: float) -> tuple[Array, Array]:
        """Return the damped step (Marquardt, 1963) of the shared (G,) and of the local (n, L) parameters.

        The reduced equations are scaled to a unit diagonal (van der Sluis, 1969).

        Raises numpy.linalg.LinAlgError: If the equations are singular.
        """
        views = self.eliminated(damping)
        diagonal = np.diagonal(self.normal, axis1=1, axis2=2)[:, : self.count].sum(axis=0)
        information = views.information.sum(axis=0) + damping * np.diag(diagonal)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), _TINY))
        scaled = information * np.outer(scale, scale)
        shared = scale * np.linalg.solve(scaled, scale * views.score.sum(axis=0))
        return shared, views.own - views.answer @ shared
