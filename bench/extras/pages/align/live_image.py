"""The live image: what is known of the bench, and a slice as grey values for the search of stars and for the screen.

Events of whole flicker periods are counted while they are decoded: a list of events takes most of the time. Without a
flicker all events of a pixel count; a frame camera's slice becomes the mean of its frames.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.stations.sections import FrameCameraSection
from bench.stations.station import Station
from bench.stations.station_budget import CertificateConfig
from calib.errors import FlickerNotFound
from calib.events.event_image import make_quick_image
from calib.events.flicker import Flicker, flicker_from_triggers
from calib.target import StarTarget
from drivers.camera import RecordingFacts
from drivers.camera.event_arrays import Triggers, join_triggers
from drivers.camera.evt3 import Evt3Decoder, StreamStatistics
from drivers.camera.frames import FrameFacts, read_frames
from drivers.camera.raw_file import RawFile
from sequences.schema import GateConfig, Waveform
from sequences.script import Gates

_TIME_LOW, _TIME_HIGH = 0x6, 0x8  # Types of EVT3's clock words
_CLOCK: Final = 1 << 24
"""Number of microseconds after which the time words begin again."""
_NEARLY: Final = 0.02
"""Share of a period that may be missing at the end: time words come only with events."""

GAMMA: Final = 0.6
"""Exponent of the tone map: a pattern at a tenth of the brightest light is shown at a quarter."""
_CLIPPED: Final = 0.004  # Quantile at both ends, so that some hot pixels do not take the range of grey
_LEAST_FIRED: Final = 0.3  # Events an edge: contrast is not stretched further, so that noise stays dark
_LEAST_GREY: Final = 0.02  # Share of full scale: contrast is not stretched further, so that noise stays dark


@dataclass(frozen=True)
class SignalFigures:
    """Rate, polarity and sync edges of a slice. A figure that was not measured is None."""

    events_per_s: float | None = None  # Event rate, 1/s
    on_share: float | None = None
    triggers: int = 0
    triggers_expected: int = 0
    sync_edges: int = 0
    trigger_hz: float | None = None  # Frequency by the sync edges
    jitter_us: float | None = None  # Rms distance of the sync edges from an even train, us
    sync_fault: str = ""  # What is wrong with the sync edges; empty if nothing is, or there are none


def measure_signal(counted: CountedSlice, expected_hz: float | None) -> SignalFigures:
    """Measure the signal of a slice; the light is set to ``expected_hz``, None if that is unknown.

    Events count in whole periods: a few edges of the light more or less would change rate and share by a tenth.
    """
    triggers, duration_s = counted.triggers, counted.statistics.duration_s
    off, on = (int(count) for count in counted.counts.sum(axis=(1, 2), dtype=np.int64))
    counted_s = counted.periods / expected_hz if counted.periods and expected_hz else duration_s
    edges, fault = _by_triggers(triggers, expected_hz)
    return SignalFigures(
        events_per_s=(off + on) / counted_s if counted_s else None,
        on_share=on / (off + on) if off + on else None,
        triggers=int(np.count_nonzero(triggers.value == 1)),
        triggers_expected=len(edges.rising_edges_us(0.0, 1e6 * duration_s)) if edges else 0,
        sync_edges=len(triggers.t),
        trigger_hz=edges.frequency_hz if edges and _shows_period(triggers) else None,
        jitter_us=edges.jitter_us if edges and math.isfinite(edges.jitter_us) else None,
        sync_fault=fault,
    )


def _by_triggers(triggers: Triggers, expected_hz: float | None) -> tuple[Flicker | None, str]:
    """Return the flicker by the sync edges, and what is wrong with them."""
    if not len(triggers.t) or (expected_hz is None and len(triggers.t) < 2):
        return None, ""
    try:
        return flicker_from_triggers(triggers.t, triggers.value, expected_hz=expected_hz), ""
    except FlickerNotFound as fault:
        if expected_hz is None:
            return None, fault.what
        first = fault.what
    try:
        return flicker_from_triggers(triggers.t, triggers.value), first
    except FlickerNotFound:
        return None, first


def _shows_period(triggers: Triggers) -> bool:
    """Return whether two edges of one direction are there: a single one takes its frequency from the settings."""
    up = int(np.count_nonzero(triggers.value == 1))
    return max(up, len(triggers.t) - up) >= 2


@dataclass(frozen=True)
class LiveSetting:
    """What is known of the bench while slices are measured."""

    target: StarTarget
    camera: Literal["event", "frame"] = "event"
    frequency_hz: float | None = None  # Frequency of the light's flicker as set, Hz; None if unknown
    # Whether the light is on by its own read-back; None if unknown.
    light_on: bool | None = None
    level_percent: float | None = None  # Level of the light as asked for, percent; None if unknown
    focal_px: float | None = None  # Approximate focal length, px; None if the station does not state it
    # Half angle of the beam, degrees; None if the station does not state it.
    half_angle_deg: float | None = None
    # Approximate focal length of the collimator, mm; None if the station does not state it.
    r_mm: float | None = None
    # Gates that the recordings of a run will have to pass.
    gates: Gates = field(default_factory=lambda: Gates.from_settings(dict(GateConfig())))

    @property
    def beam_radius_px(self) -> float | None:
        """Radius of the beam's disc in the image, px, by the expected values; None if one of them is not stated."""
        if self.focal_px is None or self.half_angle_deg is None:
            return None
        return self.focal_px * math.tan(math.radians(self.half_angle_deg))

    @property
    def tag_side_px(self) -> float | None:
        """Side of the tag in the image, px, by the expected values; None if one of them is not stated."""
        if self.focal_px is None or self.r_mm is None:
            return None
        corners = self.target.tag_corners_mm
        return float(np.hypot(*(corners[1] - corners[0]))) * self.focal_px / self.r_mm

    @classmethod
    def of_station(
        cls,
        station: Station,
        *,
        frequency_hz: float | None = None,
        light_on: bool | None = None,
        level_percent: float | None = None,
        waveform: Waveform = "square",
    ) -> LiveSetting:
        """Take what the figures need from a station, with a sequence's default gates; ``frequency_hz`` is as set."""
        expected, collimator = station.expected, station.collimator
        r_mm = collimator.nominal_r_mm or (expected.r_mm if expected else None)
        if isinstance(collimator.certificate, CertificateConfig):
            r_mm = collimator.certificate.r_mm
        return cls(
            target=station.target.pattern(),
            camera="frame" if isinstance(station.camera, FrameCameraSection) else "event",
            frequency_hz=frequency_hz,
            light_on=light_on,
            level_percent=level_percent,
            focal_px=expected.focal_px if expected else None,
            half_angle_deg=expected.half_angle_deg if expected else None,
            r_mm=r_mm,
            gates=Gates.from_settings(dict(GateConfig()), waveform),
        )


