"""The jackknife: a second opinion on stated covariances."""

import numpy as np

from calib.adjustment.parameters import views_of_poses
from calib.uncertainty.covariance import without_pose


def jackknife(fitted):
    """(G, G) covariance from the estimates without each of P poses: (P - 1) / P sum (v - mean)(v - mean)^T (Efron, 1982)."""
    bundle = fitted.bundle
    values = np.array(
        [
            without_pose(bundle, views, fitted.parameters, fitted.loss).values(bundle.names)
            for views in views_of_poses(fitted.parameters.rotations)
        ]
    )
    off = values - values.mean(axis=0)
    return (len(off) - 1) / len(off) * off.T @ off
