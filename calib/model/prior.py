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
    """A Gaussian prior of shared parameters."""

    names: tuple[str, ...]
    mean: Array  # (K,) float64 expected values, each in the unit of its parameter
    information: Array  # (K, K) float64 inverse covariance


def joined(*priors: Prior | None) -> Prior | None:
    """Return one prior of the parameters of several independent ones.

    priors: Priors without common parameters; None for none.
    Returns: None if there is no prior.
    """
    known = [prior for prior in priors if prior is not None]
    if not known:
        return None
    names = tuple(name for prior in known for name in prior.names)
    information = np.zeros((len(names), len(names)))
    at = 0
    for prior in known:
        rows = slice(at, at + len(prior.names))
        information[rows, rows] = prior.information
        at += len(prior.names)
    return Prior(names, np.concatenate([prior.mean for prior in known]), information)
