"""From one recording to one view: RAW file, whole flicker periods, event image, stars.

Every number that a gate or the report shows is calculated here, from the file alone, so that it can be done again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.base.bounded_json import without_nan
from bench.record.measured_facts import MeasuredFacts
from calib.errors import (
    CalibrationError,
    DegenerateViews,
    FlickerNotFound,
    StarsUnnamed,
    TargetNotFound,
    TooFewEvents,
    TooFewStars,
)
from calib.events.event_image import ChosenImage, EventImages, make_images
from calib.events.event_times import EventTimes, event_times
from calib.events.flicker import Flicker, first_on_delay_us, flicker_from_times, flicker_from_triggers
from calib.events.grey_image import to_uint8
from calib.events.silent_lines import SilentLines
from calib.model.homography import fit_homography, linear_at
from calib.stars.beam import find_beam
from calib.stars.centring import smooth
from calib.stars.detect import BLUR_PX, detect_stars
from calib.stars.focus import sharpness
from calib.stars.motion import Halves, shift_between_halves
from calib.stars.period import star_steps
from calib.stars.rim import downweight_vignetted, find_rim
from calib.target import StarTarget
from calib.view import View
from drivers.camera.event_arrays import Events, Triggers
from drivers.camera.raw_file import RawFile
from drivers.errors import RecordingFileError

LEAST_LIT = 0.05
"""Share of the sensor's pixels that follow the flicker where stars can be found. Simulated, it is 0.74 at f/2.8, 0.24
at f/13, 0.05 at f/14.5 and 0.003 at f/16; without light, hot pixels alone follow it, whichever way the camera looks."""
_BLURRED, _FLAT = 0.16, 0.04
"""Sharpness (`calib.stars.focus.sharpness`) below which no stars are seen: with the shipped target and lens, it is 0.34
in focus, 0.16 where stars can just be found, and 0.09 far out of focus. Below the second number no picture of the
target is left: 0.03 with the lens at its near stop, and with 5 % of flickering light beside that of the target."""

ExpectedGrid = Callable[[tuple[int, int]], NDArray[np.float64]]
"""Returns, for an image size (width, height) in px, the expected homography of the target's grid: (3, 3) float64, from
[column row 1] to [u v 1] px. Raises DegenerateViews if no prediction is possible."""

_ALIGNED_DEG = 3.0
"""Largest angle to the pixel rows or diagonals at which the errors of star edges count as correlated, degrees. They are
correlated at 0.5 degrees and not at 10 degrees (docs/stars.md)."""

_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
"""How images are compressed: event images are mostly runs of equal values. Fast, and small."""
if hasattr(cv2, "IMWRITE_PNG_FILTER"):  # from OpenCV 4.12 on
    _PNG += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]


class EventData(NamedTuple):
    """Content of a recording."""

    events: Events  # Events, with times from the first event or edge on
    triggers: Triggers  # Trigger edges, with times from the first event or edge on
    size: tuple[int, int]  # Width and height of the sensor, px
    origin_us: int  # Time of the first event or edge by the sensor's clock, us


class WholeImage(NamedTuple):
    """The event image of whole flicker periods."""

    image: NDArray[np.float32]  # (H, W) float32
    halves: Halves | None  # As `EventImages.halves`
    silent: SilentLines = SilentLines()


def read_events(path: Path) -> EventData:
    """Read the events of a RAW file."""
    raw = RawFile.open(path)
    events, triggers = raw.read()
    origin_us = _subtract_origin(events.t, triggers)
    return EventData(events, triggers, (raw.width, raw.height), origin_us)


def whole_image(
    data: EventData,
    image: str,
    periods: int | None,
    expected_hz: float | None,
    facts: MeasuredFacts,
    *,
    one_phase: bool = True,
    compare_flicker: bool = True,
) -> WholeImage:
    """Make the event image of whole flicker periods, of all that the recording holds where None; add to ``facts``.

    ``expected_hz`` None if unknown. ``one_phase``: all pixels' light changes at once, as a lamp's. ``compare_flicker``
    adds what events alone tell.
    """
    events, triggers, size, origin_us = data
    times = event_times(events.t, events.p)
    flicker = _flicker(triggers, times, expected_hz)
    span_us = _span_us(events.t, triggers)
    facts.update(_flicker_facts(flicker, triggers, span_us))
    if compare_flicker:
        facts.update(_compare_flicker(flicker, times))
    images = make_images(*events, size, flicker, window_us=span_us, periods=periods, times=times)
    chosen = _choose(images, image, one_phase=one_phase)
    facts.update(_image_facts(images, chosen, origin_us))
    if flicker.source == "triggers":
        edges_us = flicker.rising_edges_us(*span_us)
        facts["image"]["first_on_delay_us"] = first_on_delay_us(times, edges_us)
    return WholeImage(chosen.image, images.halves, images.silent)


def recorded_image(path: Path, image: str = "auto") -> NDArray[np.float32]:
    """Return the image, of a kind or ``auto``, to search for a board: all whole flicker periods of a recording."""
    data = read_events(path)
    one_phase = len(data.triggers.t) > 0
    return whole_image(data, image, None, None, {}, one_phase=one_phase, compare_flicker=False).image


def _compare_flicker(flicker: Flicker, times: EventTimes) -> MeasuredFacts:
    """Compare the flicker from the triggers with the flicker from the events; empty if there is only one."""
    if flicker.source != "triggers":
        return {}
    band_hz = min(15.0, 0.6 * flicker.frequency_hz), max(1000.0, 1.5 * flicker.frequency_hz)
    try:
        by_events = flicker_from_times(times, band_hz=band_hz)
    except (FlickerNotFound, TooFewEvents):
        return {}
    return {
        "flicker_from_events_hz": by_events.frequency_hz,
        "flicker_disagreement_percent": 100 * abs(by_events.frequency_hz / flicker.frequency_hz - 1.0),
        "flicker_lag_periods": by_events.lag_us(flicker) / flicker.period_us,
    }


def _flicker(triggers: Triggers, times: EventTimes, expected_hz: float | None) -> Flicker:
    """Return the flicker from the sync edges, or from the events if there are no edges."""
    if not len(triggers.t):
        return flicker_from_times(times)
    try:
        return flicker_from_triggers(triggers.t, triggers.value, expected_hz=expected_hz)
    except FlickerNotFound:
        if len(triggers.t) > 2:  # edges that contradict each other are a fault; do not ignore them
            raise
        return flicker_from_times(times)


def _subtract_origin(t: NDArray[np.int64], triggers: Triggers) -> int:
    """Subtract the first time from all times, in place: the sensor's clock continues from recording to recording."""
    origin_us = int(_span_us(t, triggers)[0])
    t -= origin_us
    triggers.t[:] -= origin_us
    return origin_us


