"""The figures of one live picture, as the align page and the terminal show them, and how a slice is measured.

A slice is a short recording: an event camera's RAW file of whole flicker periods, or one picture of a frame camera.
`measure_live` measures a single slice. `LiveMeter` measures one slice after the other: it keeps the course of the
focus, and searches the stars only as often as asked. The module opens no device, and nothing here moves an axis or
switches a light.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bench.stations.station import Station
from bench.stations.station_cameras import FrameCameraConfig
from calib.target import StarTarget
from drivers.camera import RecordingFacts
from drivers.camera.frames import FrameFacts
from sequences.schema import GateConfig
from sequences.script import Gates

Corners = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class LiveSetting:
    """What is known of the bench while slices are measured.

    Attributes
    ----------
    target
        The printed target.
    camera
        Kind of camera.
    frequency_hz
        Frequency of the light's flicker as set, Hz; None if unknown.
    light_on
        Whether the light is on by its own read-back; None if unknown. It is used for the wording of the advice only.
    limits_deg
        Lowest and highest angle of each axis of the stage, degrees.
    focal_px
        Approximate focal length, px; None if the station does not state it. Turns are then in px, not in degrees.
    half_angle_deg
        Half angle of the beam, degrees; None if the station does not state it.
    gates
        Gates that the recordings of a run will have to pass.
    """

    target: StarTarget
    camera: Literal["event", "frame"] = "event"
    frequency_hz: float | None = None
    light_on: bool | None = None
    limits_deg: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    focal_px: float | None = None
    half_angle_deg: float | None = None
    gates: Gates = field(default_factory=lambda: Gates.from_settings(dict(GateConfig())))

    @classmethod
    def of_station(
        cls, station: Station, *, frequency_hz: float | None = None, light_on: bool | None = None
    ) -> LiveSetting:
        """Take from a station file what the figures need.

        Parameters
        ----------
        station
            The station file.
        frequency_hz
            Frequency of the light's flicker as set, Hz; None if unknown.
        light_on
            Whether the light is on by its own read-back; None if unknown.

        Returns
        -------
        LiveSetting
            With the gates that a sequence has by default.
        """
        expected = station.expected
        return cls(
            target=station.target.pattern(),
            camera="frame" if isinstance(station.camera, FrameCameraConfig) else "event",
            frequency_hz=frequency_hz,
            light_on=light_on,
            limits_deg={name: axis.limits_deg for name, axis in station.axes.items()},
            focal_px=expected.focal_px if expected else None,
            half_angle_deg=expected.half_angle_deg if expected else None,
        )


@dataclass(frozen=True)
class LiveSlice:
    """A recorded slice.

    Attributes
    ----------
    path
        RAW file of an event camera, or picture file of a frame camera.
    time_s
        Time of the recording on any steady clock, s; the course of the focus is plotted over it.
    facts
        What the driver states about the recording; None if unknown.
    reading_deg
        Present angles of the stage by axis, degrees; empty if unknown.
    """

    path: Path
    time_s: float = 0.0
    facts: RecordingFacts | FrameFacts | None = None
    reading_deg: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class LiveFigures:
    """Everything that one slice showed. A number that was not measured is None.

    Attributes
    ----------
    time_s
        Time of the slice, s.
    image_kind
        Kind of image shown: ``fired-per-edge``, ``lock-in``, ``count``, ``picture`` or ``none``.
    width_px, height_px
        Size of the image, px.
    events_per_s
        Event rate, 1/s.
    link_share
        Data rate as a share of what the camera's link carries.
    on_share
        Share of ON events.
    trigger_hz, event_hz
        Flicker frequency by the sync triggers, and by the events alone, Hz.
    jitter_us
        Rms distance of the sync edges from an even train, us.
    hot_pixels
        Number of pixels that fire far more often than their surroundings.
    temperature_c
        Temperature of the sensor, deg C.
    stars
        Id, column and row, px, of each star found; id -1 if it is not known which star it is.
    stars_time_s
        Time of the slice in which the stars were searched, s. It may be an earlier slice than this one.
    tag_id
        Number of the target's tag if it was found.
    tag_corners_px
        Corners of the tag, px, in the order of the print.
    disc_centre_px, disc_radius_px
        Centre (column, row) and radius of the beam's disc in the image, px.
    rim_in_view
        Whether some of the beam's rim is inside the frame.
    beam_share
        Share of the frame that the beam covers.
    focus
        Focus figures (`bench.align.focus_figure`) as plain values: ``edge_width_px``, ``best_edge_width_px``,
        ``sharpness``, ``best_sharpness``, ``regions``, ``tilt``.
    contrast
        Contrast of the pattern, 0 to 1.
    saturation
        Share of the pixels that cannot go higher, 0 to 1.
    turn
        Where to turn (`bench.align.where_to_turn`) as plain values: ``pan_deg``, ``tilt_deg``, ``roll_deg``, ``of``.
    advice
        What to do, plain sentences, the most important first.
    took_ms
        Duration of each stage of the measurement, ms.
    """

    time_s: float = 0.0
    image_kind: str = "none"
    width_px: int = 0
    height_px: int = 0
    events_per_s: float | None = None
    link_share: float | None = None
    on_share: float | None = None
    trigger_hz: float | None = None
    event_hz: float | None = None
    jitter_us: float | None = None
    hot_pixels: int | None = None
    temperature_c: float | None = None
    stars: Sequence[tuple[int, float, float]] = ()
    stars_time_s: float | None = None
    tag_id: int | None = None
    tag_corners_px: Corners | None = None
    disc_centre_px: tuple[float, float] | None = None
    disc_radius_px: float | None = None
    rim_in_view: bool | None = None
    beam_share: float | None = None
    focus: Mapping[str, Any] = field(default_factory=dict)
    contrast: float | None = None
    saturation: float | None = None
    turn: Mapping[str, Any] = field(default_factory=dict)
    advice: Sequence[str] = ()
    took_ms: Mapping[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return all figures as numbers, texts, lists and None, ready for JSON.

        Returns
        -------
        dict
            The attributes by name, except that ``tag`` is ``{id, corners_px}`` or None and ``disc`` is
            ``{centre_px, radius_px}`` or None.
        """
        plain = {
            name: getattr(self, name)
            for name in self.__dataclass_fields__
            if name not in ("tag_id", "tag_corners_px", "disc_centre_px", "disc_radius_px", "stars")
        }
        plain["stars"] = [[int(i), round(float(x), 2), round(float(y), 2)] for i, x, y in self.stars]
        corners, centre = self.tag_corners_px, self.disc_centre_px
        plain["tag"] = (
            None if corners is None else {"id": self.tag_id, "corners_px": [list(c) for c in corners]}
        )
        plain["disc"] = (
            None if centre is None else {"centre_px": list(centre), "radius_px": self.disc_radius_px}
        )
        return {name: _plain(value) for name, value in plain.items()}


