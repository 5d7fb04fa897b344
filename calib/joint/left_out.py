"""Poses left out, and the covariance of the rotations: closed forms at the mode."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.effects.by_turn import Along
from calib.joint.equations import Bench, Equations, State
from calib.joint.marginal import Problem, Solution
from calib.joint.posterior import Posterior
from calib.joint.solve import CURVED, Optimum, relative_step
from calib.model.result_parts import RotationErrors

#: Fewest poses of which one can be left out.
MIN_POSES = 3


def left_out_rms(optimum: Optimum) -> float | None:
    """Return the root mean square residual of poses left out, of which only the rotation is adjusted, px.

    The other poses predict the shared unknowns (one step from the mode). The left-out pose has no own field. A pupil
    that is moved by hand is where the disc shows it; no disc shows where it is along the axis, which is adjusted too.
    None with fewer than three poses.
    """
    marginal, solution = optimum.marginal, optimum.solution
    bench, weights = marginal.problem.bench, marginal.equations.weights
    n = bench.n_poses
    if n < MIN_POSES:
        return None
    normal = normal_of_poses(marginal.problem, marginal.equations, optimum.state, solution.squares)
    maps = maps_with_gimbal(bench, marginal.equations.maps)
    information = np.linalg.inv(solution.covariance)
    total, count = 0.0, 0.0
    for pose in range(n):
        own = maps[pose].T @ normal[pose]
        others = information - own[:, :-1] @ maps[pose]
        left = np.linalg.solve(others, information @ solution.step - own[:, -1])
        there, state = _predicted(optimum, pose, np.asarray(left, np.float64))
        residuals = there.residuals(state)
        seen = (bench.poses[bench.stars.views] == pose) & np.isfinite(residuals).all(axis=1)
        total += float(weights[seen] @ (residuals[seen] ** 2).sum(axis=1))
        count += float(weights[seen].sum())
    return float(np.sqrt(total / count))


def _predicted(optimum: Optimum, pose: int, step: Array) -> tuple[Bench, State]:
    """Return bench and state after a step (S,) of the shared unknowns, with what a left-out pose has for itself."""
    problem, equations, state = optimum.marginal.problem, optimum.marginal.equations, optimum.state
    layout, there = problem.bench.layout, _as_shown(problem, pose)
    step_of_basis = there.maps[pose] @ (state.shared + step) - equations.maps[pose] @ state.shared
    step_of_basis[layout.own.places] -= state.fields[pose]
    fields = state.fields.copy()
    fields[pose] = 0.0
    if along_of := layout.names_of(Along):
        at, squares = layout.pose.radius, equations.squares[pose]
        column = layout.index[along_of[pose]]
        along = (equations.right[pose, at] - squares[at] @ step_of_basis) / squares[at, at]
        step_of_basis[at] += along
        step = step.copy()
        step[column] += along / there.maps[pose, at, column]
    turned = equations.turned - np.einsum("mab,b->ma", equations.coupling, step_of_basis)
    moved = there.moved(state, step, fields - state.fields, turned)
    if relative_step(optimum.marginal, step) > CURVED:
        moved = there.aligned(moved, equations.weights)
    return there, State(moved.shared, fields, moved.rotations)


def _as_shown(problem: Problem, pose: int) -> Bench:
    """Return the bench whose pupil of one pose is where its disc shows it, if the camera is moved by hand."""
    bench, pupils = problem.bench, problem.pupils
    if pupils is None:
        return bench
    places = bench.pupils.copy()
    places[pose] = pupils.shown[pose]
    return replace(bench, pupils=places)


def normal_of_poses(problem: Problem, equations: Equations, state: State, squares: Array) -> Array:
    """Return (n, Z, Z + 1) what each pose says of its basis and of the gimbal, its own field eliminated.

    It is the information, and the right-hand side in the last column.
    """
    bench, star = problem.bench, squares[problem.hyper.at(amp.STAR)]
    size, gimbal = bench.layout.pose.size, len(bench.gimbal_places)
    whole = np.zeros((bench.n_poses, size + gimbal, size + gimbal + 1))
    whole[:, :size, :size], whole[:, :size, -1] = equations.squares / star, equations.right / star
    if len(equations.off) and bench.readings is not None:
        noise = squares[problem.hyper.at(amp.READING)] * bench.readings.sigma_rad**2
        repeats = np.bincount(bench.poses)[bench.poses, None, None]
        weights = np.linalg.inv(star * np.linalg.inv(equations.turns) + noise * repeats * np.eye(3))
        rows = np.concatenate([equations.coupling, equations.gimbal, equations.off[:, :, None]], axis=2)
        whole += bench.by_pose(np.swapaxes(rows[:, :, :-1], 1, 2) @ weights @ rows)
    expected, between = problem.own_information(squares), whole[:, bench.layout.own.places]
    own = between[:, :, bench.layout.own.places] + np.diag(expected)
    between[:, :, -1] -= expected * state.fields
    return np.asarray(whole - np.swapaxes(between[:, :, :-1], 1, 2) @ np.linalg.solve(own, between))


def maps_with_gimbal(bench: Bench, maps: Array) -> Array:
    """Return (n, Z, S) what the shared unknowns do to the bases of the poses, from (n, B, S), and to the gimbal."""
    units = np.eye(maps.shape[2])[bench.gimbal_places]
    return np.concatenate([maps, np.tile(units, (len(maps), 1, 1))], axis=1)


def rotation_errors(posterior: Posterior) -> RotationErrors:
    """Return how the rotations of all m views follow the shared unknowns, and what each adds."""
    marginal, optimum = posterior.optimum.marginal, posterior.reported
    stated, random = marginal.problem.stated(), marginal.problem.random
    prior, pull = stated.information.copy(), stated.off(posterior.mean)[0].copy()
    prior[np.ix_(random.places, random.places)] += optimum.solution.inside
    pull[random.places] -= optimum.solution.inside @ posterior.mean[random.places]
    by_shared, own = _follow(optimum.solution)
    names = marginal.problem.bench.layout.names
    return RotationErrors(names, posterior.mean, posterior.covariance, prior, pull, by_shared, own)


def _follow(solution: Solution) -> tuple[Array, Array]:
    """Return (3 m, S) how the rotations follow the shared unknowns, and (3 m, 3 m) the covariance that views add."""
    marginal, squares = solution.marginal, solution.squares
    bench, equations = marginal.problem.bench, marginal.equations
    back = np.swapaxes(marginal.axes, 1, 2)
    loose = solution.star_variance * (back * marginal.loose[:, None]) @ marginal.axes
    places = bench.layout.own.places
    by_shared = -equations.coupling @ equations.maps[bench.poses]
    by_field = -equations.coupling[:, :, places]
    if marginal.uses_readings:
        weights = marginal.reading_weights(squares)
        kept = (back * (marginal.reading_variance(squares) * weights)[:, None]) @ marginal.axes
        share = np.eye(3) - kept
        by_shared, by_field = kept @ by_shared, kept @ by_field
        by_shared[:, :, bench.gimbal_places] += share @ equations.gimbal
        loose = kept @ loose
    direct = by_shared - by_field @ solution.follow[bench.poses]
    m = len(bench.poses)
    whole = np.zeros((m, 3, m, 3))
    for pose in range(bench.n_poses):
        views = np.flatnonzero(bench.poses == pose)
        stacked = by_field[views].reshape(3 * len(views), -1)
        local = (stacked @ solution.own[pose] @ stacked.T).reshape(len(views), 3, len(views), 3)
        whole[views[:, None], :, views] += local.transpose(0, 2, 1, 3)
    whole[range(m), :, range(m)] += loose
    return direct.reshape(3 * m, -1), whole.reshape(3 * m, 3 * m)
