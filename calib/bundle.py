"""All views at once: the residuals of every star, their derivatives, and the normal equations.

Knows how camera, collimator and rotations together predict the stars; not how to search. The views share few
parameters and have each a rotation of their own (and a centre, where it is free), so the normal equations are
reduced to the shared ones by the Schur complement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.camera import CameraModel
from calib.collimator import PARAMETERS as COLLIMATOR_PARAMETERS
from calib.collimator import Collimator
from calib.errors import InputMismatch
from calib.rotation import exp_map, skew
from calib.view import View

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observations:
    """The stars of all views, one below the other.

    Attributes
    ----------
    target
        (N, 3) positions on the target, mm, with Z = 0.
    points_px
        (N, 2) image points, px.
    whitening
        (N, 2, 2) inverse Cholesky factors of the stars' covariances; they give residuals unit covariance.
    slices
        The rows of each view.
    view
        (N,) index of each row's view.
    """

    target: Array
    points_px: Array
    whitening: Array
    slices: tuple[slice, ...]
    view: NDArray[np.int64]

    @classmethod
    def from_views(cls, views: Sequence[View]) -> Observations:
        """Stack views.

        Raises
        ------
        InputMismatch
            When a star's covariance is not positive definite.
        """
        counts = [len(view) for view in views]
        ends = np.cumsum(counts)
        target = np.concatenate([view.target_mm for view in views])
        covariances = np.concatenate([view.covariances_px2 for view in views])
        try:
            whitening = np.linalg.inv(np.linalg.cholesky(covariances))
        except np.linalg.LinAlgError:
            raise InputMismatch(
                "A star's covariance is not positive definite.", remedy="Give unit covariances if unknown."
            ) from None
        return cls(
            np.column_stack([target, np.zeros(len(target))]),
            np.concatenate([view.points_px for view in views]),
            whitening,
            tuple(slice(int(end - n), int(end)) for n, end in zip(counts, ends, strict=True)),
            np.repeat(np.arange(len(views)), counts),
        )


@dataclass(frozen=True)
class State:
    """A camera, a collimator and each view's rotation and centre.

    Attributes
    ----------
    camera, collimator
        What the views share.
    rotations
        (n, 3, 3), camera <- target.
    offsets
        (n, 3) each view's centre less the collimator's, mm; zero in the spherical model.
    """

    camera: CameraModel
    collimator: Collimator
    rotations: Array
    offsets: Array

    @property
    def centres(self) -> Array:
        """(n, 3) centre of each view in the target frame, mm."""
        return self.collimator.centre + self.offsets

    def values(self, names: Sequence[str]) -> Array:
        """Return shared parameters by name."""
        known = {**self.camera.to_dict(), **self.collimator.to_dict()}
        return np.array([known[name] for name in names])

    def moved(self, names: Sequence[str], shared: Array, local: Array) -> State:
        """Return the state after a step.

        `shared` adds to the named parameters; `local`, (n, 3 or 6), turns each view by a rotation vector on the
        camera's side and moves its centre.
        """
        known = {**self.camera.to_dict(), **self.collimator.to_dict()}
        for name, step in zip(names, shared, strict=True):
            known[name] += float(step)
        camera = self.camera.with_values(np.array([known[name] for name in self.camera.parameter_names]))
        collimator = replace(self.collimator, **{name: known[name] for name in COLLIMATOR_PARAMETERS})
        rotations = exp_map(local[:, :3]) @ self.rotations
        offsets = self.offsets + local[:, 3:] if local.shape[1] > 3 else self.offsets
        return State(camera, collimator, rotations, offsets)


@dataclass(frozen=True)
class NormalEquations:
    """J^T W J and J^T W e, split into shared and per-view blocks.

    Attributes
    ----------
    shared, shared_gradient
        (G, G) and (G,).
    local, local_gradient
        (n, L, L) and (n, L).
    coupling
        (n, G, L).
    """

    shared: Array
    shared_gradient: Array
    local: Array
    local_gradient: Array
    coupling: Array

    def damped(self, damping: float) -> NormalEquations:
        """Return the equations with Marquardt's damping: diagonals times 1 + damping."""
        diagonal = np.arange(self.local.shape[1])
        local, shared = self.local.copy(), self.shared.copy()
        local[:, diagonal, diagonal] *= 1.0 + damping
        shared[np.diag_indices_from(shared)] *= 1.0 + damping
        return replace(self, shared=shared, local=local)

    def reduced(self) -> Array:
        """Return the Schur complement onto the shared parameters, (G, G): their information."""
        solved = np.linalg.solve(self.local, np.swapaxes(self.coupling, 1, 2))
        return np.asarray(self.shared - (self.coupling @ solved).sum(axis=0))

    def step(self) -> tuple[Array, Array]:
        """Solve for the step: shared (G,) and per view (n, L).

        Raises
        ------
        numpy.linalg.LinAlgError
            When the equations are singular.
        """
        solved = np.linalg.solve(self.local, self.local_gradient[:, :, None])
        right = self.shared_gradient - (self.coupling @ solved).sum(axis=0)[:, 0]
        # Scaled to a unit diagonal: the parameters differ by many orders of magnitude.
        information = self.reduced()
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
        shared = scale * np.linalg.solve(information * np.outer(scale, scale), scale * right)
        back = self.local_gradient - np.einsum("ngl,g->nl", self.coupling, shared)
        return shared, np.linalg.solve(self.local, back[:, :, None])[:, :, 0]

    def decrement(self, shared: Array, local: Array) -> float:
        """Return gradient times step: twice the reduction of the cost that a full step promises."""
        return float(self.shared_gradient @ shared + (self.local_gradient * local).sum())