@dataclass(frozen=True)
class LiveSlice:
    """A recorded slice."""

    path: Path  # RAW file of an event camera, or picture file of a frame camera
    # Time of the recording on any steady clock, s; the focus is plotted over it.
    time_s: float = 0.0
    # What the driver states about the recording; None if unknown.
    facts: RecordingFacts | FrameFacts | None = None
    # Present angles of the stage by axis, degrees; empty if unknown.
    reading_deg: Mapping[str, float] = field(default_factory=dict)
    moving: bool = False  # Whether the stage turned meanwhile


class CountedSlice(NamedTuple):
    """A slice as counted."""

    # (2, H, W) uint16, number of OFF events, then of ON events, of each pixel in the whole periods, or in a
    # slice that is shorter than one.
    counts: NDArray[np.uint16]
    periods: int  # Number of whole periods from the start of the slice on; 0 if it is shorter than one
    triggers: Triggers  # Sync edges of the whole slice, with times from its first time word on
    statistics: StreamStatistics  # Counts and times of the whole slice


def count_slice(raw: RawFile, period_us: float) -> CountedSlice:
    """Count the events of a slice, for a flicker of this period; infinite where there is none."""
    pieces = list(raw.words())
    words = pieces[0] if len(pieces) == 1 else np.concatenate([np.zeros(0, "<u2"), *pieces])
    end, periods = whole_periods(words, period_us)
    first_byte = raw.raw_header.size_bytes
    end = end if periods else len(words)
    decoder = Evt3Decoder(raw.width, raw.height, first_byte=first_byte, where=str(raw.path))
    counts = np.zeros((2, raw.height, raw.width), np.uint16)
    triggers = join_triggers([decoder.count(words[:end], counts), decoder.tally(words[end:])])
    statistics = decoder.statistics()
    triggers.t[:] -= max(statistics.first_t_us, 0)
    return CountedSlice(counts, periods, triggers, statistics)


