"""Prior knowledge of shared parameters, as a Gaussian that the adjustment adds to what the stars say.

Passports and the expected sizes of aberrations come as priors. This module holds the data only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prior:
    """What is known of shared parameters beforehand: a Gaussian.

    Attributes
    ----------
    names
        The parameters, each of them free in the bundle.
    mean
        (K,) expected values.
    information
        (K, K) inverse covariance.
    """

    names: tuple[str, ...]
    mean: Array
    information: Array
