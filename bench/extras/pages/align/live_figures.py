"""The figures of one live picture, as the align page shows them, and how a slice is measured.

A slice is an event camera's RAW file of whole flicker periods, or one picture of a frame camera. No device is used
here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.base.bounded_json import mapped
from bench.extras.pages.align.focus import FocusFigures
from bench.extras.pages.align.live_image import (
    LiveImage,
    LiveSetting,
    LiveSlice,
    SignalFigures,
    read_image,
    show,
)
from bench.extras.pages.align.star_watch import Found, StarWatch, StopWatch
from bench.extras.pages.align.steady_turn import SteadyTurn
from bench.extras.pages.align.where_to_turn import SeenMotion, TurnFigures, where_to_turn
from bench.measure.gates import FILTERS_TO_DISABLE
from calib.errors import CalibrationError
from calib.stars.beam import Beam, find_beam
from calib.stars.focus import contrast
from calib.stars.quick import QuickStars
from calib.stars.tag import DarkSquare
from drivers.camera import RecordingFacts
from drivers.camera.frames import FrameFacts
from drivers.errors import RecordingFileError

__all__ = ["LiveFigures", "LiveMeter", "LiveSetting", "LiveSlice"]

JPEG_QUALITY: Final = 82
_COMPARED_EVERY_S: Final = 1.0
"""Time from one measurement of the frequency by the events to the next, s."""

Corners = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class LiveFigures:
    """Everything that one slice showed. A number that was not measured is None."""

    time_s: float = 0.0  # Time of the slice, s
    # Kind of image shown: ``fired-per-edge``, ``events-per-edge``, ``lock-in``, ``count``, ``picture`` or
    # ``none``.
    image_kind: str = "none"
    width_px: int = 0  # Of the image
    height_px: int = 0  # Of the image
    # The signal. While the light is known to be off, `trigger_hz` is None, because a sync output may go on. `event_hz`
    # may be that of an earlier slice.
    signal: SignalFigures = field(default_factory=SignalFigures)
    hot_pixels: int | None = None  # Number of pixels that fire far more often than their surroundings
    temperature_c: float | None = None  # Temperature of the sensor, deg C
    recording_faults: Sequence[str] = ()  # What is wrong with the recording itself, each in some words
    moving: bool = False  # Whether the stage turned meanwhile
    # Id, column and row, px, of each star found; id -1 if it is not known which star it is.
    stars: Sequence[tuple[int, float, float]] = ()
    # Time of the slice in which the stars were measured, s. It may be an earlier slice than this one.
    stars_time_s: float | None = None
    # Whether these stars were found before, and only measured again at their places.
    stars_followed: bool = False
    tag_id: int | None = None  # Number of the target's tag if it was found
    other_tag: str = ""  # What is wrong with the tags seen; empty if nothing is
    tag_corners_px: Corners | None = None  # Corners of the tag, px, in the order of the print
    square: DarkSquare | None = None  # A dark square that looks like the tag, if the tag was not read
    disc_centre_px: tuple[float, float] | None = None  # Of the beam's disc in the image (column, row)
    disc_radius_px: float | None = None  # Of the same disc
    rim_in_view: bool | None = None  # Whether some of the beam's rim is inside the frame
    beam_share: float | None = None
    focus: FocusFigures = field(default_factory=FocusFigures)
    contrast: float | None = None  # Contrast of the pattern, 0 to 1
    saturation: float | None = None
    turn: TurnFigures = field(default_factory=TurnFigures)  # Where to turn
    # Duration of each stage of the measurement, ms.
    took_ms: Mapping[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return all figures for JSON, with the names of the attributes."""
        plain = asdict(self) | {
            "stars": [(number, round(x, 2), round(y, 2)) for number, x, y in self.stars],
            "square": self.square and self.square._asdict(),
        }
        return {name: mapped(value, _plain) for name, value in plain.items()}