def whole_periods(words: NDArray[np.uint16], period_us: float) -> tuple[int, int]:
    """Return how many whole periods, us, of (N,) uint16 EVT3 words there are, and where the last one ends.

    >>> words = np.array([0x8000, 0x6000, 0x2001, 0x6063, 0x2002, 0x6064, 0x2003], np.uint16)
    >>> whole_periods(words, 100.0)
    (5, 1)
    """
    kinds = words >> 12
    low, high = np.flatnonzero(kinds == _TIME_LOW), np.flatnonzero(kinds == _TIME_HIGH)
    above = np.searchsorted(high, low) - 1
    low, above = low[above >= 0], above[above >= 0]
    if not len(low):
        return 0, 0
    clock = (words[high[above]].astype(np.int64) & 0xFFF) << 12 | (words[low].astype(np.int64) & 0xFFF)
    # A busy sensor's clock steps back by some microseconds now and then.
    elapsed = np.maximum.accumulate((clock - clock[0] + 4096) % _CLOCK - 4096)
    periods = int(elapsed[-1] / period_us + _NEARLY)
    beyond = np.searchsorted(elapsed, periods * period_us)
    return (int(low[beyond]) if beyond < len(low) else len(words)), periods


class LiveImage(NamedTuple):
    """Grey values of a slice, and what belongs to them."""

    values: NDArray[np.float32]  # (H, W) float32, brighter where the target is brighter
    shows_stars: bool  # Whether stars may be searched: not in events without a flicker
    least: float  # Brightness of white print below which nothing counts as light, in the unit of the values
    signal: SignalFigures | None  # The signal; None for a frame camera
    saturation: float | None  # Share of the pixels at the highest grey value; None for an event camera


def read_image(path: Path, setting: LiveSetting) -> LiveImage:
    """Read a slice and make its image."""
    if setting.camera == "frame":
        return _read_frames(path)
    return _read_events(path, setting.frequency_hz)


def show(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return a picture, (H, W) float32, stretched between quantiles, for the screen, uint8; all 0 if it is even.

    Own tone map: 255 u^`GAMMA`, where u is the stretched value (gamma correction: Poynton, Digital Video and HD, 2012).
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


def _read_events(path: Path, expected_hz: float | None) -> LiveImage:
    """Make the image of an event camera's slice from counts: of whole periods if it holds any."""
    counted = count_slice(RawFile.open(path), 1e6 / expected_hz if expected_hz else math.inf)
    signal = measure_signal(counted, expected_hz)
    if counted.periods:
        image = make_quick_image(counted.counts, counted.periods)
        return LiveImage(image.image, True, _LEAST_FIRED, signal, None)
    values = counted.counts.sum(axis=0, dtype=np.float32)
    if expected_hz:
        return LiveImage(np.minimum(values, 1.0), True, 0.5, signal, None)
    return LiveImage(values, False, 0.5, signal, None)


def _read_frames(path: Path) -> LiveImage:
    """Make the image of a frame camera's slice."""
    frames = read_frames(path)
    highest = float(np.iinfo(frames.dtype).max)
    values = frames[0].astype(np.float32) if len(frames) == 1 else frames.mean(axis=0, dtype=np.float32)
    saturated = float(np.mean(frames == highest))
    return LiveImage(np.asarray(values, np.float32), True, _LEAST_GREY * highest, None, saturated)