def _span_us(t: NDArray[np.int64], triggers: Triggers) -> tuple[float, float]:
    """Return the first and the last time of events and triggers, us."""
    times = [a for a in (t, triggers.t) if len(a)]
    if not times:
        return 0.0, 0.0
    return float(min(a[0] for a in times)), float(max(a[-1] for a in times)) + 1.0


def _flicker_facts(flicker: Flicker, triggers: Triggers, span_us: tuple[float, float]) -> MeasuredFacts:
    facts: MeasuredFacts = {
        "flicker_hz": flicker.frequency_hz,
        "flicker_source": flicker.source,
        "flicker_duty": flicker.duty,
        "triggers_found": int((triggers.value == 1).sum()),
    }
    if flicker.source == "triggers":
        facts["triggers_expected"] = len(flicker.rising_edges_us(*span_us))
        facts["trigger_jitter_us"] = flicker.jitter_us
    return facts


def _choose(images: EventImages, kind: str, *, one_phase: bool = True) -> ChosenImage:
    if kind == "auto":
        return images.best(one_phase=one_phase)
    name = kind.replace("_", "-")
    return ChosenImage(name, images.named(name), "asked for by the sequence")


def _image_facts(images: EventImages, chosen: ChosenImage, origin_us: int) -> MeasuredFacts:
    facts = images.facts
    return {
        "image": {
            "kind": chosen.name,
            "reason": chosen.reason,
            "window_us": [origin_us + facts.start_us, origin_us + facts.end_us],
            "periods": facts.periods,
            "events_per_edge": facts.events_per_edge,
            "events_per_edge_on": facts.events_per_edge_on,
            "events_per_edge_off": facts.events_per_edge_off,
            "lit_pixels": facts.lit_pixels,
            "on_share": facts.on_share,
            "first_on_spread_us": facts.first_on_spread_us,
            "hot_pixels": facts.hot_pixels,
            "silent_rows": facts.silent_rows,
            "silent_columns": facts.silent_columns,
        }
    }


