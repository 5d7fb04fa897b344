"""What was measured in a recording, as its journal line carries it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import (
    Literal,
    NotRequired,  # pydantic checks these types, on Python 3.11 too
)

from typing_extensions import TypedDict


class GateData(TypedDict):
    """One quality gate as judged (`bench.measure.gates.Gate`)."""

    name: str
    value: int | float
    unit: str
    limit: str
    verdict: str
    # In results.json, for a gate of a recording: its name among the gates, and the pose. ``name`` names both.
    gate: NotRequired[str]
    pose: NotRequired[int]


class ImageFacts(TypedDict, total=False):
    """The image in which the stars of a recording were found: of events, or the mean of ``pictures`` frames."""

    kind: str
    reason: str
    pictures: int
    window_us: Sequence[float]
    periods: int
    events_per_edge: float | None
    events_per_edge_on: float | None
    events_per_edge_off: float | None
    lit_pixels: int
    on_share: float | None
    first_on_spread_us: float | None
    first_on_delay_us: float | None
    hot_pixels: int
    silent_rows: int
    silent_columns: int


class MeasuredFacts(TypedDict, total=False):
    """Numbers measured in a recording; a number that could not be measured is absent or None."""

    image: ImageFacts
    flicker_hz: float
    flicker_source: Literal["triggers", "events"]
    flicker_duty: float | None
    triggers_found: int
    triggers_expected: int
    trigger_jitter_us: float | None
    flicker_from_events_hz: float
    flicker_disagreement_percent: float
    flicker_lag_periods: float
    named_by: str
    grid: Sequence[Sequence[float]]
    edge_width_px: float | None
    expected_grid: Sequence[Sequence[float]]
    motion_px: float | None


class RecordingCounts(TypedDict, total=False):
    """What was counted in a recording, of events or of frames."""

    events: int
    triggers: int
    duration_s: float
    event_rate_mev_s: float | None
    temperature_c: float | None
    pictures: int
    bits: int
    saturated_percent: float
