"""The interval of a mixture of normal distributions that covers 95.45 %, by SciPy."""

import numpy as np
from scipy import optimize, stats


def half_width(means, sigmas, weights, middle):
    """About ``middle``."""

    def missing(half):
        z = [(half + sign * (np.asarray(means) - middle)) / sigmas for sign in (1.0, -1.0)]
        return weights @ (stats.norm.cdf(z[0]) + stats.norm.cdf(z[1]) - 1.0) - 0.9545

    return optimize.brentq(missing, 1e-3, 1e4)
