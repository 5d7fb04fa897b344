"""How the errors of a calibration's rotations follow from those of what all its views share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RotationErrors:
    """A linear form at the posterior's mean: the error of each rotation vector, on the camera's side."""

    names: tuple[str, ...]  # The S shared unknowns
    means: Array  # (S,)
    covariance: Array  # (S, S)
    prior: Array  # (S, S) information of what was known before the views
    prior_pull: Array  # (S,) that information times (what was known - means)
    by_shared: Array  # (3 m, S) rad for a unit of each
    own: Array  # (3 m, 3 m) covariance of what each view adds, rad^2
