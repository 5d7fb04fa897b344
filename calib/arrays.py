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


class ReadOnlyArrays:
    """A base of dataclasses: their arrays, also those in lists, are views that cannot be written to."""

    def __post_init__(self) -> None:
        for name, given in list(vars(self).items()):
            kept = [_read_only(part) for part in given] if isinstance(given, list) else _read_only(given)
            object.__setattr__(self, name, kept)


def _read_only(given: Any) -> Any:
    """Return a view of an array that cannot be written to; anything else as it is."""
    if not isinstance(given, np.ndarray):
        return given
    view = given.view()
    view.setflags(write=False)
    return view


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
