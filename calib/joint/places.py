"""The places of a pupil that is moved by hand: the most probable ones, and what they add to the uncertainty.

Fields by turn are multiplied by these places. At the fields found, the equations are linear in the places, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.arrays import Array
from calib.joint.effects.by_turn import slopes
from calib.joint.marginal import Solution
from calib.joint.pose_equations import maps_with_gimbal, normal_of_poses
from calib.joint.prior import block_diagonal, inverse_root
from calib.joint.pupils import Pupils

#: Share of what the stars say of the places that counts in the uncertainty. Glass that does not follow the pupil alone
#: moves the places: with all of it, 25 poses before such a glass were up to 2.8 U wrong. With none of it, U of nine
#: poses with poor discs was three times larger than with this.
_COUNTED = 0.1


class _Seen(NamedTuple):
    """What stars and readings say of the bases of n poses, each with its own field eliminated."""

    information: Array  # (n, B, B)
    shared: Array  # (n, S, B) information with the shared unknowns
    right: Array  # (n, B) right-hand side, after the step of all other unknowns


def step_to_places(solution: Solution) -> Array:
    """Return the (n, 2) step, in sines, from the present places to the most probable ones."""
    bench, pupils = solution.marginal.problem.bench, _pupils(solution)
    seen, moved = _seen(solution), _moved(solution)
    pull = (moved.swapaxes(1, 2) @ seen.right[:, :, None])[:, :, 0]
    to_discs = pupils.information @ (bench.pupils - pupils.shown).reshape(-1)
    gradient, curvature = _of_determinant(solution)
    information = pupils.information + _information(seen, moved, solution) + block_diagonal(curvature)
    step = np.linalg.solve(information, (pull - gradient).reshape(-1) - to_discs)
    return np.asarray(step.reshape(-1, 2), np.float64)


def narrowed(solution: Solution) -> float:
    """Return 2 log of by how much the stars narrow the places that the discs leave open.

    With the places integrated out, -2 log of the likelihood is so much larger than at the most probable ones (Laplace).
    """
    discs = _pupils(solution).information
    with_stars = discs + _information(_seen(solution), _moved(solution), solution)
    return float(np.linalg.slogdet(with_stars)[1] - np.linalg.slogdet(discs)[1])


def spread_of_places(solution: Solution) -> Array:
    """Return the (S, S) covariance of the shared unknowns that comes from errors of the places.

    Fields by turn multiply an error of a place, and so do their own errors: the product of two independent errors has
    the product of their variances.
    """
    columns = solution.marginal.problem.bench.layout.by_turn.columns
    errors = np.linalg.cholesky(solution.covariance[columns[:, None], columns])
    return _spread(solution, np.column_stack([_fields(solution), errors]))


def spread_by_fields(solution: Solution) -> Array:
    """Return the part of `spread_of_places` that comes from the fields found, without their errors."""
    return _spread(solution, _fields(solution)[:, None])


def _spread(solution: Solution, fields: Array) -> Array:
    """Return the (S, S) sum of what errors of the places do, each multiplied by (Q, L) fields by turn."""
    bench, seen = solution.marginal.problem.bench, _seen(solution)
    by_turn, stars = bench.layout.by_turn, _information(seen, _moved(solution), solution)
    places = inverse_root(_pupils(solution).information + _COUNTED * stars)[0]
    along = by_turn.slopes(bench.pupils)
    turned = np.einsum("kia,iaq->kiq", places.reshape(len(places), *along.shape[:2]), along)
    moved = np.einsum("kiq,isq->ksq", turned, seen.shared[:, :, by_turn.rows]) @ fields
    half = solution.covariance @ moved.swapaxes(0, 1).reshape(len(solution.covariance), -1)
    return half @ half.T


def _pupils(solution: Solution) -> Pupils:
    """Return the pupils of a mount that is moved by hand; no other mount has places."""
    pupils = solution.marginal.problem.pupils
    assert pupils is not None
    return pupils


def _fields(solution: Solution) -> Array:
    """Return the (Q,) coefficients of the fields by turn."""
    marginal = solution.marginal
    return (marginal.state.shared + solution.step)[marginal.problem.bench.layout.by_turn.columns]


def _moved(solution: Solution) -> Array:
    """Return (n, B, 2) what the places do to the bases."""
    bench = solution.marginal.problem.bench
    by_turn = bench.layout.by_turn
    along = by_turn.slopes(bench.pupils) * _fields(solution)
    return np.asarray((along @ np.eye(bench.layout.pose.size)[by_turn.rows]).swapaxes(1, 2))


def _information(seen: _Seen, moved: Array, solution: Solution) -> Array:
    """Return the (2 n, 2 n) information of the places, all else eliminated."""
    shared = np.concatenate(list(seen.shared @ moved), axis=1)
    alone = moved.swapaxes(1, 2) @ seen.information @ moved
    return np.asarray(block_diagonal(alone) - shared.T @ solution.covariance @ shared)


def _seen(solution: Solution) -> _Seen:
    marginal, bench = solution.marginal, solution.marginal.problem.bench
    size, maps = bench.layout.pose.size, maps_with_gimbal(bench, marginal.equations.maps)
    normal = normal_of_poses(marginal, solution.squares)
    shared = maps.swapaxes(1, 2) @ normal[:, :, :size]
    return _Seen(normal[:, :size, :size], shared, normal[:, :size, -1] - solution.step @ shared)


def _of_determinant(solution: Solution) -> tuple[Array, Array]:
    """Return (n, 2), (n, 2, 2) half of gradient and curvature of log det of the shared information by the places.

    Without them the places would follow fields that are hardly known. Readings have no part in them. Where a pose alone
    determines the fields, its place changes hardly any determinant: only what others know of it bends.
    """
    marginal, bench = solution.marginal, solution.marginal.problem.bench
    stars = marginal.equations.squares / solution.star_variance
    by_turn, own = bench.layout.by_turn, bench.layout.own.places
    left = stars - stars[:, :, own] @ solution.own @ stars[:, own]
    maps = marginal.equations.maps
    spread = maps @ solution.covariance
    together = left @ spread[:, :, by_turn.columns]
    gradient = (by_turn.slopes(bench.pupils) @ together[:, by_turn.rows, range(len(by_turn.rows)), None])[
        :, :, 0
    ]
    others = left - left @ (spread @ maps.swapaxes(1, 2)) @ left
    powers, of = np.unique(
        by_turn.powers, axis=0, return_inverse=True
    )  # fields of the same powers have one slope
    known = np.zeros((len(powers), len(powers), *others.shape[1:]))
    covariance = solution.covariance[by_turn.columns[:, None], by_turn.columns]
    known[of[:, None], of, by_turn.rows[:, None], by_turn.rows] = covariance
    curved = others.reshape(len(others), -1) @ known.reshape(len(powers) ** 2, -1).T
    turned = slopes(bench.pupils, powers)
    return gradient, turned @ curved.reshape(-1, len(powers), len(powers)) @ turned.swapaxes(1, 2)
