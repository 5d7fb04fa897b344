"""Events of an ideal sensor that reads every pixel at once: what the pixels detect, before any readout.

There is no arbiter, no link, no dead time, and no noise except the mismatch of thresholds. The reference of a pixel
changes by exactly its threshold at each event (the event generation model of Lichtsteiner et al. 2008 without
refractory time). All crossings on a branch of the light can therefore be found together; the stream is sorted
afterwards. It serves to compare readers and image methods with an ideal sensor, and to produce streams of hundreds of
millions of events a second. It uses the photoreceptor's tables, but not the sensor's loop.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulators.errors import SimulationMisuse
from simulators.pixels import photoreceptor as pr
from simulators.pixels.atlas_lookup import between, branch_crossing
from simulators.pixels.biases import PixelSettings
from simulators.pixels.drive import LN_BRIGHT, LN_DARK, SQUARE, T_DARK, Drive, make_drive
from simulators.pixels.fast_math import JIT, KERNEL
from simulators.world.world import LightState

EVENT: Final = np.dtype(
    {
        "names": ["x", "y", "p", "t"],
        "formats": ["<u2", "<u2", "<i2", "<i8"],
        "offsets": [0, 2, 4, 8],
        "itemsize": 16,
    }
)
"""An event as Metavision's readers return it, 16 bytes: x, y, p (1 = ON), t in us."""

WARM_UP: Final = 2
"""Periods that are simulated before time 0."""
AT_ONCE: Final = 12
"""Crossings of a pixel that are computed together: a little more than a branch has at a contrast of 10 : 1."""

# An event before it is sorted: polarity, x, y and the time within the slice, from the lowest bit up.
_X: Final = np.uint64(1)
_Y: Final = np.uint64(16)
_T: Final = np.uint64(32)
_COORDINATE: Final = np.uint64(0x7FFF)
_BUCKET: Final = 4
"""Events are first sorted into buckets of 16 us, which fit the caches, and each bucket then by the microsecond."""
_BUCKET_US: Final = 1 << _BUCKET