class LiveMeter:
    """Measures one slice after the other, in one thread.

    ``stars_every_s`` is the shortest time between two searches. In between, stars around the whole tag are measured
    again where they stand; if they have moved, they are searched at once. After a long search the next one waits
    longer.
    """

    def __init__(self, *, stars_every_s: float = 0.4) -> None:
        self._stars = StarWatch(stars_every_s=stars_every_s)
        self._motion = SeenMotion()
        self._steady = SteadyTurn()
        self._event_hz: tuple[float, float] | None = None
        self._size = (1280, 720)

    def measure(self, part: LiveSlice, setting: LiveSetting) -> tuple[bytes, LiveFigures]:
        """Measure the next slice: image, signal, stars, focus, where to turn.

        The image is a tone-mapped JPEG; dark, with figures that say why, if the slice shows nothing. Never raises.
        """
        watch = StopWatch()
        try:
            image = read_image(part.path, setting, compare=self._compares(part))
        except (CalibrationError, RecordingFileError) as error:
            return self._dark(part, f"cannot be read: {error.what} {error.remedy}".strip(), watch)
        self._size = image.values.shape[1], image.values.shape[0]
        event_hz = self._by_events(part, image)
        shown = _jpeg(show(image.values))
        watch.lap("image")
        beam = find_beam(image.values, least=image.least, radius_px=setting.beam_radius_px)
        in_beam = contrast(image.values, beam.lit) if beam.share > 0.0 else None
        watch.lap("beam")
        stars = self._stars.look(part, setting, image, beam, watch)
        figures = _figures(part, setting, image, beam, stars)
        return shown, replace(
            figures,
            signal=replace(figures.signal, event_hz=event_hz),
            contrast=in_beam,
            turn=self._steady.steady(self._turn(part, setting, beam, stars), image.values, part.reading_deg),
            took_ms=watch.lap("turn"),
        )

    def _dark(self, part: LiveSlice, why: str, watch: StopWatch) -> tuple[bytes, LiveFigures]:
        """Return the dark image of a slice that shows nothing, with figures that say why."""
        figures = LiveFigures(
            time_s=part.time_s,
            width_px=self._size[0],
            height_px=self._size[1],
            temperature_c=_temperature_c(part),
            recording_faults=(why,),
            moving=part.moving,
            took_ms=watch.lap("image"),
        )
        return _jpeg(np.zeros(self._size[::-1], np.uint8)), figures

    def close(self) -> None:
        """Do nothing: unlike `bench.extras.pages.align.meter.MeterProcess`, there is no process to end."""

    def forget(self) -> None:
        """Forget the last stars and how they moved, for example after the lens was changed."""
        self._motion.forget()
        self._steady = SteadyTurn()
        self._stars.forget()
        self._event_hz = None

    def _turn(self, part: LiveSlice, setting: LiveSetting, beam: Beam, stars: Found) -> TurnFigures:
        """Find out where to turn, and learn how the tag has moved since the last search for it."""
        turn = where_to_turn(
            self._size, beam, stars.stars, setting, part.reading_deg, self._motion, stars.square
        )
        if stars.time_s == part.time_s and turn.tag_px is not None and turn.focal_px and part.reading_deg:
            self._motion.add(part.reading_deg, turn.tag_px, turn.focal_px)
        return turn

    def _by_events(self, part: LiveSlice, image: LiveImage) -> float | None:
        """Return the frequency by the events, Hz: of this slice, or the last one while the sync edges go on."""
        if image.signal is None or image.signal.flicker is None:
            self._event_hz = None
            return None
        if image.signal.event_hz is not None:
            self._event_hz = part.time_s, image.signal.event_hz
        elif self._compares(part):
            self._event_hz = None
        return self._event_hz[1] if self._event_hz is not None else None

    def _compares(self, part: LiveSlice) -> bool:
        """Return whether it is time to measure the frequency by the events too."""
        if self._event_hz is None:
            return True
        return not 0.0 <= part.time_s - self._event_hz[0] < _COMPARED_EVERY_S


def _jpeg(image: NDArray[np.uint8]) -> bytes:
    coded, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return jpeg.tobytes() if coded else b""


def _figures(
    part: LiveSlice, setting: LiveSetting, image: LiveImage, beam: Beam, found: Found
) -> LiveFigures:
    """Collect the figures of a slice, without contrast and turns."""
    stars = found.stars
    signal = image.signal or SignalFigures()
    tag = stars.tag if stars is not None else None
    return LiveFigures(
        time_s=part.time_s,
        image_kind=image.kind,
        width_px=image.values.shape[1],
        height_px=image.values.shape[0],
        signal=replace(signal, trigger_hz=None) if setting.light_on is False else signal,
        hot_pixels=image.hot_pixels,
        temperature_c=_temperature_c(part),
        recording_faults=tuple(_recording_faults(part.facts)),
        moving=part.moving,
        stars=() if stars is None else tuple(_star_list(stars)),
        stars_time_s=found.time_s if stars is not None else None,
        stars_followed=found.followed,
        tag_id=setting.target.tag_id if tag is not None else None,
        other_tag=found.other_tag,
        tag_corners_px=None if tag is None else tuple((float(x), float(y)) for x, y in tag.corners_px),
        square=found.square,
        disc_centre_px=beam.centre_px,
        disc_radius_px=beam.radius_px,
        rim_in_view=beam.rim_in_view,
        beam_share=beam.share,
        focus=found.focus,
        saturation=image.saturation if image.signal is None else _dropped_share(part.facts),
    )


def _recording_faults(facts: RecordingFacts | FrameFacts | None) -> Iterator[str]:
    """Yield what the driver reports against a recording."""
    if facts is None:
        return
    if not facts.complete:
        yield "ended too early"
    if isinstance(facts, RecordingFacts):
        if facts.gaps:
            yield f"data lost ({facts.gaps[0]})"
        if active := [name.upper() for name in FILTERS_TO_DISABLE if facts.filters.get(name)]:
            yield f"filter {', '.join(active)} is on"


def _dropped_share(facts: RecordingFacts | FrameFacts | None) -> float | None:
    """Return the share, 0 to 1, of events that the rate controller dropped; None if the camera does not count."""
    if (
        not isinstance(facts, RecordingFacts)
        or not facts.rate_controller_in
        or facts.rate_controller_out is None
    ):
        return None
    return max(0.0, 1.0 - facts.rate_controller_out / facts.rate_controller_in)


def _star_list(stars: QuickStars) -> Iterator[tuple[int, float, float]]:
    """Yield id, column and row of each star."""
    for number, (x, y) in zip(stars.ids, stars.points_px, strict=True):
        yield int(number), float(x), float(y)


def _temperature_c(part: LiveSlice) -> float | None:
    """Return the sensor's temperature as the driver states it."""
    return part.facts.temperature_c if isinstance(part.facts, RecordingFacts) else None


def _plain(value: Any) -> Any:
    """Return a value without numpy's numbers, and None for what is not finite."""
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
