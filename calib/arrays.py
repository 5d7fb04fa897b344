"""Types of arrays by their numbers; a docstring or comment beside each use gives shape and unit. Rows, and a median."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
"""Numbers from 0 to 255, such as pictures, masks and polarities."""
AnyArray = NDArray[np.generic]
EventArrays = tuple[Ints, NDArray[np.uint16], NDArray[np.uint16], Bytes]
"""(N,) times, us, ascending; columns; rows; polarities, 1 = ON."""

#: Median length of a two-dimensional vector of standard normal components: sqrt(2 ln 2) (Rayleigh distribution).
RAYLEIGH_MEDIAN = 1.1774100225154747


Parts = TypeVar("Parts", bound=NamedTuple)


def selected(parts: Parts, mask: Any) -> Parts:
    """Return a tuple of arrays with some of their rows, by an (N,) mask, indices or a slice, in the same order."""
    return parts._make(part[mask] for part in parts)


def rms_length(vectors: Array) -> float:
    """Return the root mean square length of (..., K) vectors."""
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))


def product_sigma(first: tuple[float, float], other: tuple[float, float]) -> float:
    """Return the 1-sigma of the product of two independent quantities, each a value and its 1-sigma (Goodman, 1960)."""
    (a, a_sigma), (b, b_sigma) = first, other
    return float(np.linalg.norm([a * b_sigma, a_sigma * b, a_sigma * b_sigma]))


def median(values: Array) -> float:
    """Return the median, NaN with a NaN or no number (`numpy.median` warns without one).

    >>> median(np.array([5.0, 1.0, 2.0])), median(np.array([5.0, 1.0, 2.0, 3.0]))
    (2.0, 2.5)
    """
    return float(np.median(values)) if len(values) else math.nan
