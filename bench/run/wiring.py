"""Self-test of the sync cable: the light flickers slowly, and trigger edges are compared with events.

`check_wiring` switches the light on; its caller asks a person first. Nothing moves. The light is off at every end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.base.clock import BenchClock
from bench.base.errors import UsageError
from bench.measure.camera_kinds import camera_kind, event_camera
from bench.stations.devices import Devices
from bench.stations.station import Station
from drivers.camera.event_arrays import Events, Triggers
from drivers.camera.raw_file import RawFile
from sequences.script import Flicker

FREQUENCY_HZ = 20.0
"""Slow enough for any light and pixel, and far from the 100 and 120 Hz of lamps on the mains."""
DUTY_PERCENT = 25.0
"""Not 50 %: the edges alone then show which of them is the rising one."""
DARK_S = 0.5  # Ten periods
BRIGHT_S = 1.5  # Thirty periods
CHANNEL = 0
"""Trigger channel of the main input."""
_AFTER_EDGE = 0.2
"""Events in this share of a period after an edge are counted: less than the bright part, so that the next edge is
out."""
_MOST_LOST = 0.05  # Share of the edges
_FEWEST_EVENTS = 200  # Ten a bin
_BINS = 20  # Of a period; five are bright
_BURST = 3.0
"""The fullest of ``_BINS`` parts of a period has this many times the mean, where the camera sees the flicker; of noise,
all parts have about the mean."""


@dataclass(frozen=True)
class WiringFault:
    """A fault of the wiring."""

    name: str
    what: str
    remedy: str


@dataclass(frozen=True)
class WiringReport:
    """What the self-test saw."""

    faults: Sequence[WiringFault]  # What is wrong; empty if light, cable and trigger input agree
    seen: str

    def to_dict(self) -> dict[str, Any]:
        """Return the report for JSON output."""
        return {"schema": "starbench/wiring/1", **asdict(self)}


def check_wiring(devices: Devices, station: Station, clock: BenchClock) -> WiringReport:
    """Switch the light on, record, switch it off, and compare edges with events; the light is off at every end."""
    kind = camera_kind(station)
    if kind.name != "event":
        raise UsageError(
            "The wiring test needs an event camera.", remedy="Give a station file with an event camera."
        )
    camera = event_camera(devices.camera)
    devices.light.identify()
    camera.identify()
    kind.prepare(camera)
    flicker = Flicker("square", FREQUENCY_HZ, DUTY_PERCENT, 100.0)
    light = devices.light
    with TemporaryDirectory(prefix="starbench-") as folder:
        dark, bright = Path(folder) / "dark.raw", Path(folder) / "bright.raw"
        try:
            light.off()
            camera.record(dark, DARK_S)
            light.apply(station.light.settings(flicker))
            light.on()
            clock.sleep(0.2)
            camera.record(bright, BRIGHT_S)
        finally:
            with clock.shielded():
                light.off()
        return judge(RawFile.open(dark).triggers(), *RawFile.open(bright).read())


def judge(dark: Triggers, events: Events, edges: Triggers) -> WiringReport:
    """Compare the edges with the events of a flicker of `FREQUENCY_HZ` and `DUTY_PERCENT`."""
    span_s = _span_s(events, edges)
    expected = span_s * FREQUENCY_HZ
    seen = (
        f"{len(events.t)} events and {len(edges.t)} trigger edges in {span_s:.2f} s, {2 * expected:.0f} edges expected;"
        f" {len(dark.t)} edges with the light off"
    )
    if len(edges.t) < 2:
        return WiringReport([_no_edges(events)], seen)
    faults = []
    channels = sorted({int(channel) for channel in edges.id})
    if channels != [CHANNEL]:
        seen_on = ", ".join(map(str, channels))
        faults.append(
            WiringFault(
                "wrong channel",
                f"the trigger edges come on channel {seen_on}, not on channel {CHANNEL}.",
                "Plug the sync cable into the camera's main trigger input.",
            )
        )
    rising, falling = edges.t[edges.value == 1], edges.t[edges.value == 0]
    fault = _level_fault(rising, falling, expected) or _polarity_fault(events, rising, falling)
    if fault is not None:
        faults.append(fault)
    if not _flickers(events):
        faults.append(_no_light())
    return WiringReport(faults, seen)


def _span_s(events: Events, edges: Triggers) -> float:
    times = [column for column in (events.t, edges.t) if len(column)]
    if not times:
        return BRIGHT_S
    return max(BRIGHT_S, float(max(t.max() for t in times) - min(t.min() for t in times)) * 1e-6)


def _flickers(events: Events) -> bool:
    """Return whether the ON events come in bursts at the light's frequency, rather than as noise."""
    on = events.t[events.p == 1]
    if len(on) < _FEWEST_EVENTS:
        return False
    period_us = 1e6 / FREQUENCY_HZ
    counts = np.bincount((on % period_us * (_BINS / period_us)).astype(np.int64), minlength=_BINS)
    return bool(counts.max() > _BURST * counts.mean())


