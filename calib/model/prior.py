"""Prior knowledge of shared parameters: a Gaussian that the adjustment combines with the stars.

Passports and the expected sizes of aberrations are priors. This module holds the data only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prior:
    """A Gaussian prior of shared parameters.

    Attributes
    ----------
    names
        The K parameters; each of them is free in the bundle.
    mean
        (K,) float64 expected values, each in the unit of its parameter.
    information
        (K, K) float64 inverse covariance.
    """

    names: tuple[str, ...]
    mean: Array
    information: Array
