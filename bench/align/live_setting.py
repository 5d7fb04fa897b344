"""What the measurement of live slices is told: the slice, and what is known of the bench.

The module holds data only; it opens nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from bench.stations.station import Station
from bench.stations.station_cameras import FrameCameraConfig
from bench.stations.station_collimator import CertificateConfig
from calib.target import StarTarget
from drivers.camera import RecordingFacts
from drivers.camera.frames import FrameFacts
from sequences.schema import GateConfig, Waveform
from sequences.script import Gates


@dataclass(frozen=True)
class LiveSetting:
    """What is known of the bench while slices are measured."""

    target: StarTarget
    camera: Literal["event", "frame"] = "event"
    frequency_hz: float | None = None  # Frequency of the light's flicker as set, Hz; None if unknown
    # Whether the light is on by its own read-back; None if unknown. It is used for the wording of the advice
    # only.
    light_on: bool | None = None
    level_percent: float | None = None  # Level of the light as asked for, percent; None if unknown
    # Lowest and highest angle of each axis of the stage, degrees.
    limits_deg: Mapping[str, tuple[float, float]] = field(default_factory=dict)
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
        """Take from a station file what the figures need.

        frequency_hz: Frequency of the light's flicker as set, Hz; None if unknown.
        light_on: Whether the light is on by its own read-back; None if unknown.
        level_percent: Level of the light as asked for, percent; None if unknown.
        Returns: With the gates that a sequence has by default.
        """
        expected, collimator = station.expected, station.collimator
        r_mm = collimator.nominal_r_mm or (expected.r_mm if expected else None)
        if isinstance(collimator.certificate, CertificateConfig):
            r_mm = collimator.certificate.r_mm
        return cls(
            target=station.target.pattern(),
            camera="frame" if isinstance(station.camera, FrameCameraConfig) else "event",
            frequency_hz=frequency_hz,
            light_on=light_on,
            level_percent=level_percent,
            limits_deg={name: axis.limits_deg for name, axis in station.axes.items()},
            focal_px=expected.focal_px if expected else None,
            half_angle_deg=expected.half_angle_deg if expected else None,
            r_mm=r_mm,
            gates=Gates.from_settings(dict(GateConfig()), waveform),
        )


@dataclass(frozen=True)
class LiveSlice:
    """A recorded slice."""

    path: Path  # RAW file of an event camera, or picture file of a frame camera
    # Time of the recording on any steady clock, s; the course of the focus is plotted over it.
    time_s: float = 0.0
    # What the driver states about the recording; None if unknown.
    facts: RecordingFacts | FrameFacts | None = None
    # Present angles of the stage by axis, degrees; empty if unknown.
    reading_deg: Mapping[str, float] = field(default_factory=dict)
    moving: bool = False  # Whether the stage turned meanwhile
