"""The expanded uncertainty of a quantity whose distribution is a mixture of Gaussians: by the means of its tails.

The interval that holds 95.45 % steps where a rare component enters it, and twice the standard deviation follows the
rarest and widest of all. The mean of both tails (Rockafellar and Uryasev, 2002) is smooth in weights and places; it is
taken over 9 %, where it is 2 u for a Gaussian times the constant below.
"""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from calib.arrays import Array

#: Share of both tails together.
_TAILS = 0.09
_NORMAL = NormalDist()
#: Mean distance of the tails of a Gaussian, over its half U: 2 sigma.
_GAUSSIAN = _NORMAL.pdf(_NORMAL.inv_cdf(0.5 * _TAILS)) / (0.5 * _TAILS) / 2.0
#: Halvings of a bracket, until it is 1e-6 of the widest.
_HALVINGS = 24
_FARTHEST = 12.0


def expanded(weights: Array, means: Array, sigmas: Array) -> float:
    """Return U of a mixture of (K,) Gaussians whose weights sum to 1."""
    middle = float(weights @ means)
    sigmas = np.maximum(sigmas, 1e-300)
    tails = [_tail(weights, side * (means - middle), sigmas) for side in (1.0, -1.0)]
    return float(0.5 * sum(tails) / _GAUSSIAN)


def _tail(weights: Array, means: Array, sigmas: Array) -> float:
    """Return the mean of what lies beyond the upper quantile."""
    from scipy.special import ndtr  # here: it is slow to import

    low, high = float((means - _FARTHEST * sigmas).min()), float((means + _FARTHEST * sigmas).max())
    for _ in range(_HALVINGS):
        at = 0.5 * (low + high)
        beyond = ndtr((means - at) / sigmas)
        low, high = (at, high) if float(weights @ beyond) > 0.5 * _TAILS else (low, at)
    density = np.exp(-0.5 * ((at - means) / sigmas) ** 2) / np.sqrt(2.0 * np.pi)
    return float(weights @ (means * beyond + sigmas * density)) / (0.5 * _TAILS)
