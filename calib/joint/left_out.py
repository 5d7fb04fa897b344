"""Poses left out, and the covariance of the rotations: closed forms at the mode."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.arrays import Array
from calib.joint.effects.by_turn import Along
from calib.joint.equations import Bench, State
from calib.joint.marginal import Problem, Solution
from calib.joint.pose_equations import maps_with_gimbal, normal_of_poses
from calib.joint.posterior import Posterior
from calib.joint.prior import block_diagonal
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
    there = _as_shown(marginal.problem)
    normal = normal_of_poses(marginal, solution.squares)
    maps = maps_with_gimbal(bench, marginal.equations.maps)
    information = np.linalg.inv(solution.covariance)
    total, count = 0.0, 0.0
    for pose in range(n):
        own = maps[pose].T @ normal[pose]
        others = information - own[:, :-1] @ maps[pose]
        left = np.linalg.solve(others, information @ solution.step - own[:, -1])
        state = _predicted(optimum, there, pose, np.asarray(left, np.float64))
        residuals = there.residuals(state)
        seen = (bench.poses[bench.stars.views] == pose) & np.isfinite(residuals).all(axis=1)
        total += float(weights[seen] @ (residuals[seen] ** 2).sum(axis=1))
        count += float(weights[seen].sum())
    return float(np.sqrt(total / count))


def _predicted(optimum: Optimum, there: Bench, pose: int, step: Array) -> State:
    """Return the state after a step (S,) of the shared unknowns; the left-out pose has no field of its own."""
    equations, state, layout = optimum.marginal.equations, optimum.state, there.layout
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
    return State(moved.shared, fields, moved.rotations)


def _as_shown(problem: Problem) -> Bench:
    """Return the bench with each pupil where its disc shows it, if the camera is moved by hand; else the bench."""
    return problem.bench if problem.pupils is None else replace(problem.bench, pupils=problem.pupils.shown)


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
    by_shared = -equations.coupling @ equations.maps[bench.poses]
    by_field = -equations.coupling[:, :, bench.layout.own.places]
    loose = solution.star_variance * np.asarray(np.linalg.inv(equations.turns), np.float64)
    if marginal.uses_readings:
        kept = marginal.reading_variance(squares) * marginal.reading_weights(squares)
        by_stars = np.swapaxes(marginal.axes, 1, 2) @ (kept[:, :, None] * marginal.axes)
        by_shared, by_field, loose = by_stars @ by_shared, by_stars @ by_field, by_stars @ loose
        by_shared[:, :, bench.gimbal_places] += (np.eye(3) - by_stars) @ equations.gimbal
    direct = by_shared - by_field @ solution.follow[bench.poses]
    rows, poses = 3 * len(bench.poses), np.repeat(bench.poses, 3)
    spread = (by_field @ np.swapaxes(solution.own_root, 1, 2)[bench.poses]).reshape(rows, -1)
    of_pose = (poses[:, None] == poses) * (spread @ spread.T)
    return direct.reshape(rows, -1), of_pose + block_diagonal(loose)
