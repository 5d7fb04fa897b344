"""From one recording to one view: RAW file, whole flicker periods, event image, stars.

This module joins the drivers' readers and the calibration engine. Every number that a gate or the report shows about
a recording is calculated here, from the file alone, so that it can be calculated again from the evidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.records.events import MeasuredFacts
from bench.views.stored_image import StoredImage
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
from calib.events.motion import half_windows, motion_between
from calib.model.homography import fit_homography
from calib.stars.detect import detect_stars, detect_view
from calib.stars.rim import find_rim
from calib.stars.vignetting import downweight_vignetted
from calib.target import StarTarget
from calib.view import View
from drivers.camera.event_arrays import Events, Triggers
from drivers.camera.raw_file import RawFile
from drivers.errors import RecordingFileError

ExpectedGrid = Callable[[tuple[int, int]], NDArray[np.float64]]
"""Returns, for an image size (width, height) in px, the expected homography of the target's grid: (3, 3) float64, from
[column row 1] to [u v 1] px. Raises DegenerateViews if no prediction is possible."""


_ALIGNED_DEG = 3.0
"""Largest angle to the pixel rows or diagonals at which the errors of star edges count as correlated, degrees. They are
correlated at 0.5 degrees and not at 10 degrees (docs/stars.md)."""


@dataclass(frozen=True)
class Measurement:
    """What a recording showed.

    Attributes
    ----------
    view
        The stars; None if none were found, then ``fault`` states why.
    image
        Event image in which the stars were detected; None if it could not be made.
    facts
        Numbers for gates, journal and report: image kind and reason, window, periods, events per edge, ON
        share, hot pixels, flicker frequency and its source, triggers expected and found, motion, what
        labelled the stars and where their grid lies.
    fault
        Why there is no view; empty if there is one.
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
    expected_grid: ExpectedGrid | None = None,
) -> Measurement:
    """Read a recording and find the stars in it.

    Parameters
    ----------
    path
        RAW file.
    name
        Name of the pose.
    target
        The printed target.
    image
        Kind of event image, or ``auto``.
    periods
        Number of whole flicker periods to use; None for all that the recording holds.
    expected_hz
        Nominal frequency of the flicker, Hz; None if unknown.
    expected_grid
        Predicts where the stars lie; used only if the tag does not label them.

    Returns
    -------
    Measurement
        Also if the file cannot be read or shows no stars; then it holds the fault.
    """
    facts: MeasuredFacts = {}
    stored: StoredImage | None = None
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
        stored = StoredImage.from_image(chosen.image)
        facts.update(_image_facts(images, chosen, origin_us))
        view = downweight_vignetted(find_stars(chosen.image, target, name, expected_grid, facts), target)
        halves = _half_images(events, size, flicker, images.facts, chosen.name)
        facts["motion_px"] = motion_px(halves, target, facts)
    except (CalibrationError, RecordingFileError) as error:
        return Measurement(None, stored, _without_nan(facts), str(error))
    return Measurement(view, stored, _without_nan(facts))


def recorded_image(path: Path, image: str = "auto") -> ChosenImage:
    """Return the event image of a recording, of whole flicker periods.

    Parameters
    ----------
    path
        RAW file.
    image
        Kind of event image, or ``auto``.

    Returns
    -------
    ChosenImage
        The image that `measure` would use.

    Raises
    ------
    calib.errors.CalibrationError
        If the events show no flicker, or are too few.
    drivers.errors.RecordingFileError
        If the file cannot be read.
    """
    raw = RawFile.open(path)
    events, triggers = raw.read()
    _subtract_origin(events.t, triggers)
    flicker = _flicker(triggers, (events.t, events.p), None)
    span_us = _span_us(events.t, triggers)
    images = make_images(*_event_arrays(events), (raw.width, raw.height), flicker, window_us=span_us)
    return _choose(images, image)


def find_stars(
    image: NDArray[Any],
    target: StarTarget,
    name: str,
    expected_grid: ExpectedGrid | None,
    facts: MeasuredFacts,
) -> View:
    """Detect and label the stars of an image, and find the rim of the beam in it.

    The expected grid is used if the tag does not label the stars.

    Four facts are added to ``facts``: ``named_by`` (``tag``, ``part of the tag`` or ``gimbal``), ``grid``,
    the homography of the view's grid, (3, 3) from [column row 1] to [u v 1] px as lists,
    ``expected_grid``, the one that was expected, and ``edge_width_px``, the blur of the stars' edges, px.

    Parameters
    ----------
    image
        (H, W), any numeric dtype, grey values.
    target
        The printed target.
    name
        Name of the pose.
    expected_grid
        Predicts where the stars lie; None if no prediction is available.
    facts
        Changed in place.

    Returns
    -------
    View
        The stars and the rim.

    Raises
    ------
    StarsUnnamed
        If neither the tag nor the expected grid labels the stars.
    CalibrationError
        If no stars are found.
    """
    try:
        detection = detect_stars(image, target, name=name)
    except StarsUnnamed as unnamed:
        if expected_grid is None:
            raise
        try:
            expected = expected_grid((image.shape[1], image.shape[0]))
        except DegenerateViews as unknown:
            raise StarsUnnamed(unnamed.what, where=unnamed.where, remedy=str(unknown)) from unknown
        detection = detect_stars(image, target, name=name, expected=expected)
        facts["expected_grid"] = expected.tolist()
    grid = fit_homography(target.node_of(detection.view.ids).astype(float), detection.view.points_px)
    facts["named_by"] = "gimbal" if detection.named_by == "expected pose" else detection.named_by
    facts["grid"] = grid.tolist()
    facts["edge_width_px"] = detection.edge_width_px
    return replace(detection.view, rim=find_rim(image, detection.view, target))


