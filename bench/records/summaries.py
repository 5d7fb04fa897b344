"""What is stated of many runs: the types of ``summary.json`` of a batch, which its writer, page, panel and mail share.

Times are ISO 8601 with their offset. A parameter is in its own unit (`bench.report.text.unit_of`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypedDict

from bench.records.run_facts import EstimateData


class TryData(TypedDict):
    """One attempt at a run of a batch."""

    begun_utc: str
    ended_utc: str
    how: str


class ItemData(TypedDict):
    """A run of a batch; counts are 0 and numbers None where its own journal does not state them."""

    item: str
    job: str
    folder: str  # Below the folder of the batch
    how: str  # As it ended, or else ``cut off``, ``not begun``, ``withdrawn``
    why: str
    attempts: int
    begun_utc: str | None
    ended_utc: str | None
    took_s: float | None  # Of all attempts
    tries: Sequence[TryData]
    report: str | None  # Below the folder of the batch; None where it is not written
    camera: str  # Serial number
    poses: int | None  # Planned; None if the run chooses their number
    accepted: int
    recordings: int
    deviations: int
    temperature_c: float | None
    model: str | None
    rms_px: float | None
    sealed: bool
    parameters: Mapping[str, EstimateData]
    ledger_number: int | None
    ledger_head: str | None
    conformity: str | None  # ``PASS`` or ``FAIL``; None without limits


class TotalsData(TypedDict):
    """Sums over the runs of a batch."""

    runs: int
    by_end: Mapping[str, int]
    attempts: int
    poses: int
    recordings: int
    deviations: int
    hours: float
    working_hours: float


class PointData(TypedDict):
    """A run with a result, as a point of its camera's trends."""

    item: str
    begun_utc: str
    temperature_c: float | None
    parameters: Mapping[str, EstimateData]


class SlopeData(TypedDict):
    """Change of a parameter per hour or per degree Celsius."""

    value: float
    sigma: float
    seen: bool  # Whether it is significant


class TrendData(TypedDict):
    """One parameter of one camera in several runs (`bench.results.trends.Trend`)."""

    name: str
    mean: float
    sigma: float
    coverage_factor: float
    expanded: float
    birge: float
    repeats: bool
    per_hour: SlopeData | None
    per_c: SlopeData | None


class CameraData(TypedDict):
    """The runs with a result of one camera and model, oldest first, and their trends."""

    camera: str  # Serial number
    model: str
    runs: Sequence[PointData]
    parameters: Sequence[TrendData]  # Empty with one run


class RequestData(TypedDict):
    """A request to the batch while it ran."""

    word: str
    by: str
    taken: bool
    why: str
    job: str


class BatchSummary(TypedDict):
    """``summary.json``."""

    schema: str
    queue: str
    zone: str | None  # Of the queue; None for the computer's own
    how: str  # Empty while the batch has not ended
    why: str
    begun_utc: str | None
    ended_utc: str | None
    simulated: bool
    rehearsal: bool
    totals: TotalsData
    items: Sequence[ItemData]  # In the order of their begin, then those not begun, by priority
    cameras: Sequence[CameraData]
    charts: Mapping[str, Any]
    requests: Sequence[RequestData]


def newest_place(items: Iterable[ItemData]) -> tuple[int, str] | None:
    """Return number and hash of the newest run of a batch in the bench's ledger; None if it holds none."""
    places = [
        (item["ledger_number"], item["ledger_head"])
        for item in items
        if item["ledger_number"] is not None and item["ledger_head"]
    ]
    return max(places, default=None)
