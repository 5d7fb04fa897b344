"""What the page of a run shows, as JSON: its upper part, its poses, its log, and what is calculated beside. Types only.

The writers are the modules `run_head`, `run_model` and `watching` beside this one; ``run.js`` and ``list.js`` read it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict

from bench.record.events import AttemptChecked, CaptureStored, Solved, UntilDecided

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
    """Begin and end, as far as they are known or expected; empty if not."""

    started_utc: str
    ended_utc: str
    end_utc: str


class CountsData(TypedDict):
    """Numbers of poses and of recordings."""

    poses: int
    most_poses: int
    poses_text: str  # Both as people read them
    accepted: int
    skipped: int
    recordings: int
    retries: int
    resumed: int


class LastRecording(TypedDict):
    """The newest recording, as the journal has it."""

    utc: str
    stored: CaptureStored
    checked: AttemptChecked | None  # Its own verdict; None until it is measured
    before: AttemptChecked | None  # Until then the verdict of a recording before


class RunBrief(StateData, TimesData, CountsData):
    """What the page of a run and the list of a folder show."""

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
    headline: str  # The verdict of its report; empty while it has none
    unsafe: Sequence[str]  # Devices that did not confirm at its end that they are safe, a sentence each
    deviation_count: int
    leave: LeaveData


class RunHead(RunBrief):
    """The upper part of the page."""

    camera: Mapping[str, Any]
    sealed: bool
    evidence: str
    ended: str
    remedy: str
    faults: Sequence[str]
    incomplete: bool
    read_share: float
    left_s: float | None  # None where no end is expected
    deviations: Sequence[str]
    gate_failures: Mapping[str, int]
    last: LastRecording | None
    target_deg: Mapping[str, float]  # Where the stage was sent last
    can: Mapping[str, bool]  # Which commands make sense now
    decisions: Sequence[UntilDecided]
    solved: Solved | None  # The calibration that stands
    causes: Sequence[str]  # What a person did to the bench, as sentences, the most probable first


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


class ListedRun(RunBrief):
    """One run in the list of a folder."""

    key: str  # By which a page names it: its path relative to the folder
    camera: str  # Its serial number
    fault: str


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


class ListHead(TypedDict):
    """What a list says of its folder; ``faults`` has a sentence for each part that cannot be read."""

    root: str
    exists: bool
    unread: int  # Number of runs that are not listed yet: of very many, some are read at each look
    faults: list[str]


class FolderContent(ListHead):
    """The list of a folder, newest first."""

    runs: list[ListedRun]
    batches: list[ListedBatch]


class ListMessage(FolderContent):
    """What a page is told of a list: the rows that changed since it was told last, newest first."""

    since: int  # Version after which these rows changed
    version: int
    reset: bool  # Whether these are all rows
    gone: list[str]  # Keys of runs and batches that are not there any more
