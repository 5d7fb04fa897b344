"""Put the bytes of events into planes, as HDF5's filter shuffle does: all lowest bytes of a column, then all second.

The upper bytes of the clock stay the same for a whole chunk, so planes compress better than numbers, and faster.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.camera.event_arrays import Events

PLANES: Final = 13
"""Number of bytes of an event: 8 for t, 2 for x, 2 for y, 1 for p."""


def plane_chunks(pieces: Iterator[Events], size: int) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield chunks of ``size`` events as planes, (13, size) uint8, each with its number of events.

    The last chunk is filled up with zeros.

    >>> events = Events(np.array([258]), np.array([3], "u2"), np.array([5], "u2"), np.array([1], "u1"))
    >>> [(n, planes)] = plane_chunks(iter([events]), 2)
    >>> n, planes[:, 0].tolist()
    (1, [2, 1, 0, 0, 0, 0, 0, 0, 3, 0, 5, 0, 1])
    """
    planes, filled = np.zeros((PLANES, size), np.uint8), 0
    for events in pieces:
        begin = 0
        while begin < len(events.t):
            end = begin + min(size - filled, len(events.t) - begin)
            _put(*events.part(begin, end), planes, filled)
            filled += end - begin
            begin = end
            if filled == size:
                yield size, planes
                planes, filled = np.zeros((PLANES, size), np.uint8), 0
    if filled:
        yield filled, planes


@njit(cache=True, nogil=True)
def _put(t: Any, x: Any, y: Any, p: Any, planes: Any, at: int) -> None:
    """Write the bytes of events from a place on. Each plane is one piece of memory, so that LLVM uses vectors."""
    _put_column(t, planes[:8], at)
    _put_column(x, planes[8:10], at)
    _put_column(y, planes[10:12], at)
    planes[12, at : at + len(p)] = p


@njit(cache=True, nogil=True)
def _put_column(values: Any, planes: Any, at: int) -> None:
    first: Any = np.int64(values[0])
    differing: Any = 0  # the bits that are not the same in all values
    for i in range(len(values)):
        differing |= values[i] ^ first
    for k in range(len(planes)):
        plane = planes[k, at : at + len(values)]
        if differing >> (8 * k) & 0xFF:
            for i in range(len(values)):
                plane[i] = values[i] >> (8 * k) & 0xFF
        else:
            plane[:] = first >> (8 * k) & 0xFF
