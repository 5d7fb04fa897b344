"""Normal equations of many views, reduced to what the views share.

Knows linear algebra only. The views share few parameters and have each a rotation of their own (and a centre, where it
is free), so the whole system is solved by the Schur complement onto the shared ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NormalEquations:
    """J^T W J and J^T W e, split into shared and per-view blocks.

    Attributes
    ----------
    shared, shared_gradient
        (G, G) and (G,).
    local, local_gradient
        (n, L, L) and (n, L).
    coupling
        (n, G, L).
    """

    shared: Array
    shared_gradient: Array
    local: Array
    local_gradient: Array
    coupling: Array

    def damped(self, damping: float) -> NormalEquations:
        """Return the equations with Marquardt's damping: diagonals times 1 + damping."""
        diagonal = np.arange(self.local.shape[1])
        local, shared = self.local.copy(), self.shared.copy()
        local[:, diagonal, diagonal] *= 1.0 + damping
        shared[np.diag_indices_from(shared)] *= 1.0 + damping
        return replace(self, shared=shared, local=local)

    def reduced(self) -> Array:
        """Return the Schur complement onto the shared parameters, (G, G): their information."""
        solved = np.linalg.solve(self.local, np.swapaxes(self.coupling, 1, 2))
        return np.asarray(self.shared - (self.coupling @ solved).sum(axis=0))

    def step(self) -> tuple[Array, Array]:
        """Solve for the step: shared (G,) and per view (n, L).

        Raises
        ------
        numpy.linalg.LinAlgError
            When the equations are singular.
        """
        solved = np.linalg.solve(self.local, self.local_gradient[:, :, None])
        right = self.shared_gradient - (self.coupling @ solved).sum(axis=0)[:, 0]
        # Scaled to a unit diagonal: the parameters differ by many orders of magnitude.
        information = self.reduced()
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
        shared = scale * np.linalg.solve(information * np.outer(scale, scale), scale * right)
        back = self.local_gradient - np.einsum("ngl,g->nl", self.coupling, shared)
        return shared, np.linalg.solve(self.local, back[:, :, None])[:, :, 0]

    def decrement(self, shared: Array, local: Array) -> float:
        """Return gradient times step: twice the reduction of the cost that a full step promises."""
        return float(self.shared_gradient @ shared + (self.local_gradient * local).sum())