def why_no_target(error: TargetNotFound, facts: MeasuredFacts, whole: NDArray[np.float32]) -> TargetNotFound:
    """Return the error of an image, (H, W), without a target: what is told if it is dark, or out of focus, instead."""
    image = facts.get("image")
    if image is None or image["lit_pixels"] >= LEAST_LIT * whole.size:
        if isinstance(error, StarsUnnamed) or star_steps(smooth(whole, BLUR_PX)) is not None:
            return error  # the print is in focus, whatever else is wrong
        detail = sharpness(whole, find_beam(whole).lit)
        if detail is None or detail >= _BLURRED:
            return error
        if detail < _FLAT:
            return TargetNotFound(
                "The camera sees flickering light, and no picture in it: light of the lamp reaches the lens past the "
                "target, no target is in the collimator, or the lens is far out of focus.",
                where=error.where,
                remedy="Shade the lens from the lamp, look for the target, then focus the lens with `starbench align`.",
            )
        return TargetNotFound(
            "The image is out of focus: the beam is lit, and shows hardly any detail.",
            where=error.where,
            remedy="Focus the lens with `starbench align`. If it is in focus, look whether the target is in the "
            "collimator, and whether fog or dew lies on a lens.",
        )
    pixels = whole.size
    source = "the sync signal comes" if facts.get("flicker_source") == "triggers" else "some events flicker"
    return TargetNotFound(
        f"The picture is dark: {source}, but only {100 * image['lit_pixels'] / pixels:.2g} % of the pixels follow the "
        "light.",
        where=error.where,
        remedy="Check first that the lamp is lit. Then remove the lens cap, open the aperture, raise the light's "
        "level, darken the room, or turn the camera towards the collimator.",
    )


