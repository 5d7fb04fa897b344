"""From one recording to one view: RAW file, whole flicker periods, event image, stars.

Joins what drivers read with what the engine finds; every number that a gate or a report later shows of a
recording is made here, from the file alone, so that it can be made again from the evidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.records.events import MeasuredFacts
from calib.errors import (
    CalibrationError,
    DegenerateViews,
    FlickerNotFound,
    StarsUnnamed,
    TargetNotFound,
    TooFewEvents,
    TooFewStars,
)
from calib.events.event_image import ChosenImage, EventImages, SliceFacts, make_images
from calib.events.flicker import Flicker, flicker_from_events, flicker_from_triggers
from calib.events.grey_image import to_uint8
from calib.events.motion import half_windows, motion_between
from calib.model.homography import fit_homography
from calib.stars.detect import detect_stars, detect_view
from calib.stars.vignetting import downweight_vignetted
from calib.target import StarTarget
from calib.view import View
from drivers.camera.event_arrays import Events, Triggers
from drivers.camera.raw_file import RawFile
from drivers.errors import RecordingFileError

ExpectedGrid = Callable[[tuple[int, int]], NDArray[np.float64]]
"""Gives, for an image of a width and height, where the target's grid of nodes is expected in it: (3, 3), from
[column row 1] to [u v 1] px. Raises DegenerateViews where that cannot be told."""


_ALIGNED_DEG = 3.0
"""Edges that run along the pixels' rows or diagonals to this angle err alike: at half a degree they do, at ten not."""


