"""How far the camera's centre wanders from view to view, under a model that says it does not.

Knows a spherical optimum, and how to let each view's centre go. On the published recordings the wander follows the
camera's place in the pupil and is some tenths of a per cent of r; two hundredths of one per cent are enough to bias a
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

#: Root mean square wander, as a share of r, from which on the spherical model is biased.
WORRYING = 2e-4
#: Centres are let go this far, as a share of r: enough to show any wander, and no view lost in its own noise.
_LEASH = 1e-2
_ROUNDS = 2


def centre_drift(bundle: Bundle, parameters: AdjustmentParameters, loss: Loss) -> Array:
    """Return (3,) root mean square wander of the views' centres along x, y and z, as shares of r.

    Parameters
    ----------
    bundle, state, loss
        A model whose views share one centre, and its optimum.
    """
    r = parameters.collimator.r
    freed = replace(bundle, free_centres=True, drift_mm=_LEASH * r)
    for _ in range(_ROUNDS):
        spread = float((freed.weighted_residuals(parameters) ** 2).mean())
        freed = replace(freed, noise_variance=spread)
        parameters = refine(freed, parameters, loss, tolerance=1e-8).parameters
    return np.asarray(np.sqrt((parameters.offsets**2).mean(axis=0)) / r)
