"""Leave-one-out cross-validation over views, and the jackknife.

Views that were left out measure how well a model predicts. The estimates without them measure how much the views differ
(the jackknife).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment import star_kernels
from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss, refine
from calib.adjustment.linearisation import residuals_px
from calib.adjustment.parameters import AdjustmentParameters
from calib.model.collimator import Collimator
from calib.uncertainty.repeats import pose_scores, views_of_poses

Array = NDArray[np.float64]

#: Leaving one view out must leave enough to calibrate with.
MIN_VIEWS = 3
#: Views differ by far more than what a refit leaves undone at this tolerance: some hundredths of a sigma.
_TOLERANCE = 1e-8
#: With as many others, one Newton step from the optimum of all ends within some hundredths of a sigma of theirs.
_STEP_VIEWS = 9
#: Behind a collimator the centres of the views agree to a few per cent of the radius. If they scatter by more than this
#: share of their distance, the target is a board that was placed anew for each view.
_PLACED_BY_HAND = 0.1


@dataclass(frozen=True)
class CrossValidation:
    """Results of leaving out each of P poses in turn, with all its views.

    Attributes
    ----------
    values
        (P, G) float64 shared parameters estimated without each pose.
    rms_px
        (n,) float64 root mean square residual of each view, px, with camera and centre of the others and its own
        rotation.
    stars
        (n,) int64 number of its stars.
    """

    values: Array
    rms_px: Array
    stars: NDArray[np.int64]

    @property
    def total_rms_px(self) -> float:
        """Root mean square residual of all stars of all views, px."""
        return float(np.sqrt((self.rms_px**2 * self.stars).sum() / self.stars.sum()))

    @property
    def jackknife(self) -> Array:
        """(G, G) float64 jackknife covariance of P poses: (P - 1) / P sum (v - mean)(v - mean)^T (Efron, 1982)."""
        n = len(self.values)
        off = self.values - self.values.mean(axis=0)
        return np.asarray((n - 1) / n * off.T @ off)


def leave_one_out(bundle: Bundle, parameters: AdjustmentParameters, loss: Loss) -> CrossValidation:
    """Adjust without each pose in turn, from the optimum of all views.

    With many views one Newton step replaces the full adjustment (compare Pregibon, 1981, on one-step deletion).
    Cross-validation: Stone (1974).

    Parameters
    ----------
    bundle
        Bundle of at least 3 poses.
    parameters
        Its optimum.
    loss
        Loss with the limit that the adjustment ended with.

    Returns
    -------
    CrossValidation
        Estimates without each pose, and the predicted residuals of its views.
    """
    values, rms, stars = [], [], []
    poses = views_of_poses(bundle)
    at_optimum = _view_costs(bundle, parameters, loss)
    for left_out, near in zip(poses, _steps_without(bundle, parameters, loss), strict=True):
        others = [j for j in range(len(parameters.rotations)) if j not in left_out]
        fewer, without = _priors_of(bundle, others), near.subset(others)
        start = parameters.subset(others)
        cost = at_optimum[others].sum() + fewer.prior_cost(start)
        far = not _view_costs(bundle, near, loss)[others].sum() + fewer.prior_cost(without) <= cost
        if far or len(poses) <= _STEP_VIEWS:
            start = start if far else without
            without = refine(bundle.subset(others), start, loss, tolerance=_TOLERANCE).parameters
        values.append(without.values(bundle.names))
        for i in left_out:
            residuals = _alone(bundle, without, parameters.rotations[i], parameters.centres[i], i)
            rms.append(np.sqrt((residuals**2).sum(axis=1).mean()))
            stars.append(len(residuals))
    return CrossValidation(np.array(values), np.array(rms), np.array(stars))


def _priors_of(bundle: Bundle, kept: Sequence[int]) -> Bundle:
    """Return the bundle with the readings of some views, for `Bundle.prior_cost`; all stars stay."""
    return replace(bundle, gimbal=bundle.gimbal.subset(kept)) if bundle.gimbal else bundle


def _steps_without(
    bundle: Bundle, parameters: AdjustmentParameters, loss: Loss
) -> Iterator[AdjustmentParameters]:
    """Yield, for each pose, the parameters one Newton step from the optimum of all towards that without it.

    Without pose i, the reduced normal equations are H - A_i, and their right side is the missing score, -s_i. One-step
    deletion: Pregibon (1981); the reduced equations are this project's own.
    """
    residuals = bundle.weighted_residuals(parameters)
    lengths = np.linalg.norm(residuals, axis=1)
    influence, root = residuals * loss.weights(lengths)[:, None], loss.curvature_root(residuals)
    equations = bundle.normal_equations(parameters, influence, root)
    information = equations.reduced()
    answers = np.linalg.solve(equations.local, np.swapaxes(equations.coupling, 1, 2))
    for own, score in pose_scores(bundle, parameters, influence, root):
        left = information - own
        # Scaled to a unit diagonal: the parameters differ by many orders of magnitude.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(left), np.finfo(float).tiny))
        step = np.linalg.lstsq(left * np.outer(scale, scale), scale * score, rcond=None)[0]
        shared = np.asarray(-scale * step, np.float64)
        yield parameters.after_step(bundle.names, shared, -answers @ shared)


def _view_costs(bundle: Bundle, parameters: AdjustmentParameters, loss: Loss) -> Array:
    """Return the (n,) robust costs of the stars of each view; infinite if a star cannot be projected."""
    obs = bundle.observations
    residuals = residuals_px(obs, bundle.displacements, parameters)
    star_kernels.whiten(residuals, obs.factors)
    costs = [
        star_kernels.robust_cost(residuals, rows.start, rows.stop, loss.number, loss.limit)
        for rows in obs.slices
    ]
    return np.array(costs)


def _alone(bundle: Bundle, others: AdjustmentParameters, rotation: Array, centre: Array, i: int) -> Array:
    """Return the residuals, (N, 2) px, of a view of which only the rotation is adjusted; of a board, its whole pose."""
    collimator, own = others.collimator, np.zeros((1, 3))
    by_hand = False
    if bundle.free_centres and not bundle.has_drift_prior:
        x, y, z = others.centres.mean(axis=0)
        collimator = Collimator(float(x), float(y), float(-z))
        by_hand = bool(np.linalg.norm(others.centres.std(axis=0)) > _PLACED_BY_HAND * abs(z))
    view = replace(bundle.subset([i]), names=(), free_centres=by_hand, prior=None, gimbal=None)
    if by_hand:
        own = centre[None] - collimator.centre
    start = AdjustmentParameters(others.camera, collimator, rotation[None], own)
    return view.residuals_px(refine(view, start, Loss("l2"), tolerance=_TOLERANCE).parameters)