def aligned_poses(facts: Iterable[MeasuredFacts]) -> int:
    """Count the recordings whose star edges run along the pixels, in an image of fired and silent pixels.

    Such an edge crosses all pixels of a row at the same place, so the errors of neighbouring stars are
    correlated. The covariance of a single star cannot express this (docs/stars.md).

    Parameters
    ----------
    facts
        Facts of recordings, as `measure` returns them.

    Returns
    -------
    int
        Number of such recordings.
    """
    return sum(
        edge_angle_deg(np.array(one["grid"])) < _ALIGNED_DEG
        for one in facts
        if "grid" in one and one["image"]["kind"] in {"fired-per-edge", "last-polarity"}
    )


def edge_angle_deg(grid: NDArray[np.float64]) -> float:
    """Return the angle between the star edges and the pixel rows or diagonals, whichever is smaller.

    Parameters
    ----------
    grid
        (3, 3) float64, from [column row 1] to [u v 1] px.

    Returns
    -------
    float
        Angle, degrees, 0 to 22.5.

    Examples
    --------
    >>> half = np.radians(50)
    >>> edge_angle_deg(np.array([[np.cos(half), -np.sin(half), 0], [np.sin(half), np.cos(half), 0], [0, 0, 1]]))
    5.0
    """
    # d(u, v)/d(column) at the grid's origin, times the square of grid[2, 2].
    along = grid[:2, 0] * grid[2, 2] - grid[:2, 2] * grid[2, 0]
    direction = np.degrees(np.arctan2(along[1], along[0]))
    return round(float(abs((direction + 22.5) % 45.0 - 22.5)), 6)


def _compare_flicker(flicker: Flicker, events: Events) -> MeasuredFacts:
    """Compare the flicker from the triggers with the flicker from the events; empty if there is only one."""
    if flicker.source != "triggers":
        return {}
    try:
        by_events = flicker_from_events(events.t, events.p, band_hz=_band_hz(flicker.frequency_hz))
    except (FlickerNotFound, TooFewEvents):
        return {}
    return {
        "flicker_from_events_hz": by_events.frequency_hz,
        "flicker_disagreement_percent": 100 * abs(by_events.frequency_hz / flicker.frequency_hz - 1.0),
        "flicker_lag_periods": by_events.lag_us(flicker) / flicker.period_us,
    }


def _band_hz(frequency_hz: float) -> tuple[float, float]:
    """Return the lowest and the highest frequency, Hz, at which the events are searched for a flicker of one."""
    return min(15.0, 0.6 * frequency_hz), max(1000.0, 1.5 * frequency_hz)


def _event_arrays(
    events: Events,
) -> tuple[NDArray[np.int64], NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint8]]:
    """Return times, columns, rows and polarities."""
    return events.t, events.x, events.y, events.p


def _half_images(
    events: Events, size: tuple[int, int], flicker: Flicker, whole: SliceFacts, kind: str
) -> Iterator[NDArray[np.float32]]:
    """Yield images of the first and the second half. Raises TooFewEvents if there are too few."""
    for half in half_windows(whole):
        yield make_images(*_event_arrays(events), size, flicker, window_us=half).named(kind)


def motion_px(halves: Iterable[NDArray[Any]], target: StarTarget, facts: MeasuredFacts) -> float | None:
    """Return the length of the stars' shift from the first half of a recording to the second.

    Parameters
    ----------
    halves
        Images of the two halves, each (H, W), grey values.
    target
        The printed target.
    facts
        Facts of the whole recording; its ``grid`` labels the stars if the tag cannot.

    Returns
    -------
    float or None
        Length, px; None if the halves do not show it.
    """
    grid = np.array(facts["grid"])
    try:
        first, second = (detect_view(half, target, name="half", expected=grid) for half in halves)
        return motion_between(first, second).length_px
    except (TooFewEvents, TooFewStars, TargetNotFound):
        return None


def _without_nan(facts: Any) -> Any:
    """Replace numbers that are not finite by None, because JSON has none."""
    if isinstance(facts, dict):
        return {name: _without_nan(fact) for name, fact in facts.items()}
    if isinstance(facts, list):
        return [_without_nan(fact) for fact in facts]
    return None if isinstance(facts, float) and not math.isfinite(facts) else facts


def _flicker(
    triggers: Triggers, events: tuple[NDArray[np.int64], NDArray[np.uint8]], expected_hz: float | None
) -> Flicker:
    """Return the flicker from the sync edges, or from the events if there are no edges."""
    if not len(triggers.t):
        return flicker_from_events(*events)
    try:
        return flicker_from_triggers(triggers.t, triggers.value, expected_hz=expected_hz)
    except FlickerNotFound:
        if len(triggers.t) > 2:  # edges that contradict each other are a fault; do not ignore them
            raise
        return flicker_from_events(*events)


def _subtract_origin(t: NDArray[np.int64], triggers: Triggers) -> int:
    """Subtract the time of the first event or edge from all times, in place; return it.

    The sensor's clock continues from recording to recording. Without this, the last digits of a recording's
    numbers would depend on how many recordings were made before.
    """
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
