"""The places of a pupil that is moved by hand: the most probable ones, and what they add to the uncertainty.

Fields by turn are multiplied by these places. At the fields found, the equations are linear in the places, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.marginal import Marginal, Solution
from calib.joint.prior import block_diagonal

#: Share of what the stars say of the places that counts in the uncertainty. Glass that does not follow the pupil alone
#: moves the places: with all of it, 25 poses before such a glass were up to 2.8 U wrong. With none of it, U of nine
#: poses with poor discs was three times larger than with this.
_COUNTED = 0.1


@dataclass(frozen=True)
class Places:
    """The linear equations of the places of n poses, with all other unknowns eliminated."""

    step: Array  # (n, 2) to the most probable places, sines
    spread: Array  # (S, S) covariance of the shared unknowns that comes from the uncertainty of the discs


def places_of(marginal: Marginal, eta: Array, found: Solution) -> Places | None:
    """Return the places at a solution for given amplitudes; None on a gimbal."""
    problem, equations = marginal.problem, marginal.equations
    if problem.pupils is None:
        return None
    bench, by_turn = problem.bench, problem.bench.layout.by_turn
    squares, own_places = np.exp(2.0 * eta), problem.bench.layout.pose_places
    star = squares[problem.hyper.at(amp.STAR)]
    b = (marginal.state.shared + found.step)[by_turn.columns]
    moved = ((by_turn.slopes(bench.pupils) * b) @ np.eye(bench.layout.size)[by_turn.rows]).swapaxes(1, 2)
    back = moved.swapaxes(1, 2)
    seen = equations.squares @ moved / star
    alone, with_own = back @ seen, seen[:, own_places]
    across = equations.maps.swapaxes(1, 2) @ seen
    pull = (back @ (equations.right / star)[:, :, None])[:, :, 0]
    if marginal.uses_readings:  # what the readings say of the places, in the axes of each view's rotation
        rows = marginal.axes @ equations.coupling @ moved[bench.poses]
        weighted = marginal.reading_weights(squares)[:, :, None] * rows
        np.add.at(alone, bench.poses, rows.swapaxes(1, 2) @ weighted)
        np.add.at(with_own, bench.poses, marginal.own_rows.swapaxes(1, 2) @ weighted)
        np.add.at(across, bench.poses, marginal.rows.swapaxes(1, 2) @ weighted)
        np.add.at(pull, bench.poses, (weighted.swapaxes(1, 2) @ marginal.off[:, :, None])[:, :, 0])
    pull -= across.swapaxes(1, 2) @ found.step + (with_own.swapaxes(1, 2) @ found.fields[:, :, None])[:, :, 0]
    alone = alone - with_own.swapaxes(1, 2) @ found.own @ with_own
    shared = np.concatenate(list(across - found.follow.swapaxes(1, 2) @ with_own), axis=1)
    follow = found.covariance @ shared
    information = problem.pupils.information + block_diagonal(alone) - shared.T @ follow
    discs = problem.pupils.information
    spread = follow @ np.linalg.solve(discs + _COUNTED * (information - discs), follow.T)
    away = problem.pupils.information @ (bench.pupils - problem.pupils.shown).reshape(-1)
    gradient, curvature = _of_determinant(marginal, found, equations.squares / star)
    step = np.linalg.solve(information + block_diagonal(curvature), (pull - gradient).reshape(-1) - away)
    return Places(step.reshape(-1, 2), np.asarray(spread))


def _of_determinant(marginal: Marginal, found: Solution, stars: Array) -> tuple[Array, Array]:
    """Return (n, 2), (n, 2, 2) half of gradient and curvature of log det of the shared information by the places.

    Without them the places would follow fields that are hardly known. Readings have no part in them. Where a pose alone
    determines the fields, its place changes hardly any determinant: only what others know of it bends. stars: (n, B, B)
    information of the bases.
    """
    bench, layout = marginal.problem.bench, marginal.problem.bench.layout
    by_turn, own = layout.by_turn, layout.pose_places
    slopes = by_turn.slopes(bench.pupils)
    left = stars - stars[:, :, own] @ found.own @ stars[:, own]
    maps = marginal.equations.maps
    spread = maps @ found.covariance
    together = left @ spread[:, :, by_turn.columns]
    gradient = (slopes @ together[:, by_turn.rows, range(len(by_turn.rows)), None])[:, :, 0]
    known = found.covariance[by_turn.columns[:, None], by_turn.columns]
    others = left - left @ (spread @ maps.swapaxes(1, 2)) @ left
    curved = others[:, by_turn.rows[:, None], by_turn.rows] * known
    return gradient, slopes @ curved @ slopes.swapaxes(1, 2)