@dataclass(frozen=True)
class Bundle:
    """What is estimated from which stars.

    Attributes
    ----------
    observations
        The stars.
    names
        Names of the shared parameters that are free.
    free_centres
        Whether each view has a centre of its own (the planar model).
    """

    observations: Observations
    names: tuple[str, ...]
    free_centres: bool = False

    def misses_px(self, state: State) -> Array:
        """Return (N, 2) star found minus star projected, px; NaN where a star cannot be projected."""
        return np.asarray(self.observations.points_px - state.camera.project(self._in_camera(state)))

    def residuals(self, state: State) -> Array:
        """Return (N, 2) the misses in units of the stars' own uncertainty."""
        return np.asarray((self.observations.whitening @ self.misses_px(state)[:, :, None])[:, :, 0])

    def normal_equations(self, state: State, pull: Array, root: Array | None = None) -> NormalEquations:
        """Linearise at a state.

        Parameters
        ----------
        state
            Where.
        pull
            (N, 2) gradient of the cost by each star's residual.
        root
            (N, 2, 2) symmetric root of the cost's second derivative by it; None: unity.
        """
        by_shared, by_local = self._jacobians(state)
        n, size, depth = len(self.observations.slices), len(self.names), by_local.shape[2]
        shared, shared_gradient = np.zeros((size, size)), np.zeros(size)
        local, local_gradient = np.zeros((n, depth, depth)), np.zeros((n, depth))
        coupling = np.zeros((n, size, depth))
        for i, rows in enumerate(self.observations.slices):
            e, g, v = pull[rows].reshape(-1), by_shared[rows], by_local[rows]
            shared_gradient += _flat(g).T @ e
            local_gradient[i] = _flat(v).T @ e
            if root is not None:
                g, v = root[rows] @ g, root[rows] @ v
            g, v = _flat(g), _flat(v)
            shared += g.T @ g
            local[i], coupling[i] = v.T @ v, g.T @ v
        return NormalEquations(shared, shared_gradient, local, local_gradient, coupling)

    def _in_camera(self, state: State) -> Array:
        """Return (N, 3) the stars in the camera frame: R (P - c)."""
        view = self.observations.view
        from_centre = self.observations.target - state.centres[view]
        return np.asarray((state.rotations[view] @ from_centre[:, :, None])[:, :, 0])

    def _jacobians(self, state: State) -> tuple[Array, Array]:
        """Return the whitened projection's derivatives, (N, 2, G) by shared, (N, 2, L) by local parameters."""
        obs, camera = self.observations, state.camera
        points = self._in_camera(state)
        _, by_points, by_camera = camera.project_with_jacobians(points)
        by_points = obs.whitening @ by_points
        # A turn w on the camera's side moves the point by w x P; a move of the centre, by -R times it.
        by_turn = -by_points @ skew(points)
        by_centre = -by_points @ state.rotations[obs.view]
        by_collimator = by_centre * [1.0, 1.0, -1.0]
        columns = {name: i for i, name in enumerate((*camera.parameter_names, *COLLIMATOR_PARAMETERS))}
        by_all = np.concatenate([obs.whitening @ by_camera, by_collimator], axis=2)
        by_shared = by_all[:, :, [columns[name] for name in self.names]]
        by_local = np.concatenate([by_turn, by_centre], axis=2) if self.free_centres else by_turn
        return by_shared, by_local


def _flat(jacobian: Array) -> Array:
    """Return (2 N, k) of (N, 2, k)."""
    return jacobian.reshape(2 * jacobian.shape[0], jacobian.shape[2])
