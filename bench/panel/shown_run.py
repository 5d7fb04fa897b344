"""What the page of a run shows, as JSON: its upper part, its poses, its log, and what is calculated beside. Types only.

The writers are `bench.panel.run_head`, `bench.panel.run_model` and `bench.panel.watching`; ``run.js`` and ``list.js``
read it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NotRequired, TypedDict

from bench.records.events import GateData

PoseState = Literal["planned", "at work", "accepted", "rejected", "lost", "skipped"]


class PoseRow(TypedDict):
    """One pose."""

    number: int
    name: str
    angles_deg: Mapping[str, float]
    state: PoseState
    attempts: int
    stars: int | None  # None before a recording was measured
    why: str  # Why its last recording counts for nothing; empty if there is none such
    last: int  # Attempt whose picture is shown; 0 for none
    chosen: bool  # Whether the run chose it


class LogLine(TypedDict):
    """One line of the log; ``line`` is its number in the journal, ``tone`` how it is coloured."""

    line: int
    utc: str
    text: str
    tone: str


class LeaveData(TypedDict):
    """Whether the run may be left alone."""

    safe: bool  # Whether nobody is needed
    text: str
    until_utc: str  # Time from which somebody is needed; empty if it is not known or nobody is


class QuestionData(TypedDict):
    """The question that the run asks."""

    text: str
    default: str
    until_utc: str  # Time at which the default is taken; empty if the run waits without end
    answered: bool


class StateData(TypedDict):
    """The state that the run is in, and what holds it; texts are empty where there is nothing."""

    state: str
    state_utc: str
    pose: int | None
    pose_name: str
    holder: str
    interlock: str
    question: QuestionData | None


class TimesData(TypedDict):
    """Begin and end; ``left_s`` is None where no end is expected."""

    started_utc: str
    ended_utc: str
    left_s: float | None
    end_utc: str


class CountsData(TypedDict):
    """Numbers of poses and of recordings."""

    poses: int
    most_poses: int
    accepted: int
    skipped: int
    recordings: int
    lost: int
    retries: int
    resumed: int


class LastRecording(TypedDict):
    """The newest recording; the verdict stands there once it is measured, before that the gates of the one before."""

    pose: int
    pose_name: str
    attempt: int
    utc: str
    facts: Mapping[str, object]  # Those of `drivers.camera.RecordingFacts` that the page shows
    checked: bool
    accepted: NotRequired[bool]
    reasons: NotRequired[Sequence[str]]
    stars: NotRequired[int]
    gates: NotRequired[Sequence[GateData]]
    edge_width_px: NotRequired[float | None]
    flicker_hz: NotRequired[float | None]
    gates_before: NotRequired[Sequence[GateData]]


class RecordingPlace(TypedDict):
    """Which recording it is."""

    pose: int
    attempt: int


class LightData(TypedDict):
    """The light as it was read back at the last recording."""

    utc: str
    settings: Mapping[str, Any]


class StageData(TypedDict):
    """Where the stage was sent last, and where it was at the last recording."""

    target_deg: Mapping[str, float]
    measured_deg: Mapping[str, float]
    utc: str


class Possible(TypedDict):
    """Which commands make sense now."""

    hold: bool
    release: bool
    skip: bool
    abort: bool
    answer: bool


class DecisionData(TypedDict):
    """What an ``until`` found, px expanded, and its next pose or its end."""

    poses: int
    now: Mapping[str, float]
    wanted: Mapping[str, float]
    expected: Mapping[str, float]
    next: str
    why: str
    ended: str


class SolvedParameter(TypedDict):
    """One parameter of the calibration with its standard uncertainty."""

    name: str
    value: float
    sigma: float


class SolvedData(TypedDict):
    """The calibration that stands."""

    model: str
    rms_px: float
    parameters: Sequence[SolvedParameter]


class RunHead(StateData, TimesData, CountsData):
    """The upper part of the page."""

    id: str
    sequence: str
    station: str
    operator: str | None
    simulated: bool
    rehearsal: bool
    camera: Mapping[str, Any]
    verdict: str
    tone: str
    running: bool
    sealed: bool
    evidence: str
    ended: str
    why: str
    remedy: str
    faults: Sequence[str]
    incomplete: bool
    read_share: float
    leave: LeaveData
    deviations: Sequence[str]
    deviation_count: int
    gate_failures: Mapping[str, int]
    last: LastRecording | None
    checked: RecordingPlace | None
    light: LightData | None
    stage: StageData
    can: Possible
    decisions: Sequence[DecisionData]
    solved: SolvedData | None


class Coverage(TypedDict):
    """How many stars of accepted recordings lie in each cell of the image, row by row."""

    cells: tuple[int, int]  # Columns and rows
    counts: Sequence[int]
    share: float  # Share of the cells that have any
    size: tuple[int, int]  # Of the image, px
    poses: int


class Uncertainties(TypedDict, total=False):
    """Expanded uncertainties, px; empty where there are none."""

    coverage_factor: float  # That of the results; a forecast states none
    expanded_fx_px: float
    worst_corner_px: float


class Forecast(TypedDict):
    """What a number of poses will give."""

    poses: int
    now: Uncertainties


class RunExtras(TypedDict, total=False):
    """What is calculated beside the journal; each part comes once it is known."""

    final: Uncertainties
    coverage: Coverage
    forecast: Sequence[Forecast]


class RunMessage(RunExtras):
    """What is new after line ``since``, up to ``line``; ``reset`` if all that was told before no longer holds."""

    reset: bool
    since: int
    line: int
    head: RunHead
    rows: Sequence[PoseRow]
    log: Sequence[LogLine]


class RunBrief(TypedDict):
    """The part of `RunHead` that the list of a folder repeats, in its order."""

    id: str
    sequence: str
    station: str
    operator: str | None
    simulated: bool
    rehearsal: bool
    verdict: str
    tone: str
    running: bool
    why: str
    started_utc: str
    ended_utc: str
    end_utc: str
    poses: int
    most_poses: int
    accepted: int
    deviation_count: int
    state: str
    pose: int | None
    holder: str
    interlock: str
    question: QuestionData | None


class ListedRun(RunBrief):
    """One run in the list of a folder."""

    key: str  # By which a page names it: its path relative to the folder
    camera: str  # Its serial number
    fault: str
    leave: LeaveData
    reached: Mapping[str, float]  # What its ``until`` has reached, px expanded


class ListedBatch(TypedDict):
    """One batch in the list of a folder."""

    key: str
    queue: str
    running: bool
    rehearsal: bool
    simulated: bool
    verdict: str
    tone: str
    why: str
    done: int
    failed: Sequence[str]
    coming: int
    current_run: str
    end_utc: str
    ended_utc: str
    started_utc: str


class FolderContent(TypedDict):
    """The list of a folder, newest first; ``faults`` has a sentence for each part that cannot be read."""

    root: str
    exists: bool
    runs: Sequence[ListedRun]
    batches: Sequence[ListedBatch]
    faults: Sequence[str]
