"""Leave-one-out cross-validation over views, and the jackknife.

Left-out views measure how well a model predicts; the estimates without them, how much the views differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array, Ints
from calib.model.collimator import Collimator
from calib.uncertainty.covariance import views_of_poses

#: Leaving one view out must leave enough to calibrate with.
MIN_VIEWS = 3
#: Views differ by far more than what a refit leaves undone at this tolerance: some hundredths of a sigma.
_TOLERANCE = 1e-8
#: Behind a collimator the centres of the views agree to a few per cent of the radius. If they scatter by more than this
#: share of their distance, the target is a board that was placed anew for each view.
_PLACED_BY_HAND = 0.1


@dataclass(frozen=True)
class CrossValidation:
    """Results of leaving out each of P poses in turn, with all its views."""

    values: Array  # (P, G) float64 shared parameters estimated without each pose
    # (n,) float64 root mean square residual of each view, px, with camera and centre of the others and its
    # own rotation.
    rms_px: Array
    stars: Ints  # (n,) int64 number of its stars

    @property
    def total_rms_px(self) -> float:
        """Root mean square residual of all stars of all views, px."""
        return float(np.sqrt((self.rms_px**2 * self.stars).sum() / self.stars.sum()))


def leave_one_out(bundle: Bundle, parameters: AdjustmentParameters, loss: Loss) -> CrossValidation:
    """Adjust without each of at least 3 poses in turn, from the optimum of all, and predict its views (Stone, 1974)."""
    poses, without = views_of_poses(bundle), []
    for left_out in poses:
        others = [j for j in range(len(parameters.rotations)) if j not in left_out]
        start = parameters.subset(others)
        without.append(refine(bundle.subset(others), start, loss, tolerance=_TOLERANCE).parameters)
    order = [i for views in poses for i in views]
    return CrossValidation(
        np.array([one.values(bundle.names) for one in without]),
        np.array(_rms_left_out(bundle, poses, without, parameters)),
        bundle.observations.stars[order],
    )


def _rms_left_out(
    bundle: Bundle,
    poses: Sequence[Sequence[int]],
    without: Sequence[AdjustmentParameters],
    parameters: AdjustmentParameters,
) -> list[float]:
    """Return the rms residuals, px, of each pose left out, with its rotation (of a board: its pose) adjusted."""
    found = []
    for views, one in zip(poses, without, strict=True):
        others, by_hand = one, False
        if bundle.free_centres:
            x, y, z = one.centres.mean(axis=0).tolist()
            by_hand = bool(np.linalg.norm(one.centres.std(axis=0)) > _PLACED_BY_HAND * abs(z))
            others = replace(one, collimator=Collimator(x, y, -z))
        for i in views:
            offset = (parameters.centres[i] - others.collimator.centre) * by_hand
            start = replace(others, rotations=parameters.rotations[i : i + 1], offsets=offset[None])
            view = replace(bundle.subset([i]), names=(), free_centres=by_hand)
            end = refine(view, start, Loss("l2"), tolerance=_TOLERANCE).parameters
            found.append(float(np.sqrt((view.residuals_px(end) ** 2).sum(axis=1).mean())))
    return found
