"""The bundle of all views: residuals of all stars, and their derivatives.

The residuals are those of arXiv:2512.16092, eq. 6. The structure follows bundle adjustment (Triggs et al., 2000). This
module sets up the equations; `calib.adjustment.levenberg_marquardt` solves them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.loss import Loss, lengths
from calib.adjustment.normal_equations import ViewEquations
from calib.adjustment.observations import Observations, mapped
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
        slices = [self.observations.slices[i] for i in kept]
        fewer = self.observations.part([np.arange(rows.start, rows.stop) for rows in slices])
        poses = tuple(self.poses[i] for i in kept) if self.poses else None
        return replace(self, observations=fewer, poses=poses)

    def thinned(self, stars: int) -> Bundle:
        """Return a bundle with fewer stars, evenly spread over each view's list.

        Returns: Bundle with the same free parameters. Views that have fewer than twice as many stars keep all of
          them.
        """
        obs = self.observations
        steps = np.maximum(1, obs.stars // stars).tolist()
        kept = [np.arange(rows.start, rows.stop, step) for rows, step in zip(obs.slices, steps, strict=True)]
        return replace(self, observations=obs.part(kept))

    def residuals_px(self, parameters: AdjustmentParameters) -> Array:
        """Return the residuals: image point found minus image point predicted.

        They are the residuals of arXiv:2512.16092, eq. 6, with the opposite sign.

        parameters: Where to evaluate the residuals.
        Returns: (N, 2) residuals, px; NaN for a star that cannot be projected.
        """
        points = self._in_camera(parameters)
        return np.asarray(self.observations.points_px - parameters.camera.project(points.T))

    def weighted_residuals(self, parameters: AdjustmentParameters) -> Array:
        """Return the residuals in units of the stars' standard deviations.

        Their sum of squares is the weighted one of Triggs et al. (2000), section 3.2.

        parameters: Where to evaluate the residuals.
        Returns: (N, 2) weighted residuals; NaN for a star that cannot be projected.
        """
        return mapped(self.observations.factors, self.residuals_px(parameters).T).T

    def costs(self, parameters: AdjustmentParameters, loss: Loss) -> Array:
        """Return the (n,) robust cost of each view; NaN if one of its stars cannot be projected."""
        costs = loss.costs(lengths(self.weighted_residuals(parameters)))
        return np.array([costs[rows].sum() for rows in self.observations.slices])

    def equations(
        self, parameters: AdjustmentParameters, loss: Loss, *, curved: bool = True
    ) -> ViewEquations:
        """Linearise the cost by Gauss and Newton (Triggs et al., 2000, section 4.3).

        parameters: Where to linearise. All stars must be in front of the camera.
        loss: Cost of a weighted residual.
        curved: Whether the normal matrices have the curvature of the robust cost; else that of least squares.
        """
        residuals = self.weighted_residuals(parameters)
        influence = residuals * loss.weights(lengths(residuals))[:, None]
        slopes = curving = self._derivatives(parameters)
        if curved and loss.is_robust:
            curving = mapped(loss.curvature_root(residuals), slopes)
        normal, right = [], []
        for rows in self.observations.slices:
            block = curving[:, :, rows].reshape(len(curving), -1)
            normal.append(block @ block.T)
            right.append(slopes[:, :, rows].reshape(len(slopes), -1) @ influence[rows].T.ravel())
        return ViewEquations(np.array(normal), np.array(right), len(self.names))

    def _in_camera(self, parameters: AdjustmentParameters) -> Array:
        """Return the (3, N) stars in the camera frame, P = R (X - c), mm (arXiv:2512.16092, eq. 2)."""
        obs = self.observations
        of_views = zip(obs.slices, parameters.rotations, parameters.centres, strict=True)
        seen = [turn @ (obs.target[rows] - centre).T for rows, turn, centre in of_views]
        return np.concatenate(seen, axis=1)

    def _derivatives(self, parameters: AdjustmentParameters) -> Array:
        """Return the (G + L, 2, N) derivatives of the weighted image points, one row of stars for each.

        Own derivation, by the chain rule: a rotation t on the camera's side moves P by t x P, and a shift s of the
        centre moves it by -R s.
        """
        obs, points = self.observations, self._in_camera(parameters)
        _, by_point, by_camera = parameters.camera.project_with_jacobians(points.T)
        slopes = by_point.transpose(2, 1, 0)
        (x, y, z), (u, v, w) = points, slopes
        turned = [y * w - z * v, z * u - x * w, x * v - y * u]
        of_views = zip(obs.slices, parameters.rotations, strict=True)
        shifted = [np.tensordot(-turn, slopes[:, :, rows], (0, 0)) for rows, turn in of_views]
        moved = np.concatenate(shifted, axis=2)
        known = dict(zip(parameters.camera.parameter_names, by_camera.transpose(2, 1, 0), strict=True))
        known |= {"x": moved[0], "y": moved[1], "r": -moved[2]}
        rows = [*(known[name] for name in self.names), *turned, *(moved if self.free_centres else ())]
        return mapped(obs.factors, np.array(rows))