def ideal_slices(
    picture: NDArray[np.float32],
    light: LightState,
    duration_us: float,
    *,
    phase: float = 0.0,
    settings: PixelSettings | None = None,
    thresholds: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
) -> Iterator[NDArray[np.void]]:
    """Yield the events from time 0 to ``duration_us``, sorted by time, in slices of about a period of the light.

    Each array is a view of one buffer, which the next slice overwrites: copy what you keep.

    picture: (height, width) float32, share of the light's drive that reaches each pixel.
    duration_us: End of the stream, exclusive.
    phase: Phase of the light at time 0, in periods.
    settings: Thresholds and time constant; the dead time is not used.
    thresholds: ON and OFF thresholds of each pixel, two (height, width) arrays in units of log intensity, as
      ``Sensor.thresholds`` has them; None: those of the settings for all pixels.
    Yields: Events of a slice, a structured array.
    Raises SimulationMisuse: If the light is square or constant.
    """
    chosen = settings if settings is not None else PixelSettings()
    drive = make_drive(light, -phase * light.period_us, chosen)
    if drive.kind == SQUARE:
        raise SimulationMisuse(
            "The ideal readout needs a light that rises and falls smoothly.",
            remedy="Use a sine, or a Sensor with Link.ideal().",
        )
    height, width = picture.shape
    levels = _levels(drive, np.ascontiguousarray(picture, np.float32))
    on, off = thresholds if thresholds is not None else (chosen.threshold_on, chosen.threshold_off)
    steps = np.empty((2, height, width), np.float32)
    steps[0], steps[1] = on, off
    reference = _between(drive.turns[LN_DARK], levels)
    period = light.period_us
    first_dark = float(np.min(drive.turns[T_DARK]))
    most = _most_events(drive, steps)
    found, ordered = np.empty(0, np.uint64), np.empty(0, np.uint64)
    counts = np.empty(3 * math.ceil(period / _BUCKET_US) + _BUCKET_US, np.int32)
    buffer = np.empty(0, EVENT)
    waiting = 0
    cycle = math.floor(-drive.start_us / period) - WARM_UP - 2
    while True:
        start_us = drive.start_us + cycle * period
        begin = math.floor(start_us + first_dark)
        end = math.floor(start_us + period + first_dark)
        if begin >= duration_us:
            return
        if found.size < waiting + most:
            found = np.concatenate([found[:waiting], np.empty(most, np.uint64)])
            ordered = np.empty(found.size, np.uint64)
        counts[:] = 0
        _count(found, waiting, counts)
        n = _cycle_events(drive, levels, steps, reference, start_us, begin, found, waiting, counts)
        if buffer.size < n:
            buffer = np.empty(n + n // 8, EVENT)
        waiting = _sort(found, n, counts, begin, end, ordered, buffer.view(np.uint64).reshape(-1, 2))
        whole = n - waiting
        cycle += 1
        if end > 0:
            first, last = np.searchsorted(buffer["t"][:whole], [0, math.ceil(duration_us)])
            yield buffer[first:last]


def ideal_events(
    picture: NDArray[np.float32], light: LightState, duration_us: float, **options: Any
) -> NDArray[np.void]:
    """Return all events of ``ideal_slices`` in one array.

    picture: (height, width) float32, share of the light's drive that reaches each pixel.
    duration_us: End of the stream, exclusive.
    options: Further arguments of ``ideal_slices``.
    Returns: Events sorted by time, a structured array.
    """
    slices = [events.copy() for events in ideal_slices(picture, light, duration_us, **options)]
    events = np.empty(sum(map(len, slices)), EVENT)
    np.concatenate(slices, out=events)
    return events


def _between(table: NDArray[np.float32], levels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Interpolate a table at the pixels' levels."""
    return np.interp(levels, np.arange(table.size), table).astype(np.float32)


def _most_events(drive: Drive, steps: NDArray[np.float32]) -> int:
    """Return an upper limit of the events in a cycle."""
    span = float(np.max(drive.turns[LN_DARK] - drive.turns[LN_BRIGHT]))
    return int((span / steps + 1.0).sum()) + AT_ONCE


@njit(cache=True, nogil=True)
def _levels(drive: Drive, picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the level of each pixel on the atlas."""
    levels = np.empty(picture.shape, np.float32)
    for r in range(picture.shape[0]):
        for c in range(picture.shape[1]):
            levels[r, c] = pr.stored_light(drive, picture[r, c])
    return levels


@njit(forceinline=True, **KERNEL)
def _branch_times(
    drive: Drive, level: Any, off: bool, first: Any, step: Any, offset: float, times: NDArray[np.int32]
) -> None:
    """Compute when a pixel crosses AT_ONCE targets, a step apart; whole microseconds of the phase plus ``offset``."""
    for k in range(AT_ONCE):
        times[k] = np.int32(branch_crossing(drive, level, first + np.float32(k) * step, off) + offset)


@njit(**JIT)
def _cycle_events(
    d: Drive,
    levels: NDArray[np.float32],
    steps: NDArray[np.float32],
    reference: NDArray[np.float32],
    start_us: float,
    begin: int,
    found: NDArray[np.uint64],
    n: int,
    counts: NDArray[np.int32],
) -> int:
    """Add the events of one cycle of all pixels, from dark to bright and back; return the number of events so far."""
    height, width = levels.shape
    offset = start_us - begin
    times = counts[counts.size - AT_ONCE :]
    for r in range(height):
        for c in range(width):
            level = levels[r, c]
            if level < np.float32(0.0):
                continue
            j = np.uint32(np.int32(level))
            f = level - np.float32(j)
            for off in range(2):
                turn = between(d.turns[LN_DARK if off else LN_BRIGHT], j, f)
                ref = reference[r, c]
                step = steps[off, r, c]
                here = np.int64((turn - ref if off else ref - turn) / step)
                if here <= 0:
                    continue
                signed = step if off else -step
                code = np.uint64(1 - off) | (np.uint64(c) << _X) | (np.uint64(r) << _Y)
                done = 0
                while done < here:
                    _branch_times(
                        d, level, off == 1, ref + np.float32(done + 1) * signed, signed, offset, times
                    )
                    room = found[n : n + AT_ONCE]
                    for k in range(AT_ONCE):
                        room[k] = code | (np.uint64(np.uint32(times[k])) << _T)
                    here_now = min(AT_ONCE, int(here - done))
                    for k in range(here_now):
                        counts[np.uint32(times[k]) >> np.uint32(_BUCKET)] += 1
                    n += here_now
                    done += AT_ONCE
                reference[r, c] = ref + np.float32(here) * signed
    times[:] = 0
    return n


@njit(**JIT)
def _count(found: NDArray[np.uint64], n: int, counts: NDArray[np.int32]) -> None:
    """Count events by bucket."""
    for i in range(n):
        counts[found[i] >> (_T + np.uint64(_BUCKET))] += 1


@njit(**JIT)
def _sort(
    found: NDArray[np.uint64],
    n: int,
    counts: NDArray[np.int32],
    begin: int,
    end: int,
    ordered: NDArray[np.uint64],
    events: NDArray[np.uint64],
) -> int:
    """Sort events before ``end`` by time; move the others to the start of ``found`` and return their number.

    Two counting sorts: of all events into buckets, and of each bucket. ``counts`` is used up, ``ordered`` is scratch.
    ``events`` is (n, 2) words: x, y, p in the first, t in the second.
    """
    buckets = counts.size - _BUCKET_US
    place = 0
    for b in range(buckets):
        here = counts[b]
        counts[b] = place
        place += here
    for i in range(n):
        to: Any = np.uint32(found[i] >> (_T + np.uint64(_BUCKET)))
        k = np.uint32(counts[to])
        ordered[k] = found[i]
        counts[to] = np.int32(k) + 1
    first: Any = 0
    place = waiting = 0
    for b in range(buckets):
        last: Any = np.int64(counts[b])
        if last > first:
            place, more = _sort_bucket(
                ordered[first:last],
                counts[buckets:],
                b << _BUCKET,
                begin,
                end,
                place,
                found[waiting:],
                events,
            )
            waiting += more
        first = last
    return waiting


@njit(**JIT)
def _sort_bucket(
    bucket: NDArray[np.uint64],
    counts: NDArray[np.int32],
    start: int,
    begin: int,
    end: int,
    place: int,
    rest: NDArray[np.uint64],
    events: NDArray[np.uint64],
) -> tuple[int, int]:
    """Sort a bucket's events into ``events`` from ``place`` on, and those not before ``end`` into ``rest``.

    Return the next place in either.
    """
    length = end - begin
    for k in range(_BUCKET_US):
        counts[k] = 0
    for i in range(bucket.size):
        counts[np.uint32(bucket[i] >> _T) & np.uint32(_BUCKET_US - 1)] += 1
    for k in range(min(_BUCKET_US, length - start)):
        here = counts[k]
        counts[k] = place
        place += here
    waiting = 0
    for i in range(bucket.size):
        one = bucket[i]
        t = np.int64(one >> _T)
        if t >= length:
            rest[waiting] = one - (np.uint64(length) << _T)
            waiting += 1
            continue
        j = np.uint32(t) & np.uint32(_BUCKET_US - 1)
        at: Any = np.uint32(counts[j])
        counts[j] = np.int32(at) + 1
        x, y = (one >> _X) & _COORDINATE, (one >> _Y) & _COORDINATE
        events[at, 0] = x | (y << np.uint64(16)) | ((one & np.uint64(1)) << np.uint64(32))
        events[at, 1] = np.uint64(begin + t)
    return place, waiting
