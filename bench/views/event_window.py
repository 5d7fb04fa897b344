"""From one recording of events to the event image of whole flicker periods. It knows no target."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.records.events import MeasuredFacts
from calib.errors import FlickerNotFound, TooFewEvents
from calib.events.event_image import ChosenImage, EventImages, SliceFacts, half_windows, make_images
from calib.events.flicker import Flicker, flicker_from_events, flicker_from_triggers
from drivers.camera.event_arrays import Events, Triggers
from drivers.camera.raw_file import RawFile


class EventData(NamedTuple):
    """Content of a recording."""

    # events, triggers: Events and trigger edges, times from the first of them on.
    events: Events
    triggers: Triggers
    size: tuple[int, int]  # Width and height of the sensor, px
    origin_us: int  # Time of the first event or edge by the sensor's clock, us


class WholeImage(NamedTuple):
    """The event image of whole flicker periods."""

    image: NDArray[np.float32]  # (H, W) float32
    # Returns images of the same kind of the first and the second half of the periods; raises TooFewEvents if
    # there are too few.
    halves: Callable[[], Iterator[NDArray[np.float32]]]


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
    flicker = _flicker(triggers, (events.t, events.p), expected_hz)
    span_us = _span_us(events.t, triggers)
    facts.update(_flicker_facts(flicker, triggers, span_us))
    if compare_flicker:
        facts.update(_compare_flicker(flicker, events))
    images = make_images(*_event_arrays(events), size, flicker, window_us=span_us, periods=periods)
    chosen = _choose(images, image, one_phase=one_phase)
    facts.update(_image_facts(images, chosen, origin_us))
    halves = partial(_half_images, events, size, flicker, images.facts, chosen.name)
    return WholeImage(chosen.image, halves)


def recorded_image(path: Path, image: str = "auto") -> ChosenImage:
    """Return the image, of a kind or ``auto``, to search for a board: all whole flicker periods of a recording."""
    events, triggers, size, _ = read_events(path)
    flicker = _flicker(triggers, (events.t, events.p), None)
    span_us = _span_us(events.t, triggers)
    images = make_images(*_event_arrays(events), size, flicker, window_us=span_us)
    return _choose(images, image, one_phase=len(triggers.t) > 0)


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
    """Subtract the first time from all, in place: the sensor's clock goes on, and must not change the last digits."""
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
        }
    }
