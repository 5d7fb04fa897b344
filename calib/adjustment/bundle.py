"""The bundle of all views: the stars in common arrays, their residuals with derivatives, and the normal equations.

The residuals are those of arXiv:2512.16092, eq. 6. The structure follows bundle adjustment (Triggs et al., 2000). This
module sets up the equations; `calib.adjustment.levenberg_marquardt` solves them.

The views share few parameters, and each has its own rotation (and a centre, if it is free). The system is therefore
reduced by the Schur complement onto the shared parameters: the reduced camera system (Brown, 1976; Triggs et al.).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.adjustment.loss import Loss, lengths
from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array, Ints, median
from calib.errors import InputMismatch
from calib.view import View

#: Radial distortion of the collimator, as `calib.model.collimator.Collimator` has it.
RADIAL_TERM = "radial"
#: Number of rounded operations in a projection.
_ROUNDED_OPERATIONS = 10.0
_EPSILON = float(np.finfo(float).eps)
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Bundle:
    """Which parameters are estimated, from which stars."""

    observations: Observations
    names: tuple[str, ...]
    free_centres: bool = False  # Whether each view has its own centre

    def subset(self, kept: Sequence[int]) -> Bundle:
        """Return the bundle of some of the views."""
        slices = [self.observations.slices[i] for i in kept]
        fewer = self.observations.part([np.arange(rows.start, rows.stop) for rows in slices])
        return replace(self, observations=fewer)

    def thinned(self, stars: int) -> Bundle:
        """Return a bundle with fewer stars, evenly spread; views with fewer than twice as many stars keep all."""
        every = [np.arange(rows.start, rows.stop) for rows in self.observations.slices]
        kept = [rows[:: max(1, len(rows) // stars)] for rows in every]
        return replace(self, observations=self.observations.part(kept))

    def residuals_px(self, parameters: AdjustmentParameters) -> Array:
        """Return (N, 2) found minus predicted, px; NaN if it cannot be projected (arXiv:2512.16092, eq. 6, negated)."""
        points = self._in_camera(parameters)
        return np.asarray(self.observations.points_px - parameters.camera.project(points.T))

    def weighted_residuals(self, parameters: AdjustmentParameters) -> Array:
        """Return (N, 2) residuals in sigmas of the stars (Triggs et al., 2000, 3.2); NaN if it cannot be projected."""
        return mapped(self.observations.factors, self.residuals_px(parameters).T).T

    def costs(self, parameters: AdjustmentParameters, loss: Loss) -> Array:
        """Return the (n,) robust cost of each view; NaN if one of its stars cannot be projected."""
        costs = loss.costs(lengths(self.weighted_residuals(parameters)))
        return np.array([costs[rows].sum() for rows in self.observations.slices])

    def equations(
        self, parameters: AdjustmentParameters, loss: Loss, *, curved: bool = True
    ) -> ViewEquations:
        """Linearise the cost by Gauss and Newton (Triggs et al., 2000, section 4.3).

        NaN where a star cannot be projected. ``curved``: with the curvature of the robust cost, not of least squares.
        """
        residuals, slopes = self.linearised(parameters)
        distances, curving = lengths(residuals), slopes
        influence, costs = residuals * loss.weights(distances)[:, None], loss.costs(distances)
        if curved and loss.name != "l2":
            curving = mapped(loss.curvature_root(residuals), slopes)
        normal, right = [], []
        for rows in self.observations.slices:
            bent, steep = (each[:, :, rows].reshape(len(each), -1) for each in (curving, slopes))
            normal.append(bent @ bent.T)
            right.append(steep @ influence[rows].T.ravel())
        by_view = np.array([costs[rows].sum() for rows in self.observations.slices])
        return ViewEquations(np.array(normal), np.array(right), len(self.names), by_view)

    def rounding(self, cost: float) -> float:
        """Return how much rounding of the image points changes the cost.

        A smaller predicted reduction cannot be verified. For stars known to thousandths of a pixel, this limit exceeds
        the tolerance of an adjustment. Each residual has a random error of the machine's epsilon times its coordinates.
        Own estimate: independent errors d of the residuals e change sum e^2 / 2 by about d (sum e^2)^(1/2) = d (2
        cost)^(1/2).
        """
        obs = self.observations
        farthest_px = float(np.abs(obs.points_px).max())
        return _ROUNDED_OPERATIONS * _EPSILON * farthest_px * obs.sigmas_per_px * math.sqrt(2.0 * cost)

    def _in_camera(self, parameters: AdjustmentParameters) -> Array:
        """Return the (3, N) stars in the camera frame, P = R (X - c), mm (arXiv:2512.16092, eq. 2).

        With radial distortion a of the collimator, X lies 1 + a |h|^2 times as far from the axis; h: as a share of r.
        """
        obs = self.observations
        x, y, z = (obs.target - parameters.centres[obs.view]).T
        if distortion := parameters.collimator.aberrations.get(RADIAL_TERM):
            farther = 1.0 + distortion * (x * x + y * y) / z**2
            x, y = farther * x, farther * y
        turns = parameters.rotations[obs.view].transpose(1, 2, 0)
        return np.asarray(turns[:, 0] * x + turns[:, 1] * y + turns[:, 2] * z)

    def linearised(self, parameters: AdjustmentParameters) -> tuple[Array, Array]:
        """Return the (N, 2) weighted residuals, and the (G + L, 2, N) derivatives of the weighted image points.

        Own, by the chain rule: a rotation t on the camera's side moves P by t x P, a shift s of the centre by -R s.
        """
        obs, points = self.observations, self._in_camera(parameters)
        before = np.where(points[2] > 0, points, np.nan)
        pixels, by_point, by_camera = parameters.camera.project_with_jacobians(before.T)
        slopes = by_point.transpose(2, 1, 0)
        (x, y, z), (u, v, w) = points, slopes
        turned = [y * w - z * v, z * u - x * w, x * v - y * u]
        turns = parameters.rotations[obs.view].transpose(1, 2, 0)[:, :, None]
        moved = -(turns[0] * u + turns[1] * v + turns[2] * w)
        known = dict(zip(parameters.camera.parameter_names, by_camera.transpose(2, 1, 0), strict=True))
        known |= {"x": moved[0], "y": moved[1], "r": -moved[2]}
        if RADIAL_TERM in self.names:
            known |= self._by_distorted_glass(parameters, moved)
        rows = [*(known[name] for name in self.names), *turned, *(moved if self.free_centres else ())]
        return mapped(obs.factors, (obs.points_px - pixels).T).T, mapped(obs.factors, np.array(rows))

    def _by_distorted_glass(self, parameters: AdjustmentParameters, moved: Array) -> dict[str, Array]:
        """Return the (2, N) derivatives by centre and radial distortion; ``moved`` (3, 2, N) those without distortion.

        Own, by the chain rule for X - c = (v (1 + a q), r) with q = |v|^2 / r^2.
        """
        x, y, r = (self.observations.target - parameters.centres[self.observations.view]).T
        a, q = parameters.collimator.aberrations[RADIAL_TERM], (x * x + y * y) / r**2
        outward = x * moved[0] + y * moved[1]
        return {
            "x": (1.0 + a * q) * moved[0] + 2.0 * a * x / r**2 * outward,
            "y": (1.0 + a * q) * moved[1] + 2.0 * a * y / r**2 * outward,
            "r": 2.0 * a * q / r * outward - moved[2],
            RADIAL_TERM: -q * outward,
        }


@dataclass(frozen=True)
class Observations:
    """The N stars of all views, view after view."""

    target: Array  # (N, 3) float64 positions on the target, mm, with Z = 0
    points_px: Array  # (N, 2) float64 image points, px
    # (N, 2, 2) float64 inverse Cholesky factors of the stars' covariances, 1 / px. They give residuals unit
    # covariance (Aitken, 1936).
    whitening: Array
    slices: tuple[slice, ...]
    view: Ints  # (N,) int64 index of the view of each row

    @classmethod
    def from_views(cls, views: Sequence[View]) -> Observations:
        """Stack the stars of views, in their order; the covariance of each star must be positive definite."""
        target = np.concatenate([view.target_mm for view in views])
        return cls(
            np.column_stack([target, np.zeros(len(target))]),
            np.concatenate([view.points_px for view in views]),
            _whitening(np.concatenate([view.covariances_px2 for view in views])),
            *_stacked([len(view) for view in views]),
        )

    @cached_property
    def sigmas_per_px(self) -> float:
        """How many standard deviations of a typical star make 1 px."""
        return math.sqrt(median(np.abs(self.whitening[:, 0, 0] * self.whitening[:, 1, 1])))

    @cached_property
    def factors(self) -> Array:
        """(2, 2, N) float64 the whitening as contiguous rows over the stars, for `mapped`."""
        return np.ascontiguousarray(self.whitening.transpose(1, 2, 0))

    def part(self, rows: Sequence[Ints]) -> Observations:
        """Return observations of one view for each entry of `rows`: its row indices, (N_i,) int64."""
        every = np.concatenate(rows)
        kept = self.target[every], self.points_px[every], self.whitening[every]
        return Observations(*kept, *_stacked([len(r) for r in rows]))


def mapped(matrices: Array, rows: Array) -> Array:
    """Multiply the vectors of the stars by a matrix of each, row by row: several times faster than small products.

    matrices: (2, 2, N). rows: (..., 2, N) vectors.
    """
    x, y = rows[..., 0, :], rows[..., 1, :]
    return np.stack([matrix[0] * x + matrix[1] * y for matrix in matrices], axis=-2)


def _whitening(covariances: Array) -> Array:
    """Return (N, 2, 2) the inverses of the Cholesky factors of (N, 2, 2) covariances."""
    try:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariances)))
    except np.linalg.LinAlgError as error:
        raise InputMismatch(
            "A point's covariance is not positive definite.",
            remedy="Use unit covariances if they are unknown.",
        ) from error


def _stacked(counts: Sequence[int]) -> tuple[tuple[slice, ...], Ints]:
    """Return the rows of views with the given numbers of stars, and the view of each row."""
    ends = np.cumsum(counts)
    slices = tuple(slice(int(end - n), int(end)) for n, end in zip(counts, ends, strict=True))
    return slices, np.repeat(np.arange(len(counts)), counts)


@dataclass(frozen=True)
class ViewScores:
    """Information and scores of n views for the G shared parameters, with their L local parameters eliminated."""

    information: Array  # (n, G, G) float64 information
    score: Array  # (n, G) float64 contribution to the negative gradient of the cost
    answer: Array  # (n, L, G) float64; if the shared parameters step by s, a view steps by own - answer s
    own: Array  # (n, L) float64, step of a view while the shared parameters stay


@dataclass(frozen=True)
class ViewEquations:
    """The normal equations of n views: G shared parameters, then the L local ones of each view."""

    normal: Array  # (n, G + L, G + L) float64
    right: Array  # (n, G + L) float64 negative gradients of the cost
    count: int  # G
    costs: Array  # (n,) float64 cost of each view; NaN if one of its stars cannot be projected

    @property
    def local(self) -> Array:
        """(n, L, L) float64 block of the local parameters."""
        return self.normal[:, self.count :, self.count :]

    @property
    def coupling(self) -> Array:
        """(n, L, G) float64 block between the local and the shared parameters."""
        return self.normal[:, self.count :, : self.count]

    def eliminated(self, damping: float = 0.0) -> ViewScores:
        """Eliminate the local parameters of each view by the Schur complement (Triggs et al., 2000, section 6.1).

        The diagonal of the local block grows by the share ``damping`` (Marquardt, 1963). LinAlgError if it is singular.
        """
        count = self.count
        local = self.local * (1.0 + damping * np.eye(len(self.right[0]) - count))
        known = np.concatenate([self.coupling, self.right[:, count:, None]], axis=2)
        solved = np.linalg.solve(local, known)
        eliminated = np.swapaxes(self.coupling, 1, 2) @ solved
        information = self.normal[:, :count, :count] - eliminated[:, :, :count]
        score = self.right[:, :count] - eliminated[:, :, count]
        return ViewScores(information, score, solved[:, :, :count], solved[:, :, count])

    def step(self, damping: float) -> tuple[Array, Array]:
        """Return the damped step (Marquardt, 1963) of the shared (G,) and of the local (n, L) parameters.

        The reduced equations are scaled to a unit diagonal (van der Sluis, 1969). LinAlgError if they are singular.
        """
        views = self.eliminated(damping)
        diagonal = np.diagonal(self.normal, axis1=1, axis2=2)[:, : self.count].sum(axis=0)
        information = views.information.sum(axis=0) + damping * np.diag(diagonal)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), _TINY))
        scaled = information * np.outer(scale, scale)
        shared = scale * np.linalg.solve(scaled, scale * views.score.sum(axis=0))
        return shared, views.own - views.answer @ shared
