"""Repeated poses: views of one pose are one cluster in every statistic.

They share the errors of the collimator, of the pixel grid and of the sensor's fixed pattern, so that they bring less
than as many independent views. How much less is estimated from the residuals of the stars that they share.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.normal_equations import ViewScores
from calib.adjustment.poses import members

Array = NDArray[np.float64]


def views_of_poses(bundle: Bundle) -> list[list[int]]:
    """Return the views of each pose.

    bundle: Bundle with `Bundle.poses`; without, each view is a pose of its own.
    """
    return members(bundle.poses) if bundle.poses else [[i] for i in range(len(bundle.observations.slices))]


def pose_scores(bundle: Bundle, scores: ViewScores) -> tuple[Array, Array]:
    """Return the information and the score of each pose: the sums over its views.

    scores: Information and scores of its views.
    Returns: (P, G, G) information and (P, G) scores of P poses.
    """
    poses = views_of_poses(bundle)
    if len(poses) == len(scores.score):
        return scores.information, scores.score
    return (
        np.array([scores.information[views].sum(axis=0) for views in poses]),
        np.array([scores.score[views].sum(axis=0) for views in poses]),
    )


def noise_growth(bundle: Bundle, residuals: Array) -> Array:
    """Return how many times larger the noise of a pose's score is than that of independent views.

    With m views whose stars' errors have the intraclass correlation q (Fisher, 1925), the variance of a sum over the
    views is 1 + (m - 1) q times that of independent ones. q is estimated over all poses from the stars that two views
    of a pose share: the mean product of their residuals over the mean square.

    residuals: (N, 2) weighted residuals at the optimum.
    Returns: (P,) growth of each pose, at least 1.
    """
    poses = views_of_poses(bundle)
    products, squares = 0.0, 0.0
    for views in poses:
        for k, i in enumerate(views):
            for j in views[k + 1 :]:
                a, b = _shared(bundle, residuals, i, j)
                products += float((a * b).sum())
                squares += 0.5 * float((a**2).sum() + (b**2).sum())
    correlation = min(max(products / squares, 0.0), 1.0) if squares > 0 else 0.0
    return np.array([1.0 + (len(views) - 1) * correlation for views in poses])


def _shared(bundle: Bundle, residuals: Array, i: int, j: int) -> tuple[Array, Array]:
    """Return the residuals of the stars that two views share, (M, 2) of each."""
    obs = bundle.observations
    rows = [obs.slices[k] for k in (i, j)]
    keys = [[tuple(star) for star in obs.target[r, :2].round(6).tolist()] for r in rows]
    places = {star: at for at, star in enumerate(keys[1])}
    pairs = [(at, places[star]) for at, star in enumerate(keys[0]) if star in places]
    at, other = np.array(pairs, np.int64).reshape(-1, 2).T
    return residuals[rows[0]][at], residuals[rows[1]][other]
