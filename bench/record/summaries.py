"""What is stated of many runs: the types of ``summary.json`` of a batch and of control charts, shared by all readers.

Times are ISO 8601 with the offset from UTC. `bench.wording.parameters.unit_of` gives the unit of each parameter.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, Literal, NotRequired, TypedDict, TypeGuard

from bench.record.coverage import EstimateData

IN_PROGRESS: Final = "in progress"
WITHOUT_END: Final = frozenset({IN_PROGRESS, "not begun", "withdrawn"})
"""What `ItemData.how` states of a run that has not ended."""
EwmaData = TypedDict(
    "EwmaData",
    {
        "lambda": float,  # Weight of the newest value
        "limit": float,  # Distance of the limits in standard deviations of the average (L)
        "values": Sequence[float],  # The average at each value, as its control limits
        "lower": Sequence[float],
        "upper": Sequence[float],
        "beyond": Sequence[int],  # Places at which the average is beyond its limits
    },
)
"""Chart of the exponentially weighted moving average (`bench.charts.statistics.ewma`); places count from 0."""

ChartState = Literal["out of control", "check", "in control", "too few"]
"""Worst first; chance can explain ``check``."""


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
    how: str  # As it ended, or else ``in progress``, ``cut off``, ``not begun``, ``withdrawn``
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
    goals_missed: Sequence[str]  # Each ``until`` that ended without its goals, as sentences
    # What a person did to the bench, as sentences, the most probable first; an earlier version kept none.
    causes: NotRequired[Sequence[str]]


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


class AgreedData(TypedDict):
    """One parameter of one camera in several runs (`bench.solve.agreement.agreement`)."""

    name: str
    mean: float  # Weighted by 1 / sigma^2, in the parameter's unit
    sigma: float  # Standard uncertainty of the mean
    coverage_factor: float  # The largest of the runs
    expanded: float
    # Birge ratio sqrt(chi^2 / (n - 1)) with what is not shared. It is about 1 if the runs scatter as their
    # uncertainties predict, larger if the camera or the bench changed between runs, and smaller if what limits a run
    # repeats in the next.
    birge: float
    repeats: bool  # Whether the runs agree far better than their uncertainties say
    # For each run, its difference from the mean divided by the standard uncertainty of this difference.
    deviations: Sequence[float]


class CameraData(TypedDict):
    """The runs with a result of one camera and model, and their means."""

    camera: str  # Serial number
    model: str
    runs: int
    parameters: Sequence[AgreedData]  # Empty with one run


class RequestData(TypedDict):
    """A request to the batch while it ran."""

    word: str
    by: str
    taken: bool
    why: str
    job: str


class TestedSlope(TypedDict):
    """Slope of a parameter per day or per degree Celsius, in its unit, and its test."""

    value: float
    sigma: float  # Standard uncertainty
    p: float  # Chance of a slope at least as large without drift (two-sided)
    degrees_of_freedom: int  # Of Student's t in the test
    runs: int
    expanded: float  # The 95 % half-width by Student's t


class DriftSlopeData(TestedSlope):
    """A slope as a page of charts judges it."""

    p_adjusted: float  # For the number of tests of the page
    seen: bool  # Whether it is significant
    text: str  # With its uncertainty, and with its unit per ``per``
    per: str


class DriftData(TypedDict):
    """Drift of a parameter (`bench.charts.statistics.Drift`)."""

    per_day: DriftSlopeData | None  # None if it cannot be tested, as per degree Celsius
    per_c: DriftSlopeData | None
    joint: bool
    separable: bool
    between_runs: float | None
    scatter: float | None


class LimitsData(TypedDict):
    """Chart of individuals; places count from 0."""

    lower: float
    upper: float
    centre: float  # Mean of the baseline
    sigma: float  # Its short-term standard deviation: mean moving range over `bench.charts.statistics.D2`
    beyond: Sequence[int]  # Places of the values beyond the limits
    baseline: int


class ChartValues(TypedDict):
    """A parameter in each run of a group, in its order."""

    name: str
    unit: str  # Empty for a pure number
    meaning: str
    values: Sequence[float]
    sigmas: Sequence[float]
    expanded: Sequence[float]


class ChartJudgement(TypedDict):
    """What is said of a chart."""

    drift: DriftData
    state: ChartState
    verdict: str


class ChartOfFew(ChartValues, ChartJudgement):
    """Control chart of a parameter with too few runs for limits."""

    lower: None
    upper: None
    ewma: None
    provisional: bool


class LimitedChart(ChartValues, LimitsData, ChartJudgement):
    """Control chart of a parameter with its limits."""

    ewma: EwmaData
    provisional: bool  # Whether the limits come from few runs


ChartData = LimitedChart | ChartOfFew


class ChartRunData(TypedDict):
    """A run in a group of charts."""

    run: str
    serial: str
    begun_utc: str
    temperature_c: float | None


class ChartGroupData(TypedDict):
    """The charts of runs that can be compared, of one camera or of all of a type."""

    level: Literal["camera", "type"]
    kind: str  # ``measured``, ``simulated`` or ``rehearsed``
    bench: str
    station: str
    camera_type: str
    serial: str  # Empty for a type
    collimator: str
    target: str
    model: str
    cameras: int
    runs: Sequence[ChartRunData]  # Oldest first
    parameters: Sequence[ChartData]
    title: str
    place: str
    state: ChartState  # The worst of the parameters
    verdict: str


class ChartsData(TypedDict):
    """All charts of a page, judged together."""

    schema: str
    level: float  # Chance of one false drift or more
    groups: Sequence[ChartGroupData]


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
    charts: ChartsData
    requests: Sequence[RequestData]


def newest_place(items: Iterable[ItemData]) -> tuple[int, str] | None:
    """Return number and hash of the newest run of a batch in the bench's ledger; None if it holds none."""
    places = [
        (item["ledger_number"], item["ledger_head"])
        for item in items
        if item["ledger_number"] is not None and item["ledger_head"]
    ]
    return max(places, default=None)


def has_limits(chart: ChartData) -> TypeGuard[LimitedChart]:
    """Return whether a chart has control limits."""
    return chart["lower"] is not None


def drifts(chart: ChartData) -> bool:
    """Return whether a parameter has a significant drift."""
    drift = chart["drift"]
    return any(slope is not None and slope["seen"] for slope in (drift["per_day"], drift["per_c"]))
