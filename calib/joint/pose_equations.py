"""What each pose says of its basis and of the gimbal, its own field eliminated: the normal equations, pose by pose."""

from __future__ import annotations

import numpy as np

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.equations import Bench
from calib.joint.marginal import Marginal


def normal_of_poses(marginal: Marginal, squares: Array) -> Array:
    """Return (n, Z, Z + 1) what each pose says of its basis and of the gimbal, its own field eliminated.

    It is the information, and the right-hand side in the last column, for (A,) squares of amplitudes.
    """
    problem, equations = marginal.problem, marginal.equations
    star = squares[problem.hyper.at(amp.STAR)]
    bench, own = problem.bench, problem.bench.layout.own.places
    size, gimbal = bench.layout.pose.size, len(bench.gimbal_places)
    whole = np.zeros((bench.n_poses, size + gimbal, size + gimbal + 1))
    whole[:, :size, :size], whole[:, :size, -1] = equations.squares / star, equations.right / star
    if marginal.uses_readings:
        columns = [equations.coupling, equations.gimbal, equations.off[:, :, None]]
        rows = marginal.axes @ np.concatenate(columns, axis=2)
        weighted = marginal.reading_weights(squares)[:, :, None] * rows
        whole += bench.by_pose(np.swapaxes(rows[:, :, :-1], 1, 2) @ weighted)
    expected, between = problem.own_information(squares), whole[:, own]
    between[:, :, -1] -= expected * marginal.state.fields
    followed = np.linalg.solve(between[:, :, own] + np.diag(expected), between)
    return np.asarray(whole - np.swapaxes(between[:, :, :-1], 1, 2) @ followed)


def maps_with_gimbal(bench: Bench, maps: Array) -> Array:
    """Return (n, Z, S) what the shared unknowns do to the bases of the poses, from (n, B, S), and to the gimbal."""
    units = np.eye(maps.shape[2])[bench.gimbal_places]
    return np.concatenate([maps, np.tile(units, (len(maps), 1, 1))], axis=1)