@dataclass(frozen=True)
class StoredImage:
    """An image as people see it, 8 bits a pixel, packed without loss: a run keeps one of each of its poses."""

    png: bytes

    @classmethod
    def from_image(cls, image: NDArray[Any]) -> StoredImage:
        """Stretch (`calib.events.grey_image.to_uint8`) and pack an image (H, W)."""
        return cls(cv2.imencode(".png", to_uint8(image), (cv2.IMWRITE_PNG_COMPRESSION, 1))[1].tobytes())

    def decoded(self) -> NDArray[np.uint8]:
        """Give it as (H, W) uint8."""
        shown = cv2.imdecode(np.frombuffer(self.png, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert shown is not None
        return np.asarray(shown, np.uint8)


@dataclass(frozen=True)
class Measurement:
    """What a recording showed.

    Attributes
    ----------
    view
        The stars; None where none were found, ``fault`` then says why.
    image
        The event image the stars were looked for in; None where it could not be made.
    facts
        Plain numbers for gates, journal and report: image kind and reason, window, periods, events per edge, ON
        share, hot pixels, flicker frequency and where it comes from, triggers expected and found, motion, what named
        the stars and where their grid lies.
    fault
        Why there is no view; empty when there is one.
    """

    view: View | None
    image: StoredImage | None
    facts: MeasuredFacts = field(default_factory=MeasuredFacts)
    fault: str = ""

    @property
    def stars(self) -> int:
        """Number of stars found."""
        return 0 if self.view is None else len(self.view)


def measure(
    path: Path,
    *,
    name: str,
    target: StarTarget,
    image: str,
    periods: int | None,
    expected_hz: float | None,
    expect: ExpectedGrid | None = None,
) -> Measurement:
    """Read a recording and find the stars in it.

    Parameters
    ----------
    path
        RAW file.
    name
        The pose's name.
    target
        The printed target.
    image
        Kind of event image, or ``auto``.
    periods
        Whole flicker periods to gather; None for as many as the recording holds.
    expected_hz
        What the light was set to; None when unknown.
    expect
        Where the pose lets the stars be expected; asked only where the tag does not tell which they are.

    Returns
    -------
    Measurement
        Also when the file cannot be read or no stars are found: the fault then says why.
    """
    facts: MeasuredFacts = {}
    picture: StoredImage | None = None
    try:
        raw = RawFile.open(path)
        size = raw.width, raw.height
        events, triggers = raw.read()
        origin_us = _subtract_origin(events.t, triggers)
        flicker = _flicker(triggers, (events.t, events.p), expected_hz)
        span_us = _span_us(events.t, triggers)
        facts.update(_flicker_facts(flicker, triggers, span_us))
        facts.update(_compare_flicker(flicker, events))
        images = make_images(*_event_arrays(events), size, flicker, window_us=span_us, periods=periods)
        chosen = _choose(images, image)
        picture = StoredImage.from_image(chosen.image)
        facts.update(_image_facts(images, chosen, origin_us))
        view = downweight_vignetted(find_stars(chosen.image, target, name, expect, facts), target)
        halves = _half_images(events, size, flicker, images.facts, chosen.name)
        facts["motion_px"] = motion_px(halves, target, facts)
    except (CalibrationError, RecordingFileError) as error:
        return Measurement(None, picture, _without_nan(facts), str(error))
    return Measurement(view, picture, _without_nan(facts))


def find_stars(
    image: NDArray[Any], target: StarTarget, name: str, expect: ExpectedGrid | None, facts: MeasuredFacts
) -> View:
    """Find the stars of an image, by the expected pose where the tag does not name them.

    What named them goes into ``facts``: ``named_by`` (``tag``, ``part of the tag``, ``gimbal``), ``grid``, where the
    view's grid lies, (3, 3) from [column row 1] to [u v 1] px as lists, and ``expected_grid``, as it was expected.

    Raises
    ------
    CalibrationError
        When there are no stars, or nothing says which they are.
    """
    try:
        seen = detect_stars(image, target, name=name)
    except StarsUnnamed as unnamed:
        if expect is None:
            raise
        try:
            expected = expect((image.shape[1], image.shape[0]))
        except DegenerateViews as unknown:
            raise StarsUnnamed(unnamed.what, where=unnamed.where, remedy=str(unknown)) from unknown
        seen = detect_stars(image, target, name=name, expected=expected)
        facts["expected_grid"] = expected.tolist()
    grid = fit_homography(target.node_of(seen.view.ids).astype(float), seen.view.points_px)
    facts["named_by"] = "gimbal" if seen.named_by == "expected pose" else seen.named_by
    facts["grid"] = grid.tolist()
    return seen.view


def aligned_poses(facts: Iterable[MeasuredFacts]) -> int:
    """Count the recordings whose stars have edges along the pixels, in an image of fired and silent pixels.

    Such an edge crosses all pixels of a row at one place, and neighbouring stars err alike: more than a star's own
    covariance can say (docs/stars.md).

    Parameters
    ----------
    facts
        Of recordings, as `measure` gives them.
    """
    return sum(
        edge_angle_deg(np.array(one["grid"])) < _ALIGNED_DEG
        for one in facts
        if "grid" in one and one["image"]["kind"] in {"fired-per-edge", "last-polarity"}
    )


def edge_angle_deg(grid: NDArray[np.float64]) -> float:
    """Angle between the stars' edges and the pixels' rows or diagonals, whichever are nearer.

    Parameters
    ----------
    grid
        (3, 3) from [column row 1] to [u v 1] px.

    Examples
    --------
    >>> half = np.radians(50)
    >>> edge_angle_deg(np.array([[np.cos(half), -np.sin(half), 0], [np.sin(half), np.cos(half), 0], [0, 0, 1]]))
    5.0
    """
    along = (
        grid[:2, 0] * grid[2, 2] - grid[:2, 2] * grid[2, 0]
    )  # d(u, v)/d(column) at the grid's origin, scaled
    direction = np.degrees(np.arctan2(along[1], along[0]))
    return round(float(abs((direction + 22.5) % 45.0 - 22.5)), 6)


def _compare_flicker(flicker: Flicker, events: Events) -> MeasuredFacts:
    """Hold the flicker by the triggers against the one that the events tell; nothing where there is only one."""
    if flicker.source != "triggers":
        return {}
    try:
        told = flicker_from_events(events.t, events.p)
    except (FlickerNotFound, TooFewEvents):
        return {}
    return {
        "flicker_from_events_hz": told.frequency_hz,
        "flicker_disagreement_percent": 100 * abs(told.frequency_hz / flicker.frequency_hz - 1.0),
        "flicker_lag_periods": told.lag_us(flicker) / flicker.period_us,
    }


def _event_arrays(
    events: Events,
) -> tuple[NDArray[np.int64], NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint8]]:
    """Times, columns, rows and polarities, as images are made of them."""
    return events.t, events.x, events.y, events.p


def _half_images(
    events: Events, size: tuple[int, int], flicker: Flicker, whole: SliceFacts, kind: str
) -> Iterator[NDArray[np.float32]]:
    """Images of the first and the second half; raises TooFewEvents where there are none."""
    for half in half_windows(whole):
        yield make_images(*_event_arrays(events), size, flicker, window_us=half).named(kind)


def motion_px(halves: Iterable[NDArray[Any]], target: StarTarget, facts: MeasuredFacts) -> float | None:
    """Length of the stars' shift from the first half of a recording to the second; None where halves cannot tell.

    Parameters
    ----------
    halves
        Images of the two halves.
    target
        The printed target.
    facts
        With the ``grid`` of the whole recording, by which stars without the tag are named.
    """
    grid = np.array(facts["grid"])
    try:
        first, second = (detect_view(half, target, name="half", expected=grid) for half in halves)
        return motion_between(first, second).length_px
    except (TooFewEvents, TooFewStars, TargetNotFound):
        return None


def _without_nan(facts: Any) -> Any:
    """Put None where a number could not be told: what was not measured is not a number, in JSON either."""
    if isinstance(facts, dict):
        return {name: _without_nan(fact) for name, fact in facts.items()}
    if isinstance(facts, list):
        return [_without_nan(fact) for fact in facts]
    return None if isinstance(facts, float) and not math.isfinite(facts) else facts


def _flicker(
    triggers: Triggers, events: tuple[NDArray[np.int64], NDArray[np.uint8]], expected_hz: float | None
) -> Flicker:
    """Take the flicker from the sync edges, or from the events where there are none."""
    if not len(triggers.t):
        return flicker_from_events(*events)
    try:
        return flicker_from_triggers(triggers.t, triggers.value, expected_hz=expected_hz)
    except FlickerNotFound:
        if len(triggers.t) > 2:  # edges that contradict each other are a fault, not a reason to do without
            raise
        return flicker_from_events(*events)


def _subtract_origin(t: NDArray[np.int64], triggers: Triggers) -> int:
    """Count times, in place, from the first event or edge; return its own.

    The sensor's clock goes on from recording to recording: what stands in one is not to depend, by the last digits
    of its numbers, on how many were made before.
    """
    origin_us = int(_span_us(t, triggers)[0])
    t -= origin_us
    triggers.t[:] -= origin_us
    return origin_us


def _span_us(t: NDArray[np.int64], triggers: Triggers) -> tuple[float, float]:
    """Sensor time covered: events and triggers; nothing is known of the time before and after."""
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


def _choose(images: EventImages, kind: str) -> ChosenImage:
    if kind == "auto":
        return images.best()
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
        }
    }
