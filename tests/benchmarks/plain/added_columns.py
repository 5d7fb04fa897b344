"""Columns that join the linear model of an optimum: what the likelihood gains by them, and the model that has them.

A hypothesis about views, such as a shift of a view or a step of the focal length, displaces the bases of some views.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array

from .equations import Equations
from .solution import Solution


@dataclass(frozen=True)
class AddedColumns:
    """What the likelihood gains by sizes s of K columns, all unknowns adjusted: 2 g s - s I s."""

    gradient: Array  # (K,) g
    information: Array  # (K, K) I

    @classmethod
    def of(cls, solution: Solution, columns: Array) -> AddedColumns:
        """Return the gains by (m, B, K) displacements of the views' bases (Searle, 1971).

        Their own information, less what the unknowns of the poses and the shared ones take up.
        """
        q, p, star = solution.equations, solution.problem, solution.prior.star
        size, count = p.size, columns.shape[2]
        gradient, direct = np.zeros(count), np.zeros((count, count))
        local, shared = np.zeros((p.n, q.local_size, count)), np.zeros((len(solution.step), count))
        for v, (pose, slot) in enumerate(zip(p.poses, q.slots, strict=True)):
            whole, own, column = star * q.of_views[v], p.own.basis[pose], columns[v]
            seen = whole[:, :size] @ column
            basis = q.maps[pose] @ solution.step + own @ solution.local[pose, : q.own_size]
            moved = np.concatenate([basis, solution.local[pose, slot]])
            gradient += column.T @ (star * q.right_of_views[v] - whole @ moved)[:size]
            direct += column.T @ seen[:size]
            local[pose, : q.own_size] += own.T @ seen[:size]
            local[pose, slot] += seen[size:]
            shared += q.maps[pose].T @ seen[:size]
        taken = solution.own @ local
        shared -= np.einsum("nls,nlk->sk", solution.follow, local, optimize=True)
        information = direct - np.einsum("nlk,nlj->kj", local, taken, optimize=True)
        return cls(gradient, information - shared.T @ solution.covariance @ shared)

    def gains(self, sizes: Array) -> Array:
        """Return (N,) by how much -2 log of the likelihood falls with (N, K) sizes."""
        return np.asarray(2.0 * sizes @ self.gradient - ((sizes @ self.information) * sizes).sum(axis=1))


def displaced(equations: Equations, basis: Array) -> Equations:
    """Return the equations with (m, B) displacements of the views' bases, all linear."""
    moved = (equations.of_views[:, :, : basis.shape[1]] @ basis[:, :, None])[:, :, 0]
    size = basis.shape[1]
    cost = float((basis * (moved[:, :size] - 2.0 * equations.right_of_views[:, :size])).sum())
    return replace(equations, right_of_views=equations.right_of_views - moved, cost=equations.cost + cost)
