"""All views at once: the residuals of every star, their derivatives, and what is known beforehand.

Knows how camera, collimator and rotations together predict the stars; not how to search.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.collimator import CENTRE
from calib.normal import NormalEquations
from calib.observations import Observations
from calib.state import State

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prior:
    """What is known of shared parameters beforehand: a Gaussian.

    Attributes
    ----------
    names
        The parameters, each of them free in the bundle.
    mean
        (K,) expected values.
    information
        (K, K) inverse covariance.
    """

    names: tuple[str, ...]
    mean: Array
    information: Array


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
        Whether each view has a centre of its own.
    displacements
        (N, 2, T) displacement of each star by a unit of each of the collimator's imperfections, in their
        order (`calib.imperfections`); None: it has none.
    drift_mm
        1-sigma, per axis, of a free centre about the collimator's; infinite: nothing binds it.
    prior
        What is known of shared parameters; None: nothing.
    noise_variance
        Variance of a whitened residual component, by which priors are weighed against the stars.
    """

    observations: Observations
    names: tuple[str, ...]
    free_centres: bool = False
    displacements: Array | None = None
    drift_mm: float = float("inf")
    prior: Prior | None = None
    noise_variance: float = 1.0

    @property
    def drifts(self) -> bool:
        """Whether each view's centre is free, but bound to the shared one."""
        return self.free_centres and bool(np.isfinite(self.drift_mm))

    @property
    def _drift_stiffness(self) -> float:
        """What binds a centre, in the residuals' unit over mm^2."""
        return self.noise_variance / self.drift_mm**2

    def only(self, kept: Sequence[int]) -> Bundle:
        """Return the same with some of its views."""
        rows = self.observations.rows(kept)
        shifts = None if self.displacements is None else self.displacements[np.concatenate(rows)]
        return replace(self, observations=self.observations.taken(rows), displacements=shifts)

    def thinned(self, stars: int) -> Bundle:
        """Return the same with some tens of stars of each view, evenly taken."""
        obs = self.observations
        steps = [max(1, (rows.stop - rows.start) // stars) for rows in obs.slices]
        kept = [np.arange(rows.start, rows.stop, step) for rows, step in zip(obs.slices, steps, strict=True)]
        shifts = None if self.displacements is None else self.displacements[np.concatenate(kept)]
        return replace(self, observations=obs.taken(kept), displacements=shifts)

    def prior_cost(self, state: State) -> float:
        """Return what the priors add to the cost, in the residuals' unit."""
        cost = float((state.offsets**2).sum()) / self.drift_mm**2 if self.drifts else 0.0
        if self.prior is not None:
            off = state.values(self.prior.names) - self.prior.mean
            cost += float(off @ self.prior.information @ off)
        return float(0.5 * self.noise_variance * cost)

    def misses_px(self, state: State) -> Array:
        """Return (N, 2) star found minus star projected, px; NaN where a star cannot be projected."""
        return np.asarray(self.observations.points_px - state.camera.project(self._in_camera(state)))

    def residuals(self, state: State) -> Array:
        """Return (N, 2) the misses in units of the stars' own uncertainty."""
        return self.observations.whitened(self.misses_px(state))

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
        blocks = list(self._blocks(state, pull, root))
        shared, shared_gradient, local, local_gradient, coupling = zip(*blocks, strict=True)
        equations = NormalEquations(
            np.sum(shared, axis=0),
            np.sum(shared_gradient, axis=0),
            np.array(local),
            np.array(local_gradient),
            np.array(coupling),
        )
        self._add_priors(equations, state)
        return equations

    def scores(self, state: State, pull: Array) -> Iterator[tuple[Array, Array]]:
        """Yield, for each view, its own information on the shared parameters (G, G) and its pull at them (G,)."""
        for i, blocks in enumerate(self._blocks(state, pull, None)):
            shared, gradient, local, local_gradient, coupling = blocks
            if self.drifts:
                local[[3, 4, 5], [3, 4, 5]] += self._drift_stiffness
                local_gradient[3:] -= self._drift_stiffness * state.offsets[i]
            solved = np.linalg.solve(local, np.column_stack([coupling.T, local_gradient]))
            yield shared - coupling @ solved[:, :-1], gradient - coupling @ solved[:, -1]

    def _blocks(self, state: State, pull: Array, root: Array | None) -> Iterator[tuple[Array, ...]]:
        """Yield each view's shared and local normal blocks and gradients, and their coupling."""
        jacobian = self._jacobian(state)
        n, k = len(self.names), jacobian.shape[2]
        for rows in self.observations.slices:
            columns = jacobian[rows].reshape(-1, k)
            gradient = columns.T @ pull[rows].reshape(-1)
            if root is not None:
                columns = (root[rows] @ jacobian[rows]).reshape(-1, k)
            normal = columns.T @ columns
            yield normal[:n, :n], gradient[:n], normal[n:, n:], gradient[n:], normal[:n, n:]

    def _add_priors(self, equations: NormalEquations, state: State) -> None:
        """Add what the priors pull at a state."""
        if self.drifts:
            equations.local[:, [3, 4, 5], [3, 4, 5]] += self._drift_stiffness
            equations.local_gradient[:, 3:] -= self._drift_stiffness * state.offsets
        if self.prior is not None:
            at = [self.names.index(name) for name in self.prior.names]
            information = self.noise_variance * self.prior.information
            equations.shared[np.ix_(at, at)] += information
            equations.shared_gradient[at] -= information @ (state.values(self.prior.names) - self.prior.mean)

    def _in_camera(self, state: State) -> Array:
        """Return (N, 3) the stars in the camera frame: R (P - c)."""
        points = self.observations.target.copy()
        if self.displacements is not None:
            coefficients = np.array(list(state.collimator.imperfections.values()))
            points[:, :2] += self.displacements @ coefficients
        views = zip(self.observations.slices, state.rotations, state.centres, strict=True)
        for rows, rotation, centre in views:
            points[rows] = (points[rows] - centre) @ rotation.T
        return points

    def _jacobian(self, state: State) -> Array:
        """Return the whitened projection's derivatives (N, 2, G + L): by shared, then by local parameters."""
        camera, points = state.camera, self._in_camera(state)
        _, by_points, by_camera = camera.project_with_jacobians(points)
        # A turn w on the camera's side moves the point by w x P; a move of the centre, by -R times it.
        by_turn = _cross(points[:, None, :], by_points)
        by_centre = np.empty_like(by_points)
        for rows, rotation in zip(self.observations.slices, state.rotations, strict=True):
            by_centre[rows] = (by_points[rows].reshape(-1, 3) @ -rotation).reshape(-1, 2, 3)
        parts = {name: by_camera[:, :, i] for i, name in enumerate(camera.parameter_names)}
        parts |= dict(zip(CENTRE, (by_centre[:, :, 0], by_centre[:, :, 1], -by_centre[:, :, 2]), strict=True))
        if self.displacements is not None:
            for i, name in enumerate(state.collimator.imperfections):
                parts[name] = -(by_centre[:, :, :2] * self.displacements[:, None, :, i]).sum(axis=2)
        local = np.concatenate([by_turn, by_centre], axis=2) if self.free_centres else by_turn
        shared = [parts[name][:, :, None] for name in self.names]
        return self.observations.whitened(np.concatenate([*shared, local], axis=2))


def _cross(a: Array, b: Array) -> Array:
    """Return a x b along the last axis; numpy's own is several times slower."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    product[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    product[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    product[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product