@dataclass(frozen=True)
class StoredImage:
    """An image for people, 8 bits per pixel, compressed without loss; a run keeps one for each of its poses."""

    png: bytes

    @classmethod
    def from_image(cls, image: NDArray[Any]) -> StoredImage:
        """Stretch grey values, (H, W) of any dtype, as `calib.events.grey_image.to_uint8`, and compress them."""
        return cls.from_picture(to_uint8(image))

    @classmethod
    def from_picture(cls, picture: NDArray[np.uint8]) -> StoredImage:
        """Compress grey values, (H, W)."""
        return cls(cv2.imencode(".png", picture, _PNG)[1].tobytes())

    def decoded(self) -> NDArray[np.uint8]:
        """Return the image: (H, W) uint8, grey values."""
        image = cv2.imdecode(np.frombuffer(self.png, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        return np.asarray(image, np.uint8)


@dataclass(frozen=True)
class Measurement:
    """What a recording showed."""

    view: View | None  # The stars; None if none were found, then ``fault`` states why
    # Event image in which the stars were detected; None if it could not be made or was not asked for.
    image: StoredImage | None
    # Numbers for gates, journal and report: image kind and reason, window, periods, events per edge, ON
    # share, hot pixels, flicker frequency and its source, triggers expected and found, motion, what labelled
    # the stars and where their grid lies.
    facts: MeasuredFacts = field(default_factory=MeasuredFacts)
    fault: str = ""  # Why there is no view; empty if there is one

    @property
    def stars(self) -> int:
        """Number of stars found."""
        return 0 if self.view is None else len(self.view)


@dataclass
class Observed:
    """What is known of a recording while its view is looked for: numbers, and the image."""

    facts: MeasuredFacts = field(default_factory=MeasuredFacts)
    image: StoredImage | None = None

    def keep(self, picture: NDArray[np.uint8]) -> None:
        """Keep grey values, (H, W), for people."""
        self.image = StoredImage.from_picture(picture)


def measurement_of(find: Callable[[Observed], View]) -> Measurement:
    """Return what ``find`` finds; a file that cannot be read, or in which it finds no view, gives its fault."""
    seen = Observed()
    try:
        view, fault = find(seen), ""
    except RecordingFileError as error:  # whoever asks names the file
        view, fault = None, f"{error.what} {error.remedy}".strip()
    except CalibrationError as error:
        view, fault = None, str(error)
    return Measurement(view, seen.image, without_nan(seen.facts), fault)


def measure(
    path: Path,
    *,
    name: str,
    target: StarTarget,
    image: str,
    periods: int | None,
    expected_hz: float | None,
    expected_grid: ExpectedGrid | None = None,
    motion: bool = True,
) -> Measurement:
    """Read a recording and find the stars in it; a file that cannot be read or shows no stars gives its fault.

    ``periods`` None stands for all whole ones. ``expected_grid`` is for where the tag does not label the stars. Without
    ``motion``, the shift between the halves, what else only gates and report need is left out, and half the time; the
    view stays the same.
    """

    def find(seen: Observed) -> View:
        facts = seen.facts
        whole = whole_image(read_events(path), image, periods, expected_hz, facts, compare_flicker=motion)
        picture = to_uint8(whole.image)
        if motion:
            seen.keep(picture)
        try:
            view = find_stars(
                whole.image, target, name, expected_grid, facts, edge_width=motion, picture=picture
            )
        except TargetNotFound as error:
            raise why_no_target(error, facts, whole.image) from error
        view = without_crossed(view, whole.silent, np.array(facts["grid"]), target)
        if motion:
            facts["motion_px"] = motion_px(whole.halves, view, target)
        return downweight_vignetted(view, target)

    return measurement_of(find)


def without_crossed(view: View, silent: SilentLines, grid: NDArray[np.float64], target: StarTarget) -> View:
    """Leave out the stars that a silent line crosses: what is interpolated there was not seen.

    ``grid`` is (3, 3), from [column row 1] to [u v 1] px.
    """
    steps = linear_at(grid, target.node_of(view.ids).astype(float))
    reach_px = 0.5 * float(np.median(np.sqrt(np.abs(np.linalg.det(steps)))))
    clear = ~silent.crossed(view.points_px, reach_px)
    return view if clear.all() else view.part(clear)


def find_stars(
    image: NDArray[Any],
    target: StarTarget,
    name: str,
    expected_grid: ExpectedGrid | None,
    facts: MeasuredFacts,
    *,
    edge_width: bool = True,
    picture: NDArray[np.uint8] | None = None,
) -> View:
    """Detect and label the stars of an image, (H, W) of any numeric type, and find the rim of the beam in it.

    ``picture`` is the image by `calib.events.grey_image.to_uint8`, if the caller has it already. If
    neither tag nor expected grid labels the stars, `StarsUnnamed` is raised. ``facts`` gets ``named_by``, ``grid``,
    (3, 3) from [column row 1] to [u v 1] px, ``expected_grid``, and, with ``edge_width``, ``edge_width_px``, the blur
    of the stars' edges.
    """
    try:
        detection = detect_stars(image, target, name=name, picture=picture)
    except StarsUnnamed as unnamed:
        if expected_grid is None:
            raise
        try:
            expected = expected_grid((image.shape[1], image.shape[0]))
        except DegenerateViews as unknown:
            remedy = f"{unnamed.remedy} {unknown}"
            raise StarsUnnamed(unnamed.what, where=unnamed.where, remedy=remedy) from unknown
        detection = detect_stars(image, target, name=name, expected=expected, picture=picture)
        facts["expected_grid"] = expected.tolist()
    grid = fit_homography(target.node_of(detection.view.ids).astype(float), detection.view.points_px)
    facts["named_by"] = "gimbal" if detection.named_by == "expected pose" else detection.named_by
    facts["grid"] = grid.tolist()
    if edge_width:
        facts["edge_width_px"] = detection.edge_width_px
    return replace(detection.view, rim=find_rim(image, detection.view, target))


def aligned_poses(facts: Iterable[MeasuredFacts]) -> int:
    """Count the recordings, by facts of `measure`, whose star edges run along pixels that are fired or silent.

    Errors of neighbouring stars are then correlated, which no star's covariance can express (docs/stars.md).
    """
    return sum(
        edge_angle_deg(np.array(fact["grid"])) < _ALIGNED_DEG
        for fact in facts
        if "grid" in fact and "image" in fact and fact["image"]["kind"] in {"fired-per-edge", "last-polarity"}
    )


def edge_angle_deg(grid: NDArray[np.float64]) -> float:
    """Return the angle between the star edges and the pixel rows or diagonals, whichever is smaller: 0 to 22.5.

    ``grid`` is (3, 3), from [column row 1] to [u v 1] px.

    >>> half = np.radians(50)
    >>> edge_angle_deg(np.array([[np.cos(half), -np.sin(half), 0], [np.sin(half), np.cos(half), 0], [0, 0, 1]]))
    5.0
    """
    # d(u, v)/d(column) at the grid's origin, times the square of grid[2, 2].
    along = grid[:2, 0] * grid[2, 2] - grid[:2, 2] * grid[2, 0]
    direction = np.degrees(np.arctan2(along[1], along[0]))
    return round(float(abs((direction + 22.5) % 45.0 - 22.5)), 6)


def motion_px(halves: Halves | None, view: View, target: StarTarget) -> float | None:
    """Return how far a view's stars moved between the halves of its recording, (H, W) each, px; None if not shown."""
    if halves is None:
        return None
    try:
        return float(np.hypot(*shift_between_halves(*halves, view, target)))
    except TooFewStars:
        return None
