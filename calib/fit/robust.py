"""Adjustment with a robust loss, whose limit comes from the residuals."""

from __future__ import annotations

from dataclasses import replace

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Refinement, refine
from calib.adjustment.loss import Loss, lengths
from calib.adjustment.parameters import AdjustmentParameters
from calib.calibration import CalibrationOptions
from calib.model.median import median

#: Limit of the robust loss in robust standard deviations per axis, and the number of times it is estimated again.
_LIMIT_SIGMAS = 2.5
_LIMIT_ROUNDS = 3
#: Median length of a residual vector over its standard deviation per axis (Rayleigh distribution): sqrt(2 ln 2).
_RAYLEIGH_MEDIAN = 1.1774100225154747


def refine_robustly(
    bundle: Bundle, start: AdjustmentParameters, options: CalibrationOptions
) -> tuple[Refinement, Loss]:
    """Adjust with the chosen loss; its limit comes from the residuals.

    The spread of the residuals is their robust standard deviation per axis at the least squares optimum, and then at
    each robust optimum. The result therefore depends on the data only, not on the start. Own procedure: sigma is the
    median length of the residuals over 1.1774 = sqrt(2 ln 2), the median length of a two-dimensional vector of standard
    normal components.

    options: Loss, its limit if given, and the largest number of steps.
    Returns: The optimum, and the loss with its final limit.
    """
    given = None if options.huber_px is None else options.huber_px * bundle.observations.sigmas_per_px
    loss = Loss("l2") if given is None else Loss(options.loss, given)
    refined = refine(bundle, start, loss, options.max_iterations)
    iterations = refined.iterations
    robust = options.loss != "l2" and given is None
    for _ in range(_LIMIT_ROUNDS if robust else 0):
        residuals = bundle.weighted_residuals(refined.parameters)
        spread = median(lengths(residuals)) / _RAYLEIGH_MEDIAN
        if not spread > 0:
            break
        loss = Loss(options.loss, _LIMIT_SIGMAS * spread)
        refined = refine(bundle, refined.parameters, loss, options.max_iterations)
        iterations += refined.iterations
    return replace(refined, iterations=iterations), loss
