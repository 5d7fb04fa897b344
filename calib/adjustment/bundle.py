"""The bundle of all views: residuals of all stars, their derivatives, and priors.

The residuals are those of arXiv:2512.16092, eq. 6. The structure follows bundle adjustment (Triggs et al., 2000). This
module sets up the equations; `calib.adjustment.levenberg_marquardt` solves them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.gimbal_observations import GimbalObservations
from calib.adjustment.linearisation import (
    Places,
    Pull,
    blocks,
    residuals_px,
    robust_pull,
    squares,
    view_equations,
)
from calib.adjustment.loss import Loss
from calib.adjustment.normal_equations import NormalEquations, ViewScores
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.collimator import CENTRE
from calib.model.gimbal import GIMBAL
from calib.model.prior import Prior

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bundle:
    """Which parameters are estimated, from which stars, with which priors."""

    observations: Observations
    names: tuple[str, ...]
    free_centres: bool = False  # Whether each view has its own centre
    # (N, 2, T) float64 displacement of each star, mm, by a unit of each of the collimator's aberrations, in
    # their order (`calib.model.aberrations`); None if there are no aberrations.
    displacements: Array | None = None
    # Prior 1-sigma per axis of a free centre about the collimator's centre, mm; infinite for no prior.
    drift_mm: float = float("inf")
    prior: Prior | None = None  # Prior of shared parameters; None for no prior
    # Variance of a component of the weighted residuals. Priors and readings are multiplied by it to balance
    # them with the stars.
    noise_variance: float = 1.0
    # Readings of the gimbal as observations; None if they are not used.
    gimbal: GimbalObservations | None = None
    # The pose of each view, as an index; None if each view is a pose of its own.
    poses: tuple[int, ...] | None = None

    @property
    def has_drift_prior(self) -> bool:
        """Whether the centre of each view is free, with a prior about the shared centre."""
        return self.free_centres and bool(np.isfinite(self.drift_mm))

    @property
    def has_priors(self) -> bool:
        """Whether `prior_cost` can differ from zero."""
        return self.has_drift_prior or self.prior is not None or self.gimbal is not None

    @property
    def _drift_information(self) -> float:
        """Prior information on a free centre, 1 / mm^2, times the noise variance."""
        return self.noise_variance / self.drift_mm**2

    @property
    def local_prior_information(self) -> Array:
        """(L, L) float64 prior information on the local parameters of a view, times the noise variance."""
        free = 6 if self.free_centres else 3
        return (
            np.diag([0.0] * 3 + [self._drift_information] * 3)
            if self.has_drift_prior
            else np.zeros((free, free))
        )

    @cached_property
    def prior_information(self) -> Array:
        """(G, G) float64 prior information on the free shared parameters, times the noise variance; constant."""
        information = np.zeros((len(self.names), len(self.names)))
        if self.prior is not None:
            at = self._prior_places
            information[np.ix_(at, at)] = self.noise_variance * self.prior.information
        return information

    @cached_property
    def _prior_places(self) -> list[int]:
        """Places of the prior's parameters among the names."""
        return [self.names.index(name) for name in self.prior.names] if self.prior else []

    def subset(self, kept: Sequence[int]) -> Bundle:
        """Return the bundle of some of the views."""
        obs, shifts = self.observations, self.displacements
        if len(kept) == 1:
            fewer = obs.of_view(kept[0])
            shifts = None if shifts is None else shifts[obs.slices[kept[0]]]
        else:
            rows = obs.rows(kept)
            fewer = obs.with_rows(rows)
            shifts = None if shifts is None else shifts[np.concatenate(rows)]
        return replace(
            self,
            observations=fewer,
            displacements=shifts,
            gimbal=self.gimbal.subset(kept) if self.gimbal else None,
            poses=tuple(self.poses[i] for i in kept) if self.poses else None,
        )

    def thinned(self, stars: int) -> Bundle:
        """Return a bundle with fewer stars, evenly spread over each view's list.

        Returns: Bundle with the same free parameters and priors. Views that have fewer than twice as many
          stars keep all of them.
        """
        obs = self.observations
        steps = [max(1, (rows.stop - rows.start) // stars) for rows in obs.slices]
        kept = [np.arange(rows.start, rows.stop, step) for rows, step in zip(obs.slices, steps, strict=True)]
        shifts = None if self.displacements is None else self.displacements[np.concatenate(kept)]
        return replace(self, observations=obs.with_rows(kept), displacements=shifts)

    def prior_cost(self, parameters: AdjustmentParameters) -> float:
        """Return the contribution of the priors and of the gimbal's readings to the cost.

        Half the squared distance from the mean in the metric of the prior's information: a Gaussian prior is one more
        observation (Triggs et al., 2000), here times the noise variance.

        parameters: Where to evaluate the cost.
        """
        cost = float((parameters.offsets**2).sum()) / self.drift_mm**2 if self.has_drift_prior else 0.0
        if self.prior is not None:
            off = parameters.values(self.prior.names) - self.prior.mean
            cost += float(off @ self.prior.information @ off)
        if self.gimbal is not None and parameters.gimbal is not None:
            read = self.gimbal.residuals(parameters.gimbal, parameters.rotations)
            weighted = self.gimbal.information(parameters.gimbal) @ read[:, :, None]
            cost += float((read * weighted[:, :, 0]).sum())
        return float(0.5 * self.noise_variance * cost)

    def residuals_px(self, parameters: AdjustmentParameters) -> Array:
        """Return the residuals: image point found minus image point predicted.

        They are the residuals of arXiv:2512.16092, eq. 6, with the opposite sign.

        parameters: Where to evaluate the residuals.
        Returns: (N, 2) residuals, px; NaN for a star that cannot be projected.
        """
        return residuals_px(self.observations, self.displacements, parameters).T

    def weighted_residuals(self, parameters: AdjustmentParameters) -> Array:
        """Return the residuals in units of the stars' standard deviations.

        Their sum of squares is the weighted one of Triggs et al. (2000), section 3.2.

        parameters: Where to evaluate the residuals.
        Returns: (N, 2) weighted residuals, not to be written to; NaN for a star that cannot be projected.
        """
        obs = self.observations
        return obs.remembered(
            (parameters, self.displacements), lambda: obs.whitened(self.residuals_px(parameters))
        )

    def normal_equations(
        self, parameters: AdjustmentParameters, influence: Array, curvature_root: Array | None = None
    ) -> NormalEquations:
        """Linearise the cost and return the normal equations.

        The linearisation is that of Gauss and Newton, with the curvature of the robust cost (Triggs et al., 2000,
        section 4.3).

        parameters: Where to linearise.
        influence: (N, 2) gradient of the cost by each weighted residual.
        curvature_root: (N, 2, 2) symmetric square root of the second derivative of the cost by each weighted
          residual; None for the identity.
        """
        obs = self.observations
        gradient = np.ascontiguousarray(obs.unwhitened(influence).T)
        return self._equations(parameters, Pull(gradient, squares(obs, curvature_root)))

    def robust_equations(self, parameters: AdjustmentParameters, loss: Loss) -> NormalEquations:
        """Linearise a robust cost with its own curvature (Triggs et al., 2000, section 4.3).

        parameters: Where to linearise.
        loss: Cost of a weighted residual.
        """
        return self._equations(parameters, self.pull(parameters, loss))

    def pull(self, parameters: AdjustmentParameters, loss: Loss) -> Pull:
        """Return gradient and curvature of a robust cost by the image points (Triggs et al., 2000, section 4.3).

        parameters: Where to evaluate them.
        loss: Cost of a weighted residual.
        """
        residuals = self.weighted_residuals(parameters)
        return robust_pull(self.observations, residuals, loss.number, float(loss.limit))

    def _equations(self, parameters: AdjustmentParameters, pull: Pull) -> NormalEquations:
        """Return the normal equations of all views and of the priors."""
        normal, gradient = self._view_equations(parameters, pull)
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

    def scores(self, parameters: AdjustmentParameters, loss: Loss, *, curved: bool) -> ViewScores:
        """Return the information and the score of each view for the shared parameters, its local parameters eliminated.

        The score is the view's contribution J^T psi to the negative gradient of the cost. At the optimum without prior
        the scores add up to zero. The local parameters are eliminated by the Schur complement (Triggs et al., 2000,
        section 6.1).

        parameters: Where to linearise.
        loss: Cost of a weighted residual; it enters the scores.
        curved: Whether the information has the curvature of the robust cost; else that of least squares.
        """
        n, pull = len(self.names), self.pull(parameters, loss)
        if not curved:
            pull = Pull(pull.gradient, squares(self.observations, None))
        normal, gradient = self._view_equations(parameters, pull)
        if self.has_drift_prior:
            normal[:, n:, n:] += self.local_prior_information
            gradient[:, n + 3 :] -= self._drift_information * parameters.offsets
        return ViewScores.of(normal, gradient, n)

    def view_equations(self, parameters: AdjustmentParameters, loss: Loss) -> tuple[Array, Array]:
        """Return the equations of each view with a robust cost (Triggs et al., 2000, section 4.3), without priors.

        parameters: Where to linearise.
        loss: Cost of a weighted residual.
        Returns: (n, G + L, G + L) normal matrices and (n, G + L) negative gradients.
        """
        return self._view_equations(parameters, self.pull(parameters, loss))

    def _view_equations(self, parameters: AdjustmentParameters, pull: Pull) -> tuple[Array, Array]:
        """Return the normal matrix (n, G + L, G + L) and the gradient (n, G + L) of each view, without priors."""
        normal, gradient = view_equations(
            self.observations, self.displacements, parameters, self.names, self.free_centres, pull
        )
        from_readings = self.reading_equations(parameters)
        if from_readings is None:
            return normal, gradient
        return normal + from_readings[0], gradient + from_readings[1]

    def reading_equations(self, parameters: AdjustmentParameters) -> tuple[Array, Array] | None:
        """Return what the gimbal's readings add to the normal equations of each view.

        A rotation on the camera's side changes the residual of a reading by itself, to first order.

        parameters: Where to linearise.
        Returns: (n, G + L, G + L) normal matrices and (n, G + L) negative gradients; None if readings are not
          used.
        """
        if self.gimbal is None or parameters.gimbal is None:
            return None
        count, local = len(self.names), 6 if self.free_centres else 3
        off = self.gimbal.residuals(parameters.gimbal, parameters.rotations)
        jacobian = np.zeros((len(off), 3, count + local))
        jacobian[:, :, :count] = self.gimbal.derivatives(parameters.gimbal, self.names)
        jacobian[:, :, count : count + 3] = np.eye(3)
        weighted = self.noise_variance * self.gimbal.information(parameters.gimbal) @ jacobian
        return np.swapaxes(weighted, 1, 2) @ jacobian, -np.einsum("nkj,nk->nj", weighted, off)

    def _add_priors(self, equations: NormalEquations, parameters: AdjustmentParameters) -> None:
        """Add the information and the gradient of the priors to equations.

        They are the second derivative and the negative gradient of `prior_cost`.
        """
        if self.has_drift_prior:
            equations.local[:, [3, 4, 5], [3, 4, 5]] += self._drift_information
            equations.local_gradient[:, 3:] -= self._drift_information * parameters.offsets
        if self.prior is not None:
            off = parameters.values(self.prior.names) - self.prior.mean
            equations.shared[:] += self.prior_information
            equations.shared_gradient[:] -= self.prior_information[:, self._prior_places] @ off

    def jacobians(self, parameters: AdjustmentParameters) -> Iterator[Array]:
        """Yield the derivatives of the image points of each view.

        They are those of `calib.adjustment.linearisation.blocks`.

        parameters: Where to evaluate the derivatives.
        Yields: (G + L, 2, n_i) derivatives of one view's n_i image points, px per unit, by the G free shared
          parameters and by the L local ones (rotation in rad, then centre in mm).
        """
        for block in blocks(self.observations, self.displacements, parameters, self.places(parameters)):
            for own in block.own:
                yield block.jacobian[:, :, own]

    def places(self, parameters: AdjustmentParameters) -> Places:
        """Return where the derivatives by the free parameters come from."""
        kinds = {
            "camera": parameters.camera.parameter_names,
            "centre": CENTRE,
            "aberration": tuple(parameters.collimator.aberrations),
            "gimbal": GIMBAL,
        }
        known = {name: (kind, at) for kind, names in kinds.items() for at, name in enumerate(names)}
        return Places([known[name] for name in self.names], 6 if self.free_centres else 3)
