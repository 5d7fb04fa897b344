"""What the places of a pupil that is moved by hand add to the uncertainty, because discs show them only so well."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.joint import amplitudes as amp
from calib.joint.marginal import Marginal, Solution

Array = NDArray[np.float64]


def spread_of_pupils(marginal: Marginal, eta: Array, found: Solution) -> Array | None:
    """Return the (S, S) covariance that the shared unknowns have because the places are known only so well.

    The places are eliminated from equations that are linear in them too, about the fields found. None on a gimbal.
    """
    problem, equations = marginal.problem, marginal.equations
    if problem.pupils is None:
        return None
    bench, by_turn = problem.bench, problem.bench.layout.by_turn
    squares = np.exp(-2.0 * eta[problem.hyper.at(amp.STAR)]) * equations.squares
    between = squares[:, bench.layout.pose_places]
    squares = squares - between.swapaxes(1, 2) @ found.own @ between
    b = (marginal.state.shared + found.step)[by_turn.columns]
    moved = (by_turn.slopes(bench.pupils) * b) @ np.eye(bench.layout.size)[by_turn.rows]
    seen = squares @ moved.swapaxes(1, 2)
    across = np.concatenate(list(equations.maps.swapaxes(1, 2) @ seen), axis=1)
    follow = found.covariance @ across
    information = problem.pupils.information + _on_diagonal(moved @ seen) - across.T @ follow
    return np.asarray(follow @ np.linalg.solve(information, follow.T))


def _on_diagonal(blocks: Array) -> Array:
    """Return the (2 n, 2 n) matrix with (n, 2, 2) blocks on its diagonal."""
    n = len(blocks)
    whole = np.zeros((n, 2, n, 2))
    whole[range(n), :, range(n)] = blocks
    return whole.reshape(2 * n, 2 * n)
