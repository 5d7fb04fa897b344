"""The bundle of all views: residuals of all stars, and their derivatives.

The residuals are those of arXiv:2512.16092, eq. 6. The structure follows bundle adjustment (Triggs et al., 2000). This
module sets up the equations; `calib.adjustment.levenberg_marquardt` solves them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.linearisation import Pull, residuals_px, robust_pull, squares, view_equations
from calib.adjustment.loss import Loss
from calib.adjustment.normal_equations import NormalEquations, ViewScores
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bundle:
    """Which parameters are estimated, from which stars."""

    observations: Observations
    names: tuple[str, ...]
    free_centres: bool = False  # Whether each view has its own centre
    # The pose of each view, as an index; None if each view is a pose of its own.
    poses: tuple[int, ...] | None = None

    def subset(self, kept: Sequence[int]) -> Bundle:
        """Return the bundle of some of the views."""
        obs = self.observations
        fewer = obs.of_view(kept[0]) if len(kept) == 1 else obs.with_rows(obs.rows(kept))
        poses = tuple(self.poses[i] for i in kept) if self.poses else None
        return replace(self, observations=fewer, poses=poses)

    def thinned(self, stars: int) -> Bundle:
        """Return a bundle with fewer stars, evenly spread over each view's list.

        Returns: Bundle with the same free parameters. Views that have fewer than twice as many stars keep all of
          them.
        """
        obs = self.observations
        steps = [max(1, (rows.stop - rows.start) // stars) for rows in obs.slices]
        kept = [np.arange(rows.start, rows.stop, step) for rows, step in zip(obs.slices, steps, strict=True)]
        return replace(self, observations=obs.with_rows(kept))

    def residuals_px(self, parameters: AdjustmentParameters) -> Array:
        """Return the residuals: image point found minus image point predicted.

        They are the residuals of arXiv:2512.16092, eq. 6, with the opposite sign.

        parameters: Where to evaluate the residuals.
        Returns: (N, 2) residuals, px; NaN for a star that cannot be projected.
        """
        return residuals_px(self.observations, parameters).T

    def weighted_residuals(self, parameters: AdjustmentParameters) -> Array:
        """Return the residuals in units of the stars' standard deviations.

        Their sum of squares is the weighted one of Triggs et al. (2000), section 3.2.

        parameters: Where to evaluate the residuals.
        Returns: (N, 2) weighted residuals, not to be written to; NaN for a star that cannot be projected.
        """
        obs = self.observations
        return obs.remembered((parameters,), lambda: obs.whitened(self.residuals_px(parameters)))

    def normal_equations(self, parameters: AdjustmentParameters, influence: Array) -> NormalEquations:
        """Linearise the cost by Gauss and Newton, and return the normal equations.

        parameters: Where to linearise.
        influence: (N, 2) gradient of the cost by each weighted residual.
        """
        obs, n = self.observations, len(self.names)
        pull = Pull(np.ascontiguousarray(obs.unwhitened(influence).T), squares(obs))
        normal, gradient = self._equations(parameters, pull)
        return NormalEquations(
            normal[:, :n, :n].sum(axis=0),
            gradient[:, :n].sum(axis=0),
            normal[:, n:, n:].copy(),
            gradient[:, n:].copy(),
            normal[:, :n, n:].copy(),
        )

    def pull(self, parameters: AdjustmentParameters, loss: Loss) -> Pull:
        """Return gradient and curvature of a robust cost by the image points (Triggs et al., 2000, section 4.3).

        parameters: Where to evaluate them.
        loss: Cost of a weighted residual.
        """
        residuals = self.weighted_residuals(parameters)
        return robust_pull(self.observations, residuals, loss.number, float(loss.limit))

    def scores(self, parameters: AdjustmentParameters, loss: Loss, *, curved: bool) -> ViewScores:
        """Return the information and the score of each view for the shared parameters, its local parameters eliminated.

        The score is the view's contribution J^T psi to the negative gradient of the cost. At the optimum
        the scores add up to zero. The local parameters are eliminated by the Schur complement (Triggs et al., 2000,
        section 6.1).

        parameters: Where to linearise.
        loss: Cost of a weighted residual; it enters the scores.
        curved: Whether the information has the curvature of the robust cost; else that of least squares.
        """
        n, pull = len(self.names), self.pull(parameters, loss)
        if not curved:
            pull = Pull(pull.gradient, squares(self.observations))
        return ViewScores.of(*self._equations(parameters, pull), n)

    def view_equations(self, parameters: AdjustmentParameters, loss: Loss) -> tuple[Array, Array]:
        """Return the equations of each view with a robust cost (Triggs et al., 2000, section 4.3).

        parameters: Where to linearise.
        loss: Cost of a weighted residual.
        Returns: (n, G + L, G + L) normal matrices and (n, G + L) negative gradients.
        """
        return self._equations(parameters, self.pull(parameters, loss))

    def _equations(self, parameters: AdjustmentParameters, pull: Pull) -> tuple[Array, Array]:
        """Return the normal matrix (n, G + L, G + L) and the gradient (n, G + L) of each view."""
        return view_equations(self.observations, parameters, self.names, self.free_centres, pull)
