"""Put the bytes of events into planes, as HDF5's filter shuffle does: all lowest bytes of a column, then all second.

The upper bytes of the clock stay the same for a whole chunk, so planes compress better than numbers, and faster.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.camera.event_arrays import Events

PLANES: Final = 13
"""Number of bytes of an event: 8 for t, 2 for x, 2 for y, 1 for p."""


def planes_of(events: Events, size: int) -> NDArray[np.uint8]:
    """Return (13, size) planes of at most ``size`` events; what is left is filled up with zeros.

    >>> events = Events(np.array([258]), np.array([3], "u2"), np.array([5], "u2"), np.array([1], "u1"))
    >>> planes_of(events, 2)[:, 0].tolist()
    [2, 1, 0, 0, 0, 0, 0, 0, 3, 0, 5, 0, 1]
    """
    planes = np.zeros((PLANES, size), np.uint8)
    if len(events.t):
        _put(*events, planes)
    return planes


@njit(cache=True, nogil=True)
def _put(t: Any, x: Any, y: Any, p: Any, planes: Any) -> None:
    """Write the bytes of events. Each plane is one piece of memory, so that LLVM uses vectors."""
    _put_column(t, planes[:8])
    _put_column(x, planes[8:10])
    _put_column(y, planes[10:12])
    planes[12, : len(p)] = p


@njit(cache=True, nogil=True)
def _put_column(values: Any, planes: Any) -> None:
    first: Any = np.int64(values[0])
    differing: Any = 0  # the bits that are not the same in all values
    for i in range(len(values)):
        differing |= values[i] ^ first
    for k in range(len(planes)):
        plane = planes[k, : len(values)]
        if differing >> (8 * k) & 0xFF:
            for i in range(len(values)):
                plane[i] = values[i] >> (8 * k) & 0xFF
        else:
            plane[:] = first >> (8 * k) & 0xFF
