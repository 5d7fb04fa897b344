"""Stars and readings, linearised at a state, as a small matrix a view: trying amplitudes then costs milliseconds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.arrays import Array, Ints
from calib.model.rotation import skew

from .fields import K
from .problem import Problem, State
from .pupils import about_disc, by_middle
from .weights import Weights


@dataclass(frozen=True)
class Bent:
    """Half of how log det of the information changes with the places of a pupil: with it, they are the most probable.

    Fields by turn multiply the places. Without it, the places would follow fields that are hardly known.
    """

    at: Ints  # (P,) the unknowns
    gradient: Array  # (P,)
    curvature: Array  # (P, P)


@dataclass(frozen=True)
class Equations:
    """Normal equations in unit noise of the stars."""

    problem: Problem
    state: State
    weights: Weights
    of_views: Array  # (m, B + 3, B + 3) information of a view's basis and rotation
    right_of_views: Array  # (m, B + 3)
    cost: float  # Weighted squares of the residuals
    off: Array  # (m, 3) rotations from the readings' predictions; no rows without readings
    by_gimbal: Array  # (m, 3, G) turn of the predictions
    bent: Bent | None = None  # By places of a pupil that a hand moves

    @classmethod
    def at(cls, problem: Problem, state: State, weights: Weights) -> Equations:
        """Return the equations at a state, with weights of the stars."""
        size = problem.size + 3
        bases, c = problem.bases(state), state.b[: problem.depth]
        whole = weights.whole
        of_views, rights, cost = np.zeros((len(whole), size, size)), np.zeros((len(whole), size)), 0.0
        for v, stars in enumerate(problem.stars):
            points = problem.points(state, v, bases[problem.poses[v]])
            px, by_point, by_camera = problem.camera.linearised(c, points)
            root = np.sqrt(whole[v])[:, None, None] * stars.whitening
            by_target = by_point @ state.rotations[v]
            across = (problem.fields.r0 * by_target[:, :, :2, None]) * stars.polynomials[:, None, None]
            columns = [by_camera, by_target[:, :, 2:], across.reshape(len(px), 2, 2 * K)]
            if stars.disc is not None:
                basis = bases[problem.poses[v]]
                moved_mm, sizes = basis[problem.middle], basis[problem.rim]
                columns.append(by_target[:, :, :2] @ about_disc(stars.disc, stars.mm, moved_mm))
                columns.append(by_target[:, :, :2] @ by_middle(stars.disc, stars.mm, moved_mm, sizes))
            columns.append(-by_point @ skew(points))
            rows = (root @ np.concatenate(columns, axis=2)).reshape(-1, size)
            left = (root @ (stars.px - px)[:, :, None]).reshape(-1)
            of_views[v], rights[v] = rows.T @ rows, rows.T @ left
            cost += float(left @ left)
        off, by_gimbal = np.zeros((0, 3)), np.zeros((0, 3, 0))
        if problem.readings is not None:
            g = state.b[problem.readings.at]
            off, by_gimbal = problem.readings.off(g, state.rotations), problem.readings.jacobian(g)
        return cls(problem, state, weights, of_views, rights, cost, off, by_gimbal)

    @cached_property
    def observed(self) -> float:
        """Number of star coordinates, each with its robust weight."""
        return self.weights.observed

    @cached_property
    def logarithm(self) -> float:
        """Sum of the logarithms of the precisions of all coordinates."""
        return self.weights.logarithm

    @cached_property
    def slots(self) -> list[slice]:
        """For each view where its rotation is among the unknowns of its pose: the own field, then its views."""
        number = [members.index(v) for members in self.problem.members for v in members]
        order = [v for members in self.problem.members for v in members]
        place = dict(zip(order, number, strict=True))
        f = self.own_size
        return [slice(f + 3 * place[v], f + 3 * place[v] + 3) for v in range(len(self.problem.poses))]

    @property
    def own_size(self) -> int:
        """Number F of the own coefficients of a pose."""
        return len(self.problem.own.size)

    @property
    def local_size(self) -> int:
        """Number of unknowns of a pose: those of poses with fewer views are held at zero."""
        return self.own_size + 3 * max(len(members) for members in self.problem.members)

    @cached_property
    def empty(self) -> Array:
        """(n, L) 1 for unknowns of poses that stand for no view, else 0."""
        views = np.array([len(members) for members in self.problem.members])
        return np.asarray((np.arange(self.local_size) > self.own_size - 1 + 3 * views[:, None]).astype(float))

    @cached_property
    def maps(self) -> Array:
        """(n, B, S) what the shared unknowns do to the poses here."""
        problem = self.problem
        b, log_r = self.state.b, problem.unknowns.log_r
        maps = problem.maps(b).copy()
        maps[:, problem.depth] += problem.fields.r0 * np.exp(log_r @ b) * log_r
        maps[:, problem.field] += problem.by_places(b)
        return maps

    @cached_property
    def shared(self) -> Array:
        """(S, S) information of the shared unknowns by the stars."""
        return np.asarray((np.swapaxes(self.maps, 1, 2) @ self.of_poses @ self.maps).sum(axis=0))

    @cached_property
    def of_poses(self) -> Array:
        """(n, B, B) information of the bases of the poses."""
        size = self.problem.size
        return np.array(
            [self.of_views[members][:, :size, :size].sum(axis=0) for members in self.problem.members]
        )

    @cached_property
    def shared_right(self) -> Array:
        """(S,) its right-hand side."""
        size = self.problem.size
        rights = [self.right_of_views[members][:, :size].sum(axis=0) for members in self.problem.members]
        return np.asarray(np.tensordot(np.array(rights), self.maps, 2))

    @property
    def local(self) -> tuple[Array, Array, Array]:
        """(n, L, S) information between unknowns of the poses and the shared ones, (n, L, L) alone, (n, L) right."""
        return self._between_shared, *self.of_local[1:]

    @cached_property
    def _between_shared(self) -> Array:
        return np.asarray(self.of_local[0] @ self.maps)

    @cached_property
    def of_local(self) -> tuple[Array, Array, Array]:
        """(n, L, B) information between unknowns of the poses and their bases, (n, L, L) alone, (n, L) right."""
        problem, size, f = self.problem, self.problem.size, self.own_size
        between = np.zeros((problem.n, self.local_size, size))
        alone = np.zeros((problem.n, self.local_size, self.local_size))
        right = np.zeros((problem.n, self.local_size))
        for v, (pose, slot) in enumerate(zip(problem.poses, self.slots, strict=True)):
            whole, rhs, own = self.of_views[v], self.right_of_views[v], problem.own.basis[pose]
            across = whole[size:, :size]
            between[pose, :f] += own.T @ whole[:size, :size]
            between[pose, slot] = across
            alone[pose, :f, :f] += own.T @ whole[:size, :size] @ own
            alone[pose, slot, :f], alone[pose, :f, slot] = across @ own, (across @ own).T
            alone[pose, slot, slot] = whole[size:, size:]
            right[pose, :f] += own.T @ rhs[:size]
            right[pose, slot] = rhs[size:]
        return between, alone, right

    def turns(self, local: Array) -> Array:
        """Return (m, 3) the rotation vectors of the views in (n, L) unknowns of the poses."""
        return np.array(
            [local[pose, slot] for pose, slot in zip(self.problem.poses, self.slots, strict=True)]
        )

    def left(self, step: Array, local: Array) -> float:
        """Return the weighted squares of the stars after a step, by the normal equations."""
        between, alone, right = self.local
        squares = self.cost - 2.0 * float(step @ self.shared_right + (local * right).sum())
        squares += float(step @ self.shared @ step)
        return squares + float((local * (2.0 * between @ step + (alone @ local[:, :, None])[:, :, 0])).sum())
