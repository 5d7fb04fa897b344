"""Views that are displaced along directions of their bases: what the likelihood gains by it, and the model that has it.

A shift of a view's stars, or another focal length, is such a displacement.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array
from calib.joint.marginal import Marginal
from calib.joint.prior import block_diagonal
from calib.joint.solve import Optimum

#: A hypothesis is adjusted if it promises so much of 2 log of the likelihood by the linear model. Without a change of
#: the focal length, 5 % of places do; steps of .02 to .2 % on drawn benches that were told promised 5 or more.
PROMISED = 4.0


@dataclass(frozen=True)
class AddedColumns:
    """What the likelihood gains by sizes s of K columns, all unknowns adjusted: 2 g s - s I s."""

    gradient: Array  # (K,) g
    information: Array  # (K, K) I

    @classmethod
    def of_views(cls, optimum: Optimum, directions: Array) -> AddedColumns:
        """Return what displacing each of m views along (B, D) directions of its basis gains at an optimum: K = m D.

        Columns that join a linear model whose posterior is known (Searle, 1971): their own information, less what the
        own fields and the shared unknowns take up.
        """
        marginal, solution = optimum.marginal, optimum.solution
        equations, bench = marginal.equations, marginal.problem.bench
        own, poses = bench.layout.own.places, bench.poses
        rows = directions.T @ equations.of_views / solution.star_variance
        basis = equations.maps @ solution.step
        basis[:, own] += solution.fields
        gradient = equations.right_of_views @ directions / solution.star_variance
        gradient -= (rows @ basis[poses][:, :, None])[:, :, 0]
        direct, by_own, by_shared = rows @ directions, rows[:, :, own], rows @ equations.maps[poses]
        if marginal.uses_readings:
            turned = marginal.axes @ equations.coupling @ directions
            weighted = np.swapaxes(marginal.reading_weights(solution.squares)[:, :, None] * turned, 1, 2)
            gradient += (weighted @ marginal.readings_left(solution)[:, :, None])[:, :, 0]
            direct = direct + weighted @ turned
            by_own, by_shared = by_own + weighted @ marginal.own_rows, by_shared + weighted @ marginal.rows
        taken = by_own @ np.swapaxes(solution.own_root, 1, 2)[poses]
        shared = ((by_shared - taken @ solution.between[poses]) @ solution.root.T).reshape(gradient.size, -1)
        taken, pose = taken.reshape(gradient.size, -1), np.repeat(poses, gradient.shape[1])
        of_pose = (pose[:, None] == pose) * (taken @ taken.T)
        return cls(gradient.reshape(-1), block_diagonal(direct) - of_pose - shared @ shared.T)

    def along(self, shares: Array) -> AddedColumns:
        """Return what L other sizes gain, of which these follow (K, L) shares."""
        return AddedColumns(shares.T @ self.gradient, shares.T @ self.information @ shares)

    def gains(self, sizes: Array) -> Array:
        """Return (N,) by how much -2 log of the likelihood falls with (N, K) sizes."""
        return np.asarray(2.0 * sizes @ self.gradient - ((sizes @ self.information) * sizes).sum(axis=1))


def displaced(optimum: Optimum, basis: Array, eta: Array) -> Optimum:
    """Return an optimum whose views are displaced: (m, B) sizes of each view's basis, all linear.

    Its best amplitudes are searched from (A,) logarithms ``eta``.
    """
    problem, equations = optimum.marginal.problem, optimum.marginal.equations
    moved = (equations.of_views @ basis[:, :, None])[:, :, 0]
    turned = (equations.coupling @ basis[:, :, None])[:, :, 0]
    right = equations.right_of_views - moved
    there = replace(
        equations,
        right_of_views=right,
        right=problem.bench.by_pose(right),
        cost=equations.cost + float((basis * (moved - 2.0 * equations.right_of_views)).sum()),
        off=equations.off - turned[: len(equations.off)],
    )
    solution = Marginal(problem, there, optimum.state).solve(eta)
    return replace(optimum, solution=solution).at_best
