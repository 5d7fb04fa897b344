"""All views at once: the residuals of every star, their derivatives, and what is known beforehand.

Knows how camera, collimator and rotations together predict the stars; not how to search.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.normal_equations import NormalEquations
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.collimator import CENTRE
from calib.model.prior import Prior

Array = NDArray[np.float64]


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
        order (`calib.model.aberrations`); None: it has none.
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
    def has_drift_prior(self) -> bool:
        """Whether each view's centre is free, but bound to the shared one."""
        return self.free_centres and bool(np.isfinite(self.drift_mm))

    @property
    def _drift_information(self) -> float:
        """What binds a centre, in the residuals' unit over mm^2."""
        return self.noise_variance / self.drift_mm**2

    @property
    def local_prior_information(self) -> Array:
        """(L, L) what binds a view's own parameters beforehand, in the residuals' unit."""
        free = 6 if self.free_centres else 3
        return (
            np.diag([0.0] * 3 + [self._drift_information] * 3)
            if self.has_drift_prior
            else np.zeros((free, free))
        )

    @property
    def prior_information(self) -> Array:
        """(G, G) what is known of the shared parameters beforehand, in the residuals' unit."""
        information = np.zeros((len(self.names), len(self.names)))
        if self.prior is not None:
            at = [self.names.index(name) for name in self.prior.names]
            information[np.ix_(at, at)] = self.noise_variance * self.prior.information
        return information

    def subset(self, kept: Sequence[int]) -> Bundle:
        """Return the same with some of its views."""
        rows = self.observations.rows(kept)
        shifts = None if self.displacements is None else self.displacements[np.concatenate(rows)]
        return replace(self, observations=self.observations.with_rows(rows), displacements=shifts)

    def thinned(self, stars: int) -> Bundle:
        """Return the same with some tens of stars of each view, evenly taken."""
        obs = self.observations
        steps = [max(1, (rows.stop - rows.start) // stars) for rows in obs.slices]
        kept = [np.arange(rows.start, rows.stop, step) for rows, step in zip(obs.slices, steps, strict=True)]
        shifts = None if self.displacements is None else self.displacements[np.concatenate(kept)]
        return replace(self, observations=obs.with_rows(kept), displacements=shifts)

    def prior_cost(self, parameters: AdjustmentParameters) -> float:
        """Return what the priors add to the cost, in the residuals' unit."""
        cost = float((parameters.offsets**2).sum()) / self.drift_mm**2 if self.has_drift_prior else 0.0
        if self.prior is not None:
            off = parameters.values(self.prior.names) - self.prior.mean
            cost += float(off @ self.prior.information @ off)
        return float(0.5 * self.noise_variance * cost)

    def residuals_px(self, parameters: AdjustmentParameters) -> Array:
        """Return (N, 2) star found minus star projected, px; NaN where a star cannot be projected."""
        return np.asarray(
            self.observations.points_px - parameters.camera.project(self._in_camera(parameters))
        )

    def weighted_residuals(self, parameters: AdjustmentParameters) -> Array:
        """Return (N, 2) the misses in units of the stars' own uncertainty."""
        return self.observations.whitened(self.residuals_px(parameters))

    def normal_equations(
        self, parameters: AdjustmentParameters, influence: Array, curvature_root: Array | None = None
    ) -> NormalEquations:
        """Linearise at a state.

        Parameters
        ----------
        state
            Where.
        influence
            (N, 2) gradient of the cost by each star's residual.
        curvature_root
            (N, 2, 2) symmetric root of the cost's second derivative by it; None: unity.
        """
        normal, gradient = self._view_equations(parameters, influence, curvature_root)
        n = len(self.names)
        equations = NormalEquations(
            normal[:, :n, :n].sum(axis=0),
            gradient[:, :n].sum(axis=0),
            normal[:, n:, n:].copy(),
            gradient[:, n:].copy(),
            normal[:, :n, n:].copy(),
        )
        self._add_priors(equations, parameters)
        return equations

    def scores(
        self, parameters: AdjustmentParameters, influence: Array, curvature_root: Array | None = None
    ) -> Iterator[tuple[Array, Array]]:
        """Yield, for each view, its own information on the shared parameters (G, G) and its pull at them (G,)."""
        n = len(self.names)
        for i, (normal, gradient) in enumerate(
            zip(*self._view_equations(parameters, influence, curvature_root), strict=True)
        ):
            local, local_gradient, coupling = normal[n:, n:], gradient[n:], normal[:n, n:]
            if self.has_drift_prior:
                local = local + self.local_prior_information
                local_gradient[3:] -= self._drift_information * parameters.offsets[i]
            solved = np.linalg.solve(local, np.column_stack([coupling.T, local_gradient]))
            yield normal[:n, :n] - coupling @ solved[:, :-1], gradient[:n] - coupling @ solved[:, -1]

    def _view_equations(
        self, parameters: AdjustmentParameters, influence: Array, curvature_root: Array | None
    ) -> tuple[Array, Array]:
        """Return each view's normal matrix (n, G + L, G + L) and gradient (n, G + L), priors aside."""
        weight = (
            self.observations.whitening
            if curvature_root is None
            else curvature_root @ self.observations.whitening
        )
        square = np.ascontiguousarray((np.swapaxes(weight, 1, 2) @ weight).transpose(1, 2, 0))
        weighted_influence = np.ascontiguousarray(self.observations.unwhitened(influence).T)
        normal, gradient = [], []
        for rows, slopes in zip(self.observations.slices, self.jacobians(parameters), strict=True):
            flat, own = slopes.reshape(len(slopes), -1), square[:, :, rows]
            weighted = slopes * np.stack([own[0, 0], own[1, 1]]) + slopes[:, ::-1] * own[0, 1]
            normal.append(flat @ weighted.reshape(flat.shape).T)
            gradient.append(flat @ weighted_influence[:, rows].reshape(-1))
        return np.array(normal), np.array(gradient)

    def _add_priors(self, equations: NormalEquations, parameters: AdjustmentParameters) -> None:
        """Add what the priors pull at a state."""
        if self.has_drift_prior:
            equations.local[:, [3, 4, 5], [3, 4, 5]] += self._drift_information
            equations.local_gradient[:, 3:] -= self._drift_information * parameters.offsets
        if self.prior is not None:
            at = [self.names.index(name) for name in self.prior.names]
            information = self.noise_variance * self.prior.information
            equations.shared[np.ix_(at, at)] += information
            equations.shared_gradient[at] -= information @ (
                parameters.values(self.prior.names) - self.prior.mean
            )

    def _in_camera(self, parameters: AdjustmentParameters) -> Array:
        """Return (N, 3) the stars in the camera frame: R (P - c)."""
        points = self.observations.target.copy()
        if self.displacements is not None:
            coefficients = np.array(list(parameters.collimator.aberrations.values()))
            points[:, :2] += self.displacements @ coefficients
        views = zip(self.observations.slices, parameters.rotations, parameters.centres, strict=True)
        for rows, rotation, centre in views:
            points[rows] = (points[rows] - centre) @ rotation.T
        return points

    def jacobians(self, parameters: AdjustmentParameters) -> Iterator[Array]:
        """Yield, for each view, (G + L, 2, n) the projection's derivatives, px, by its parameters, then by its own.

        View by view and one contiguous row a parameter: what is worked on stays in the processor's cache.
        """
        camera, points = parameters.camera, self._in_camera(parameters)
        _, by_points, by_camera = camera.project_with_jacobians(points)
        along, by_camera = by_points.transpose(2, 1, 0), by_camera.transpose(2, 1, 0)
        shifts = None if self.displacements is None else self.displacements.transpose(2, 1, 0)
        count, depth = len(self.names), 6 if self.free_centres else 3
        places = self._places(parameters)
        for rows, rotation in zip(self.observations.slices, parameters.rotations, strict=True):
            x, y, z = points[rows].T
            u, v, w = along[:, :, rows]
            slopes = np.empty((count + depth, 2, len(x)))
            # A turn t on the camera's side moves the point by t x P; a move of the centre, by -R times it.
            slopes[count] = y * w - z * v
            slopes[count + 1] = z * u - x * w
            slopes[count + 2] = x * v - y * u
            by_centre = np.tensordot(-rotation.T, along[:, :, rows], 1)
            slopes[count + 3 :] = by_centre[: depth - 3]
            for row, (kind, at) in zip(slopes, places, strict=False):
                if kind == "camera":
                    row[:] = by_camera[at, :, rows]
                elif kind == "centre":
                    row[:] = -by_centre[at] if CENTRE[at] == "r" else by_centre[at]
                elif shifts is not None:
                    row[:] = -(by_centre[0] * shifts[at, 0, rows] + by_centre[1] * shifts[at, 1, rows])
            yield slopes

    def _places(self, parameters: AdjustmentParameters) -> list[tuple[str, int]]:
        """Return for each free shared parameter what it belongs to, and its place there."""
        kinds = {
            "camera": parameters.camera.parameter_names,
            "centre": CENTRE,
            "aberration": tuple(parameters.collimator.aberrations),
        }
        known = {name: (kind, at) for kind, names in kinds.items() for at, name in enumerate(names)}
        return [known[name] for name in self.names]
