"""From one recording to one view: RAW file, whole flicker periods, event image, stars.

Joins what drivers read with what the engine finds; every number that a gate or a report later shows of a
recording is made here, from the file alone, so that it can be made again from the evidence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.detect import Sight, detect, look
from calib.errors import CalibrationError, FlickerNotFound, TargetNotFound, TooFewEvents, TooFewStars
from calib.event_image import BestImage, EventImages, SliceFacts, make_images
from calib.flicker import Flicker, flicker_from_events, flicker_from_triggers
from calib.grid_map import fit_homography
from calib.motion import half_windows, motion_between
from calib.rim import mistrust_rim
from calib.target import StarTarget
from calib.view import View
from drivers.camera.evt3 import Events, Triggers
from drivers.camera.raw_file import RawFile
from drivers.errors import RecordingFileError


@dataclass(frozen=True)
class Measurement:
    """What a recording showed.

    Attributes
    ----------
    view
        The stars; None where none were found, ``fault`` then says why.
    image
        (H, W) float32, the event image the stars were looked for in; None where it could not be made.
    facts
        Plain numbers for gates, journal and report: image kind and reason, window, periods, events per edge, ON
        share, hot pixels, flicker frequency and where it comes from, triggers expected and found, motion, what named
        the stars and where their grid lies.
    fault
        Why there is no view; empty when there is one.
    """

    view: View | None
    image: NDArray[np.float32] | None
    facts: Mapping[str, Any] = field(default_factory=dict)
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
    expected_grid: NDArray[np.float64] | None = None,
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
    expected_grid
        Where the pose lets the grid of stars be expected (`calib.detect`), for stars without the tag.

    Returns
    -------
    Measurement
        Also when the file cannot be read or no stars are found: the fault then says why.
    """
    facts: dict[str, Any] = {}
    picture: NDArray[np.float32] | None = None
    try:
        raw = RawFile.open(path)
        events, triggers = raw.read()
        flicker = _flicker(triggers, (events.t, events.p), expected_hz)
        span_us = _span_us(events.t, triggers)
        facts.update(_flicker_facts(flicker, triggers, span_us))
        facts.update(_agreement(flicker, events))
        images = make_images(
            events.t,
            events.x,
            events.y,
            events.p,
            (raw.width, raw.height),
            flicker,
            window_us=span_us,
            periods=periods,
        )
        chosen = _choose(images, image)
        picture = chosen.image
        facts.update(_image_facts(images, chosen))
        seen = look(chosen.image, target, name=name, expected=expected_grid)
        facts.update(identity_facts(seen, target))
        view = mistrust_rim(seen.view, target)
        facts["motion_px"] = _motion_px(
            events, (raw.width, raw.height), flicker, images.facts, chosen.name, target
        )
    except (CalibrationError, RecordingFileError) as error:
        return Measurement(None, picture, _plain(facts), str(error))
    return Measurement(view, picture, _plain(facts))


def identity_facts(seen: Sight, target: StarTarget) -> dict[str, Any]:
    """Say what named the stars, and where their grid lies: (3, 3), from [column row 1] to [u v 1] px, as lists."""
    grid = fit_homography(target.node_of(seen.view.ids).astype(float), seen.view.points_px)
    return {"named_by": seen.named_by, "grid": grid.tolist()}


def _agreement(flicker: Flicker, events: Events) -> dict[str, Any]:
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


def _motion_px(
    events: Events,
    size: tuple[int, int],
    flicker: Flicker,
    whole: SliceFacts,
    kind: str,
    target: StarTarget,
) -> float | None:
    """Length of the stars' shift from the first half of a window to the second; None where halves cannot tell."""
    try:
        first, second = (
            detect(
                make_images(events.t, events.x, events.y, events.p, size, flicker, window_us=half).named(
                    kind
                ),
                target,
                name="half",
            )
            for half in half_windows(whole)
        )
        return motion_between(first, second).length_px
    except (TooFewEvents, TooFewStars, TargetNotFound):
        return None


def _plain(facts: Any) -> Any:
    """Put None where a number could not be told: what was not measured is not a number, in JSON either."""
    if isinstance(facts, dict):
        return {name: _plain(fact) for name, fact in facts.items()}
    if isinstance(facts, list):
        return [_plain(fact) for fact in facts]
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


def _span_us(t: NDArray[np.int64], triggers: Triggers) -> tuple[float, float]:
    """Sensor time covered: events and triggers; nothing is known of the time before and after."""
    times = [a for a in (t, triggers.t) if len(a)]
    if not times:
        return 0.0, 0.0
    return float(min(a[0] for a in times)), float(max(a[-1] for a in times)) + 1.0


def _flicker_facts(flicker: Flicker, triggers: Triggers, span_us: tuple[float, float]) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "flicker_hz": flicker.frequency_hz,
        "flicker_source": flicker.source,
        "flicker_duty": flicker.duty,
        "triggers_found": int((triggers.value == 1).sum()),
    }
    if flicker.source == "triggers":
        facts["triggers_expected"] = len(flicker.rising_edges_us(*span_us))
        facts["trigger_jitter_us"] = flicker.jitter_us
    return facts


def _choose(images: EventImages, kind: str) -> BestImage:
    if kind == "auto":
        return images.best()
    name = kind.replace("_", "-")
    return BestImage(name, images.named(name), "asked for by the sequence")


def _image_facts(images: EventImages, chosen: BestImage) -> dict[str, Any]:
    facts = images.facts
    return {
        "image": {
            "kind": chosen.name,
            "reason": chosen.reason,
            "window_us": [facts.start_us, facts.end_us],
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
