"""Poses left out, and the errors of the rotations: closed forms at the mode."""

from __future__ import annotations

import numpy as np

from calib.arrays import Array
from calib.model.result_parts import RotationErrors
from calib.model.rotation import exp_map, skew

from .posterior import Posterior
from .problem import Problem, State
from .shapes import CENTRE
from .solution import Solution, reading_weights

#: Fewest poses of which one can be left out.
MIN_POSES = 3
#: Steps to the best rotation of a pose that is left out.
_ALIGNMENTS = 2


def left_out_rms(solution: Solution) -> float | None:
    """Return the root mean square residual of poses left out, of which only the rotation is adjusted, px.

    The other poses predict the shared unknowns: one step from the mode, by a downdate of the information. The left-out
    pose has no own field. A pupil that a hand moves is where the disc shows it; where it is along the axis no disc
    shows, that is adjusted, too. None with fewer than three poses.
    """
    q, p, prior = solution.equations, solution.problem, solution.prior
    if p.n < MIN_POSES:
        return None
    information = np.linalg.inv(solution.covariance)
    total, count, basis = 0.0, 0.0, p.size
    weights = reading_weights(q, prior)
    for pose in range(p.n):
        t, follow, members = q.maps[pose], solution.follow[pose], p.members[pose]
        local = np.linalg.inv(solution.own[pose])
        right = local @ (solution.local[pose] + follow @ solution.step)
        own = (
            prior.star * t.T @ q.of_views[members][:, :basis, :basis].sum(axis=0) @ t
            - follow.T @ local @ follow
        )
        pull = prior.star * t.T @ q.right_of_views[members][:, :basis].sum(axis=0) - follow.T @ right
        if p.readings is not None:
            at = p.readings.at
            for v in members:
                own[np.ix_(at, at)] += weights[v] * q.by_gimbal[v].T @ q.by_gimbal[v]
                pull[at] += weights[v] * q.by_gimbal[v].T @ q.off[v]
        others = information - 0.5 * (own + own.T)
        step = np.linalg.solve(others, information @ solution.step - pull)
        residuals = _predicted(solution, pose, step)
        for v, residual in residuals:
            weight = q.weights.whole[v]
            seen = np.isfinite(residual).all(axis=1)
            total += float(weight[seen] @ (residual[seen] ** 2).sum(axis=1))
            count += float(weight[seen].sum())
    return float(np.sqrt(total / count))


def _predicted(solution: Solution, pose: int, step: Array) -> list[tuple[int, Array]]:
    """Return the views of a pose with their residuals (N, 2), px, after a step of the shared unknowns."""
    q, p, state = solution.equations, solution.problem, solution.equations.state
    own = state.own.copy()
    own[pose] = 0.0
    moved = State(_as_shown(p, state.b + step, pose), own, state.rotations)
    seen, c, found = p.bases(moved)[pose], moved.b[: p.depth], []
    for v in p.members[pose]:
        rotations, stars, basis = state.rotations.copy(), p.stars[v], seen.copy()
        for _ in range(_ALIGNMENTS):
            there = State(moved.b, own, rotations)
            points = p.points(there, v, basis)
            px, by_point, _ = p.camera.linearised(c, points)
            columns = -by_point @ skew(points)
            if p.places is not None:
                columns = np.concatenate([columns, (by_point @ rotations[v][:, 2])[:, :, None]], axis=2)
            root = np.sqrt(q.weights.whole[v])[:, None, None] * stars.whitening
            rows = (root @ columns).reshape(-1, columns.shape[2])
            turn = np.linalg.lstsq(rows, (root @ (stars.px - px)[:, :, None]).reshape(-1), rcond=None)[0]
            rotations[v] = exp_map(np.asarray(turn[:3], np.float64)) @ rotations[v]
            basis[p.depth] += turn[3:].sum()
        points = p.points(State(moved.b, own, rotations), v, basis)
        found.append((v, stars.px - p.camera.project(c, points)))
    return found


def _as_shown(problem: Problem, b: Array, pose: int) -> Array:
    """Return shared unknowns with which the pupil of a pose is where its disc shows it.

    That the places of all poses have a known mean would make this one what the others leave.
    """
    if problem.places is None:
        return b
    at, root, shown = problem.unknowns.places("place"), problem.places.root[pose], b.copy()
    shown[at] -= np.linalg.pinv(root) @ (root @ b[at])
    return shown


def rotation_errors(posterior: Posterior) -> RotationErrors:
    """Return how the rotations of all m views follow the shared unknowns, and what each adds.

    The centre has the names and units of a result, so that two cameras before one collimator can be compared.
    """
    solution, problem = posterior.largest.solution, posterior.problem
    q, m = solution.equations, len(problem.poses)
    by_shared = np.concatenate(
        [-solution.follow[pose, slot] for pose, slot in zip(problem.poses, q.slots, strict=True)]
    )
    own = np.zeros((m, 3, m, 3))
    for views in problem.members:
        for v in views:
            for w in views:
                own[v, :, w] = solution.own[problem.poses[v], q.slots[v], q.slots[w]]
    names, unit, means = list(problem.unknowns.names), np.ones(len(posterior.mean)), posterior.mean.copy()
    r = problem.fields.r0 * float(np.exp(problem.unknowns.log_r @ posterior.mean))
    for name, at, scale in zip(
        CENTRE,
        (*problem.unknowns.places("x y"), *problem.unknowns.places("r")),
        (problem.fields.r0, problem.fields.r0, r),
        strict=False,
    ):
        names[at], unit[at] = name, scale
    for k, name in enumerate(names):
        if name in CENTRE:
            zero = problem.fields.reference[CENTRE.index(name)]
            means[k] = r if name == "r" else zero + unit[k] * means[k]
        else:
            means[k] *= unit[k]
    prior = solution.prior.shared / unit**2
    pull = solution.prior.shared * (problem.unknowns.mean - posterior.mean) / unit
    covariance = posterior.covariance * np.outer(unit, unit)
    return RotationErrors(
        tuple(names), means, covariance, np.diag(prior), pull, by_shared / unit, own.reshape(3 * m, 3 * m)
    )