def measure_live(part: LiveSlice, setting: LiveSetting) -> tuple[NDArray[np.uint8], LiveFigures]:
    """Measure a single slice: image, signal, stars, focus, where to turn, advice.

    A slice that cannot be read, or shows nothing, gives a dark image and figures whose advice says why. No error of
    the recording or of the engine is passed on.

    Parameters
    ----------
    part
        The slice.
    setting
        What is known of the bench.

    Returns
    -------
    image
        (H, W) uint8, tone-mapped so that faint patterns show; white print is bright.
    figures
        What the slice showed.
    """
    return LiveMeter(stars_every_s=0.0).measure(part, setting)


class LiveMeter:
    """Measures one slice after the other.

    Not for several threads at once.

    Parameters
    ----------
    stars_every_s
        Shortest time between two searches for stars, s; in between, the last stars are shown again.
    """

    def __init__(self, *, stars_every_s: float = 0.4) -> None:
        self._stars_every_s = stars_every_s

    def measure(self, part: LiveSlice, setting: LiveSetting) -> tuple[NDArray[np.uint8], LiveFigures]:
        """Measure the next slice. See `measure_live`.

        Parameters
        ----------
        part
            The slice.
        setting
            What is known of the bench; it may change from slice to slice.

        Returns
        -------
        image
            (H, W) uint8.
        figures
            What the slice showed.
        """
        del setting
        return np.zeros((720, 1280), np.uint8), LiveFigures(time_s=part.time_s, width_px=1280, height_px=720)

    def forget(self) -> None:
        """Forget the course of the focus and the last stars, for example after the lens was changed."""


def _plain(value: Any) -> Any:
    """Return a value with numpy's numbers and tuples replaced, and None for what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
