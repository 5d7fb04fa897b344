"""The figures of one live picture, as the align page shows them, and how a slice is measured.

A slice is an event camera's RAW file of whole flicker periods, or one picture of a frame camera. No device is used
here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.base.bounded_json import mapped
from bench.extras.pages.align.focus import edge_width_px
from bench.extras.pages.align.live_image import (
    LiveImage,
    LiveSetting,
    LiveSlice,
    SignalFigures,
    read_image,
    show,
)
from bench.extras.pages.align.where_to_turn import SteadyTurn, TurnFigures, where_to_turn
from bench.measure.gates import FILTERS_TO_DISABLE
from calib.errors import CalibrationError, TargetNotFound
from calib.stars.beam import Beam, find_beam
from calib.stars.focus import contrast
from calib.stars.quick import QuickStars, find_stars_quickly
from calib.stars.tag import DarkSquare, find_dark_square
from drivers.camera import RecordingFacts
from drivers.camera.frames import FrameFacts
from drivers.errors import RecordingFileError

__all__ = ["LiveFigures", "LiveMeter", "LiveSetting", "LiveSlice"]

JPEG_QUALITY: Final = 82  # Less blurs the edges of stars, more makes each picture larger

Corners = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class LiveFigures:
    """Everything that one slice showed. A number that was not measured is None."""

    time_s: float = 0.0  # Time of the slice, s
    width_px: int = 0  # Of the image
    height_px: int = 0  # Of the image
    # The signal. While the light is known to be off, `trigger_hz` is None, because a sync output may go on.
    signal: SignalFigures = field(default_factory=SignalFigures)
    recording_faults: Sequence[str] = ()  # What is wrong with the recording itself, each in some words
    moving: bool = False  # Whether the stage turned meanwhile; then nothing is searched
    # Id, column and row, px, of each star found; id -1 if it is not known which star it is.
    stars: Sequence[tuple[int, float, float]] = ()
    other_tag: str = ""  # What is wrong with the tags seen; empty if nothing is
    # Corners of the target's tag, px, in the order of the print; None without it
    tag_corners_px: Corners | None = None
    square: DarkSquare | None = None  # A dark square that looks like the tag, if the tag was not read
    disc_centre_px: tuple[float, float] | None = None  # Of the beam's disc in the image (column, row)
    disc_radius_px: float | None = None  # Of the same disc
    beam_share: float | None = None
    edge_width_px: float | None = None  # Standard deviation of the edges' blur
    contrast: float | None = None  # Contrast of the pattern, 0 to 1
    saturation: float | None = None
    turn: TurnFigures = field(default_factory=TurnFigures)  # Where to turn

    def to_json(self) -> dict[str, Any]:
        """Return all figures for JSON, with the names of the attributes."""
        plain = asdict(self) | {
            "stars": [(number, round(x, 2), round(y, 2)) for number, x, y in self.stars],
            "square": self.square and self.square._asdict(),
        }
        return {name: mapped(value, _plain) for name, value in plain.items()}


class LiveMeter:
    """Measures one slice after the other, in one thread."""

    def __init__(self) -> None:
        self._steady = SteadyTurn()
        self._size = (1280, 720)

    def measure(self, part: LiveSlice, setting: LiveSetting) -> tuple[bytes, LiveFigures]:
        """Measure the next slice: image, signal, stars, focus, where to turn.

        The image is a tone-mapped JPEG; dark, with figures that say why, if the slice shows nothing. Never raises.
        """
        try:
            image = read_image(part.path, setting)
        except (CalibrationError, RecordingFileError) as error:
            return self._dark(part, f"cannot be read: {error.what} {error.remedy}".strip())
        values = image.values
        self._size = values.shape[1], values.shape[0]
        beam = find_beam(values, least=image.least, radius_px=setting.beam_radius_px)
        lit = beam.share > 0.0
        figures = _figures(part, setting, image, beam)
        stars = square = None
        if lit and image.shows_stars and not part.moving:
            try:
                stars = find_stars_quickly(values, setting.target)
            except TargetNotFound as fault:
                figures = replace(figures, other_tag=f"{fault.what} {fault.remedy}")
            else:
                if stars is None or (stars.tag is None and not stars.named_by):
                    square = find_dark_square(values, beam, side_px=setting.tag_side_px)
        turn = TurnFigures()
        if not part.moving:
            turn = where_to_turn(self._size, beam, stars, setting, part.reading_deg, square)
        return _jpeg(show(values)), replace(
            _with_stars(figures, stars),
            square=square,
            contrast=contrast(values, beam.lit) if lit else None,
            edge_width_px=edge_width_px(values, stars, setting.target),
            turn=self._steady.steady(turn, part.reading_deg),
        )

    def _dark(self, part: LiveSlice, why: str) -> tuple[bytes, LiveFigures]:
        """Return the dark image of a slice that shows nothing, with figures that say why."""
        figures = LiveFigures(part.time_s, *self._size, recording_faults=(why,), moving=part.moving)
        return _jpeg(np.zeros(self._size[::-1], np.uint8)), figures

    def close(self) -> None:
        """Do nothing: unlike `bench.extras.pages.align.meter.MeterProcess`, there is no process to end."""


def _jpeg(image: NDArray[np.uint8]) -> bytes:
    coded, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return jpeg.tobytes() if coded else b""


def _figures(part: LiveSlice, setting: LiveSetting, image: LiveImage, beam: Beam) -> LiveFigures:
    """Collect the figures of a slice that need no stars."""
    signal = image.signal or SignalFigures()
    return LiveFigures(
        time_s=part.time_s,
        width_px=image.values.shape[1],
        height_px=image.values.shape[0],
        signal=replace(signal, trigger_hz=None) if setting.light_on is False else signal,
        recording_faults=tuple(_recording_faults(part.facts)),
        moving=part.moving,
        disc_centre_px=beam.centre_px,
        disc_radius_px=beam.radius_px,
        beam_share=beam.share,
        saturation=image.saturation if image.signal is None else _dropped_share(part.facts),
    )


def _with_stars(figures: LiveFigures, stars: QuickStars | None) -> LiveFigures:
    """Add stars and tag to the figures of a slice."""
    if stars is None:
        return figures
    named = zip(stars.ids, stars.points_px, strict=True)
    tag = stars.tag
    return replace(
        figures,
        stars=tuple((int(number), float(x), float(y)) for number, (x, y) in named),
        tag_corners_px=None if tag is None else tuple((float(x), float(y)) for x, y in tag.corners_px),
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
        isinstance(facts, RecordingFacts)
        and facts.rate_controller_in
        and facts.rate_controller_out is not None
    ):
        return max(0.0, 1.0 - facts.rate_controller_out / facts.rate_controller_in)
    return None


def _plain(value: Any) -> Any:
    """Return a value without numpy's numbers, and None for what is not finite."""
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
