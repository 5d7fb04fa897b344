"""A whole Monte Carlo study in this process, and what only tests ask of one; and the jackknife as a second opinion."""

import numpy as np
from monte_carlo import calibrate_once, study_of

from calib.adjustment.parameters import views_of_poses
from calib.uncertainty.covariance import without_pose


def run_monte_carlo(bench, poses_deg, options, runs, seed, **noise):
    """The study of so many runs, one after another; ``noise`` is ``drift_mm`` and ``outliers``."""
    runs = (calibrate_once(bench, poses_deg, options, seed, run, **noise) for run in range(runs))
    return study_of(bench, list(runs))


def z_of_all(study):
    """Root mean square of all errors over their stated sigmas."""
    return float(np.sqrt(np.mean(np.square(list(study.z_rms.values())))))


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
