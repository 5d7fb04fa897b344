"""How often each pixel of a recording blinks: the period between the starts of its ON bursts.

The first ON event after an OFF event starts a period.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calib.arrays import Array, Array32, Bytes, Ints

#: Starts that a pixel must have, so that its period has three intervals.
LEAST_STARTS = 4
#: An interval may differ from a whole number of periods by this share of a period.
_TOLERANCE = 0.2
#: This share of the intervals must be one period.
_REGULAR_SHARE = 0.6


def blink_frequencies(
    t_us: Ints, x: NDArray[np.uint16], y: NDArray[np.uint16], p: Bytes, size: tuple[int, int]
) -> Array:
    """Return the (H, W) frequency of each pixel, Hz; nan for one that does not blink regularly.

    From (N,) events in the order of their times, us; polarity 1 is ON. Own procedure: the median interval numbers the
    starts, so that a missed or an additional one does not matter; the least-squares line through the numbered starts
    gives the period.
    """
    width, height = size
    starts = np.flatnonzero(_starts(x, y, p, width, height))
    pixel = y[starts].astype(np.int64) * width + x[starts]
    counts = np.bincount(pixel, minlength=width * height)
    times = t_us[starts[np.argsort(pixel, kind="stable")]].astype(np.float64)
    return np.asarray(_frequencies(times, np.cumsum(counts), counts).reshape(height, width))


@njit(cache=True)
def _starts(x: Any, y: Any, p: Any, width: int, height: int) -> Any:
    """Return which events, (N,), are ON events of a pixel whose event before was OFF, or that are its first event."""
    last = np.full((height, width), -1, np.int8)
    starts = np.empty(len(x), np.bool_)
    for i in range(len(x)):
        starts[i] = p[i] == 1 and last[y[i], x[i]] != 1
        last[y[i], x[i]] = p[i]
    return starts


@njit(cache=True)
def _frequencies(times: Any, ends: Any, counts: Any) -> Any:
    """Return the frequency of each pixel, Hz, nan where its starts are too few or irregular."""
    found = np.full(len(ends), np.nan)
    for pixel in range(len(ends)):
        count = counts[pixel]
        if count < LEAST_STARTS:
            continue
        own = times[ends[pixel] - count : ends[pixel]]
        period = np.median(np.diff(own))
        if period <= 0:
            continue
        regular, number, used = 0, 0.0, 1
        sum_n, sum_t, sum_nn, sum_nt = 0.0, 0.0, 0.0, 0.0
        at = own[0]
        for i in range(1, count):
            steps = (own[i] - at) / period
            whole = np.round(steps)
            if whole < 1.0 or abs(steps - whole) > _TOLERANCE:
                continue  # an additional start, of noise
            if whole == 1.0:
                regular += 1
            number += whole
            at = own[i]
            delta = own[i] - own[0]
            used += 1
            sum_n += number
            sum_t += delta
            sum_nn += number * number
            sum_nt += number * delta
        if used < LEAST_STARTS or regular < _REGULAR_SHARE * (count - 1):
            continue
        spread = used * sum_nn - sum_n * sum_n
        slope = (used * sum_nt - sum_n * sum_t) / spread
        if slope > 0:
            found[pixel] = 1e6 / slope
    return found


def lock_in(
    t_us: Ints,
    x: NDArray[np.uint16],
    y: NDArray[np.uint16],
    p: Bytes,
    dot_of_pixel: Ints,
    frequencies_hz: Array,
) -> Array32:
    """Return (H, W) how strongly each pixel blinks at the frequency, Hz, of its dot: about its events a period.

    Length of the sum of polarity times exp(-2 pi i f t), divided by the number of periods in the recording: lock-in
    detection (Scofield, 1994, American Journal of Physics 62, 129). Noise adds with random phases, so it nearly
    vanishes. ``dot_of_pixel`` is (H, W) int, -1 for no dot; times are in us, polarity 1 is ON.
    """
    dots = dot_of_pixel.ravel()
    pixel = y.astype(np.int64) * dot_of_pixel.shape[1] + x
    angle = 2.0 * np.pi * frequencies_hz[dots[pixel]] * 1e-6 * t_us
    sign = np.where(p == 1, 1.0, -1.0)
    real, imaginary = (
        np.bincount(pixel, sign * wave, minlength=dots.size) for wave in (np.cos(angle), np.sin(angle))
    )
    span_s = 1e-6 * (t_us[-1] - t_us[0]) if len(x) else 1.0
    image = np.hypot(real, imaginary) / np.maximum(span_s * frequencies_hz[dots], 1.0)
    return np.where(dots >= 0, image, 0.0).astype(np.float32).reshape(dot_of_pixel.shape)