def _no_edges(events: Events) -> WiringFault:
    if not _flickers(events):
        return WiringFault(
            "no light and no trigger",
            "neither events nor trigger edges came.",
            "Check that the light reaches the camera, and its cables.",
        )
    return WiringFault(
        "trigger cable missing",
        "the camera sees the light, but no trigger edge came.",
        "Plug the cable from the light's sync output into the camera's trigger input. If it is there: check that the"
        " sync output is on, and that its level is the one that the camera's trigger input needs.",
    )


def _no_light() -> WiringFault:
    return WiringFault(
        "no light",
        "trigger edges came, but the camera sees no flicker.",
        "Check the lamp, its cable, and that the light reaches the camera; then the polarity can be tested.",
    )


def _level_fault(
    rising: NDArray[np.int64], falling: NDArray[np.int64], expected: float
) -> WiringFault | None:
    """Return a fault of the number of edges: some are lost, or there are others."""
    most = max(len(rising), len(falling))
    if most > (1.0 + _MOST_LOST) * expected + 1.5:
        return WiringFault(
            "wrong source",
            f"{most} pulses came where {expected:.0f} were expected.",
            "Check that the trigger cable comes from the sync output of this light, and that the cable is shielded.",
        )
    fewest = min(len(rising), len(falling))
    if fewest < (1.0 - _MOST_LOST) * expected - 1.5:
        return WiringFault(
            "sync level",
            f"only {len(rising)} rising and {len(falling)} falling edges of {expected:.0f} each came.",
            "Check the level of the sync output against the threshold of the camera's trigger input, and the cable.",
        )
    return None


def _polarity_fault(
    events: Events, rising: NDArray[np.int64], falling: NDArray[np.int64]
) -> WiringFault | None:
    """Return whether edges are inverted, by ON events after them, or where there are none, by the duty cycle."""
    period_us = 1e6 / FREQUENCY_HZ
    on = np.sort(events.t[events.p == 1])
    after_rising = _events_after(on, rising, _AFTER_EDGE * period_us)
    after_falling = _events_after(on, falling, _AFTER_EDGE * period_us)
    if _flickers(events):
        inverted = after_falling > 2.0 * after_rising
        contradiction = f"{after_falling} ON events follow the falling edges, {after_rising} the rising ones"
    else:
        share = _high_share(rising, falling, period_us)
        inverted = abs(share - (1.0 - DUTY_PERCENT / 100.0)) < 0.1
        contradiction = (
            f"the sync line is high for {100.0 * share:.0f} % of a period, not {DUTY_PERCENT:.0f} %"
        )
    if not inverted:
        return None
    return WiringFault(
        "inverted",
        f"the trigger edges are inverted: {contradiction}.",
        "Set the polarity of the light's sync output to normal, or remove the inverter from the cable.",
    )


def _events_after(t: NDArray[np.int64], edges: NDArray[np.int64], within_us: float) -> int:
    counts = np.searchsorted(t, edges + math.ceil(within_us)) - np.searchsorted(t, edges)
    return int(counts.sum())


def _high_share(rising: NDArray[np.int64], falling: NDArray[np.int64], period_us: float) -> float:
    """Return the share of a period between a rising edge and the next falling one."""
    place = np.searchsorted(falling, rising)
    kept = place < len(falling)
    if not kept.any():
        return math.nan
    return float(np.median(falling[place[kept]] - rising[kept])) / period_us
