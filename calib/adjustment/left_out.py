"""Views that were left out: what they cost with given parameters, and how well a rotation alone explains them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.adjustment import left_out_kernel, search_kernel, star_kernels
from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import MAX_ITERATIONS, Loss, tolerances
from calib.adjustment.parameters import AdjustmentParameters
from calib.adjustment.state import packed

Array = NDArray[np.float64]


def costs_of_views(bundle: Bundle, candidates: Sequence[AdjustmentParameters], loss: Loss) -> Array:
    """Return the robust cost of the stars of each view with each of several parameters.

    The costs are those of `Loss.cost` (Huber, 1964; Holland and Welsch, 1977).

    loss: Cost of a weighted residual.
    Returns: (P, n) costs; infinite if a star cannot be projected.
    """
    obs = bundle.observations
    costs = np.empty((len(candidates), len(obs.slices)))
    left_out_kernel.costs_of_views(
        obs.target_rows,
        obs.point_rows,
        obs.factors,
        obs.bounds,
        candidates[0].camera.is_fisheye,
        np.array([packed(one) for one in candidates]),
        np.array([one.rotations for one in candidates]),
        np.array([one.offsets for one in candidates]),
        loss.number,
        float(loss.limit),
        costs,
    )
    return costs


def rms_alone(
    bundle: Bundle,
    others: Sequence[AdjustmentParameters],
    rotations: Array,
    centres: Array,
    by_hand: NDArray[np.bool_],
    tolerance: float,
) -> Array:
    """Return how well the camera of other views explains each view, of which only the rotation is adjusted.

    rotations: (n, 3, 3) rotations of the views, the start.
    centres: (n, 3) centres of the views, mm. They count for a view that was placed by hand; the others have
      the centre of the collimator.
    by_hand: (n,) bool, whether the centre is adjusted too.
    tolerance: As for `calib.adjustment.levenberg_marquardt.refine`.
    Returns: (n,) root mean square residual, px.
    """
    obs, loss = bundle.observations, Loss("l2")
    limits, held = tolerances(bundle, tolerance), np.empty(0, np.int64)
    turns, rms = rotations.copy(), np.empty(len(rotations))
    for i, (one, free) in enumerate(zip(others, by_hand.tolist(), strict=True)):
        own, state, turn = obs.bounds[i : i + 1], packed(one), turns[i : i + 1]
        offset = centres[i : i + 1] - one.collimator.centre if free else np.zeros((1, 3))
        # The kernels that adjusted all views are loaded already; a kernel of their own would take longer to load.
        search_kernel.search(
            obs.target_rows, obs.point_rows, obs.factors, own, one.camera.is_fisheye, held, state, turn,
            offset, free, loss.number, loss.limit, MAX_ITERATIONS, limits,
        )  # fmt: skip
        residuals = np.empty((2, len(obs.point_rows[0, obs.slices[i]])))
        star_kernels.residuals_px(
            obs.target_rows,
            obs.point_rows,
            own,
            state,
            one.camera.is_fisheye,
            turn,
            offset,
            residuals,
        )
        rms[i] = np.sqrt((residuals**2).sum() / residuals.shape[1])
    return rms
