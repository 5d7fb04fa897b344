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
    squares = np.exp(2.0 * eta)
    stars = equations.squares / squares[problem.hyper.at(amp.STAR)]
    b = (marginal.state.shared + found.step)[by_turn.columns]
    moved = ((by_turn.slopes(bench.pupils) * b) @ np.eye(bench.layout.size)[by_turn.rows]).swapaxes(1, 2)
    seen = stars @ moved
    alone, with_own = moved.swapaxes(1, 2) @ seen, seen[:, bench.layout.pose_places]
    across = equations.maps.swapaxes(1, 2) @ seen
    if marginal.uses_readings:  # what the readings say of the places, in the axes of each view's rotation
        rows = marginal.axes @ equations.coupling @ moved[bench.poses]
        weighted = marginal.reading_weights(squares)[:, :, None] * rows
        np.add.at(alone, bench.poses, rows.swapaxes(1, 2) @ weighted)
        np.add.at(with_own, bench.poses, marginal.own_rows.swapaxes(1, 2) @ weighted)
        np.add.at(across, bench.poses, marginal.rows.swapaxes(1, 2) @ weighted)
    alone = alone - with_own.swapaxes(1, 2) @ found.own @ with_own
    shared = np.concatenate(list(across - found.follow.swapaxes(1, 2) @ with_own), axis=1)
    follow = found.covariance @ shared
    information = problem.pupils.information + _on_diagonal(alone) - shared.T @ follow
    return np.asarray(follow @ np.linalg.solve(information, follow.T))


def _on_diagonal(blocks: Array) -> Array:
    """Return the (2 n, 2 n) matrix with (n, 2, 2) blocks on its diagonal."""
    n = len(blocks)
    whole = np.zeros((n, 2, n, 2))
    whole[range(n), :, range(n)] = blocks
    return whole.reshape(2 * n, 2 * n)
