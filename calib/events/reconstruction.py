"""Pictures of a still scene from the events of a moving camera, without flicker and without learned weights.

A pixel sums up its events, and forgets them with a time constant. This is the high-pass filter of Scheerlinck, Barnes
and Mahony (2018), "Continuous-time intensity estimation using event cameras", ACCV: the complementary filter without
frames. It is exact for every event; between events a pixel decays in closed form:

    L(t) = sum over events i with t_i <= t of  s_i c exp(-alpha (t - t_i)),   alpha = 2 pi cutoff

with s_i = +1 for ON and -1 for OFF, and c the contrast of an event. Behind a moving edge L is right, before it L still
holds what earlier edges left. Offline, the events after t are known too, and read backwards they give the same picture
from the other side (own extension):

    B(t) = - sum over events i with t_i > t of  s_i c exp(-alpha (t_i - t))

The two-sided picture is (L + B) / 2. It treats both sides of an edge alike, which the detectors of boards need: they
locate points by symmetry. Edges parallel to the motion cause no events, so they are in neither picture.

This module uses arrays only; it reads no file and knows no target.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from calib.arrays import Array, Array32, EventArrays
from calib.errors import InputMismatch, TooFewEvents, placed
from calib.events.accumulation import require_inside

DEFAULT_CUTOFF_HZ = 10.0
"""Cutoff frequency of the filter, Hz: pixels forget with a time constant of 16 ms."""
CUTOFF_RANGE_HZ = (0.01, 1000.0)
"""Time constants of 16 s to 0.16 ms: a longer one forgets nothing, a shorter one keeps nothing."""
FORGOTTEN = 0.01
"""Later events are used up to the time at which their weight falls to this."""
_LEAST_ACTIVE = 0.002  # Share of the pixels
_HOT_FACTOR, _HOT_OFFSET = 2.5, 8.0  # Times the median of the neighbours, and events beyond it
_MOST_PX = 10_000  # No sensor has more; a wrong number would ask for the memory


@dataclass(frozen=True)
class ReconstructedPicture:
    """A picture at one time."""

    at_us: float  # The time, us on the clock of the events
    # (H, W) float32, relative log intensity in units of the contrast of an ON event; brighter is larger. Pixels that
    # fired far more often than their surroundings are replaced by the median around.
    image: Array32
    active_share: float

    def require_motion(self) -> None:
        """Refuse a picture if fewer than 0.2 % of the pixels sent events near the time: the camera stood still."""
        if self.active_share < _LEAST_ACTIVE:
            raise TooFewEvents(
                f"Only {100 * self.active_share:.2f} % of the pixels sent events near {1e-6 * self.at_us:.3f} s.",
                where="reconstruction",
                remedy="Move the camera while it records, and take the picture at a time of motion.",
            )


class HighPassFilter:
    """The filter: sums of ON and of OFF events of every pixel, which decay exponentially; size in px, cutoff in Hz.

    The sums are kept apart, because the contrasts of ON and OFF events differ and are not known beforehand.
    """

    def __init__(self, size: tuple[int, int], cutoff_hz: float = DEFAULT_CUTOFF_HZ) -> None:
        low, high = CUTOFF_RANGE_HZ
        if not low <= cutoff_hz <= high:
            raise InputMismatch(
                f"The cutoff frequency is {cutoff_hz:g} Hz.",
                where="reconstruction",
                remedy=f"Give {low:g} to {high:g} Hz.",
            )
        self.size, self.alpha_us = size, 2e-6 * math.pi * cutoff_hz
        if not all(0 < side <= _MOST_PX for side in size):
            raise InputMismatch(f"The size of the sensor is {size}.", where="reconstruction")
        self._sums, self._at_us = np.zeros((2, size[1], size[0])), 0

    def add(self, events: EventArrays) -> None:
        """Add events: times, us, ascending and not before those added earlier; columns, rows, polarities."""
        with placed("reconstruction"):
            require_inside(*events[1:3], self.size)
        if len(events[0]):
            last_us = int(events[0][-1])
            self._sums = self.sums_at(last_us) + _weighted(events, last_us, self.alpha_us, self._sums.shape)
            self._at_us = last_us

    def sums_at(self, at_us: float) -> Array:
        """Return the decayed sums of OFF, then ON events, at a time, us, not before the last; new events count 1."""
        return np.asarray(self._sums * np.exp(-self.alpha_us * (at_us - self._at_us)))


def reconstruct(
    pieces: Iterable[EventArrays],
    size: tuple[int, int],
    at_us: Sequence[float],
    *,
    cutoff_hz: float = DEFAULT_CUTOFF_HZ,
) -> Iterator[ReconstructedPicture]:
    """Yield pictures at ascending times, us, from a stream of events. Only one piece of the stream is in memory.

    Scheerlinck, Barnes and Mahony (2018); the head of the module gives the equations. Where a time steps back, the
    event is taken at the latest time before it.
    """
    if any(later <= earlier for earlier, later in pairwise(at_us)):
        raise InputMismatch("The times of the pictures do not ascend.", where="reconstruction")
    past = HighPassFilter(size, cutoff_hz)
    reach_us = -math.log(FORGOTTEN) / past.alpha_us
    # Pictures whose later events are still to come: time, and sums of the events before and after it.
    waiting, begun = deque(at_us), deque[tuple[float, Array, Array]]()
    for events in _ascending(pieces):
        first = 0
        while waiting and waiting[0] < events[0][-1]:
            until = int(np.searchsorted(events[0], waiting[0], side="right"))
            past.add(_part(events, first, until))
            first, sums = until, past.sums_at(waiting[0])
            begun.append((waiting.popleft(), sums, np.zeros_like(sums)))
        past.add(_part(events, first, len(events[0])))
        for time_us, _, later in begun:
            after, last = np.searchsorted(events[0], [time_us, time_us + reach_us], side="right")
            later[:] += _weighted(_part(events, int(after), int(last)), time_us, past.alpha_us, later.shape)
        while begun and begun[0][0] + reach_us <= events[0][-1]:
            yield _picture(*begun.popleft())
    begun.extend((time_us, past.sums_at(time_us), np.zeros((2, *size[::-1]))) for time_us in waiting)
    for picture in begun:
        yield _picture(*picture)


def _picture(at_us: float, past: Array, later: Array) -> ReconstructedPicture:
    """Return a picture from the sums before and after its time: (L + B) / 2 of the head.

    Own estimate of the unknown contrasts: that of OFF events, over that of ON events, is the number of ON events over
    that of OFF events, because a scene that comes and goes leaves no brightness behind.
    """
    total = np.asarray((past + later).sum(axis=0), np.float32)
    active = float(np.mean(total > FORGOTTEN))
    off, on = past - later
    off_sum, on_sum = (past + later).sum(axis=(1, 2))
    off_weight = float(on_sum / off_sum) if off_sum > 0 else 1.0
    image = np.asarray(0.5 * (on - off_weight * off), np.float32)
    hot = total > _HOT_FACTOR * cv2.medianBlur(total, 5) + _HOT_OFFSET
    image[hot] = cv2.medianBlur(image, 5)[hot]
    return ReconstructedPicture(at_us, image, active)


def _ascending(pieces: Iterable[EventArrays]) -> Iterator[EventArrays]:
    """Yield the pieces that hold events, with times that never step back."""
    latest = -(2**62)
    for t, x, y, p in pieces:
        if len(t):
            ordered = np.maximum.accumulate(np.maximum(t, latest))
            latest = int(ordered[-1])
            yield ordered, x, y, p


def _part(events: EventArrays, first: int, last: int) -> EventArrays:
    t, x, y, p = events
    return t[first:last], x[first:last], y[first:last], p[first:last]


def _weighted(events: EventArrays, at_us: float, alpha_us: float, shape: tuple[int, ...]) -> Array:
    """Return (2, H, W) sums of OFF and of ON events with the weights that they have at an earlier or later time, us."""
    t, x, y, p = events
    place = ((p > 0).astype(np.int64) * shape[1] + y) * shape[2] + x
    weights = np.exp(-alpha_us * np.abs(t - at_us))
    return np.asarray(np.bincount(place, weights, minlength=math.prod(shape)).reshape(shape), np.float64)
