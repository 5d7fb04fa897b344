"""Columns that join the linear model of an optimum: what the likelihood gains by them, and the model that has them.

A hypothesis about views, such as a shift of a view or a step of the focal length, displaces the bases of some views.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array
from calib.joint.marginal import Marginal
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
    def of(cls, optimum: Optimum, columns: Array) -> AddedColumns:
        """Return what K hypotheses gain at an optimum: each displaces the views, (m, B, K) sizes of their bases.

        Columns that join a linear model whose posterior is known (Searle, 1971): their own information, less what the
        own fields and the shared unknowns take up.
        """
        marginal, solution = optimum.marginal, optimum.solution
        equations, bench = marginal.equations, marginal.problem.bench
        own, poses, across = bench.layout.own.places, bench.poses, np.swapaxes(columns, 1, 2)
        rows = across @ equations.of_views / solution.star_variance
        basis = equations.maps @ solution.step
        basis[:, own] += solution.fields
        gradient = (across @ equations.right_of_views[:, :, None])[:, :, 0] / solution.star_variance
        gradient -= (rows @ basis[poses][:, :, None])[:, :, 0]
        direct, by_own, by_shared = rows @ columns, rows[:, :, own], rows @ equations.maps[poses]
        if marginal.uses_readings:
            turned = marginal.axes @ equations.coupling @ columns
            weighted = np.swapaxes(marginal.reading_weights(solution.squares)[:, :, None] * turned, 1, 2)
            gradient += (weighted @ marginal.readings_left(solution)[:, :, None])[:, :, 0]
            direct = direct + weighted @ turned
            by_own, by_shared = by_own + weighted @ marginal.own_rows, by_shared + weighted @ marginal.rows
        taken = bench.by_pose(by_own) @ np.swapaxes(solution.own_root, 1, 2)
        shared = ((bench.by_pose(by_shared) - taken @ solution.between).sum(axis=0)) @ solution.root.T
        information = direct.sum(axis=0) - (taken @ np.swapaxes(taken, 1, 2)).sum(axis=0) - shared @ shared.T
        return cls(gradient.sum(axis=0), information)

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
