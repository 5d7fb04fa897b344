"""Diagnosis of the spherical model: how far the camera's centre moves from view to view.

The spherical model assumes one centre for all views. On the published recordings the centre follows the camera's
position in the pupil and moves by some tenths of a per cent of r. Two hundredths of a per cent are enough to bias a
focal length.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.levenberg_marquardt import Loss, refine
from calib.adjustment.parameters import AdjustmentParameters

Array = NDArray[np.float64]

#: Root mean square movement of the centre, as a share of r, from which the spherical model is biased.
BIASING_DRIFT = 2e-4
#: Prior 1-sigma of a centre, as a share of r: wide enough for any real movement, and it limits that of noisy views.
_DRIFT_SIGMA = 1e-2
_ROUNDS = 2
#: The movement is shown to hundredths of a per cent of r; this tolerance leaves it right to a hundredth of itself.
_TOLERANCE = 1e-6


def centre_drift(bundle: Bundle, parameters: AdjustmentParameters, loss: Loss) -> Array:
    """Return the root mean square movement of the views' centres along x, y and z.

    The centres are freed with a weak prior, and the adjustment is repeated from the given optimum. Own statistic: the
    root of the mean over the views of offset^2, divided by r.

    bundle: Bundle of a model whose views share one centre.
    Returns: (3,) root mean square movement as shares of r.
    """
    r = parameters.collimator.r
    freed = replace(bundle, free_centres=True, drift_mm=_DRIFT_SIGMA * r)
    for _ in range(_ROUNDS):
        spread = float((freed.weighted_residuals(parameters) ** 2).mean())
        freed = replace(freed, noise_variance=spread)
        parameters = refine(freed, parameters, loss, tolerance=_TOLERANCE).parameters
    return np.asarray(np.sqrt((parameters.offsets**2).mean(axis=0)) / r)
