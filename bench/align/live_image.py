"""The live image: from a slice to grey values in which stars are searched, and to a picture for the screen.

An event camera's slice becomes the event image of whole flicker periods; without a flicker, the number of events of
each pixel is shown. A frame camera's slice becomes the mean of its frames. The module reads the slice's file and
nothing else.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.align.live_counts import count_slice
from bench.align.live_setting import LiveSetting
from bench.align.signal_figures import SignalFigures, measure_signal, shows_flicker, signal_of_counts
from calib.errors import CalibrationError
from calib.events.event_image import EventImages, make_images
from calib.events.quick_image import make_quick_image
from drivers.camera.event_arrays import Events
from drivers.camera.frames import read_frames
from drivers.camera.raw_file import RawFile

GAMMA: Final = 0.6
"""Exponent of the tone map: a pattern at a tenth of the brightest light is shown at a quarter."""
_CLIPPED: Final = 0.004
_LEAST_FIRED: Final = 0.3
_LEAST_GREY: Final = 0.02
_HOT_EVENTS: Final = 6


class LiveImage(NamedTuple):
    """Grey values of a slice, and what belongs to them."""

    values: NDArray[np.float32]  # (H, W) float32, brighter where the target is brighter
    # Kind of image: ``fired-per-edge``, ``events-per-edge``, ``lock-in``, ``count`` or ``picture``.
    kind: str
    least: float  # Brightness of white print below which nothing counts as light, in the unit of the values
    signal: SignalFigures | None  # The signal; None for a frame camera
    hot_pixels: int | None  # Number of hot pixels; None if unknown
    saturation: float | None  # Share of the pixels at the highest grey value; None for an event camera


def read_image(path: Path, setting: LiveSetting, *, compare: bool = True) -> LiveImage:
    """Read a slice and make its image.

    path: RAW file, or file of frames.
    compare: Whether the frequency is measured by the events also if the sync edges give it.
    Returns: Also of a slice without any light.
    Raises drivers.errors.RecordingFileError: If the file cannot be read.
    """
    if setting.camera == "frame":
        return _read_frames(path)
    return _read_events(path, setting.frequency_hz, compare=compare)


def show(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the picture for the screen: stretched between its quantiles, with faint parts made brighter.

    Own tone map: 255 u^`GAMMA`, where u is the stretched value (gamma correction: Poynton, Digital
    Video and HD, 2012).

    values: (H, W) float32, grey values.
    Returns: (H, W) uint8; all 0 if the values are all equal.
    """
    sample = values[::4, ::4]
    low, high = (float(q) for q in np.quantile(sample, [_CLIPPED, 1.0 - _CLIPPED]))
    if high <= low:
        low, high = float(values.min()), float(values.max())
    if high <= low:
        return np.zeros(values.shape, np.uint8)
    scaled = np.clip((values - low) * (255.0 / (high - low)), 0.0, 255.0).astype(np.uint8)
    table = np.round(255.0 * (np.arange(256) / 255.0) ** GAMMA).astype(np.uint8)
    return np.asarray(cv2.LUT(scaled, table), np.uint8)


def _read_events(path: Path, expected_hz: float | None, *, compare: bool) -> LiveImage:
    """Make the image of an event camera's slice."""
    raw = RawFile.open(path)
    quick = None if expected_hz is None else _by_counts(raw, expected_hz)
    # Times of events are needed for some figures of a slice that is long enough, now and then.
    if quick is not None and not (compare and shows_flicker(quick.signal)):
        return quick
    events, triggers = raw.read()
    starts = [int(a[0]) for a in (events.t, triggers.t) if len(a)]
    origin_us = min(starts, default=0)
    events.t[:] -= origin_us
    triggers.t[:] -= origin_us
    data_bytes = path.stat().st_size - raw.raw_header.size_bytes
    signal = measure_signal(events, triggers, data_bytes, expected_hz, compare=compare)
    if quick is not None and signal.flicker is not None:
        return quick._replace(signal=signal)
    size = raw.width, raw.height
    images = _images(events, size, signal)
    if images is None:
        counts = _counts(events, size)
        hot = int(np.count_nonzero(counts > _HOT_EVENTS + 4.0 * float(counts.mean())))
        return LiveImage(counts, "count", 0.5, signal, hot, None)
    chosen = images.best()
    least = _LEAST_FIRED if chosen.name == "fired-per-edge" else 1.0
    return LiveImage(chosen.image, chosen.name, least, signal, images.facts.hot_pixels, None)


def _by_counts(raw: RawFile, expected_hz: float) -> LiveImage | None:
    """Make the image of a slice from counts alone; None if the flicker is known by the times of events only."""
    counted = count_slice(raw, 1e6 / expected_hz)
    signal = signal_of_counts(counted.statistics, counted.triggers, counted.data_bytes, expected_hz)
    if signal is None or signal.flicker is None:
        return None
    if not counted.periods:
        values = counted.counts.sum(axis=0, dtype=np.float32)
        return LiveImage(np.minimum(values, 1.0), "count", 0.5, signal, None, None)
    found = make_quick_image(counted.counts, counted.periods)
    return LiveImage(found.image, found.name, _LEAST_FIRED, signal, found.hot_pixels, None)


def _images(events: Events, size: tuple[int, int], signal: SignalFigures) -> EventImages | None:
    """Return the event images of whole periods; None if the slice holds none."""
    if signal.flicker is None or not len(events.t):
        return None
    window_us = 0.0, float(events.t[-1]) + 1.0
    try:
        return make_images(events.t, events.x, events.y, events.p, size, signal.flicker, window_us=window_us)
    except CalibrationError:
        return None


def _counts(events: Events, size: tuple[int, int]) -> NDArray[np.float32]:
    """Return the number of events of each pixel, (H, W)."""
    inside = (events.x < size[0]) & (events.y < size[1])
    places = events.y[inside].astype(np.int64) * size[0] + events.x[inside]
    return np.bincount(places, minlength=size[0] * size[1]).reshape(size[1], size[0]).astype(np.float32)


def _read_frames(path: Path) -> LiveImage:
    """Make the image of a frame camera's slice."""
    frames = read_frames(path)
    highest = float(np.iinfo(frames.dtype).max)
    values = frames[0].astype(np.float32) if len(frames) == 1 else frames.mean(axis=0, dtype=np.float32)
    saturated = float(np.mean(frames == highest))
    return LiveImage(np.asarray(values, np.float32), "picture", _LEAST_GREY * highest, None, None, saturated)
