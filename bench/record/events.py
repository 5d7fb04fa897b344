"""The events of a run's journal, and the type of what each carries: degrees, and seconds unless a name says otherwise.

`RunLog.write` takes exactly these payloads, and a replay gives them back; nothing else in a journal means anything.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from typing import (
    Any,
    Literal,
    NotRequired,  # pydantic checks these types, on Python 3.11 too
)

from typing_extensions import TypedDict

from bench.record.journal import CAPTURE_STORED
from bench.record.measured_facts import GateData, MeasuredFacts, RecordingCounts
from drivers.lateness import LatenessData

_NEXT_WORD = re.compile("(?<=[a-z])(?=[A-Z])")

UntilEnd = Literal["met", "unreachable", "at_most", "minutes", "failures", "no_pose"]
"""How an ``until`` ended: its goals are met, or cannot be met; a bound was reached; or no pose is left to choose."""


class DeviceData(TypedDict, total=False):
    """Identity of a device, as it states it itself; ``name`` is that of an axis."""

    name: str
    maker: str
    model: str
    serial: str
    firmware: str


class CameraDeviceData(DeviceData, total=False):
    """Identity of a camera (`drivers.camera.CameraIdentity`), and its lens as the station file states it."""

    sensor: str
    width: int
    height: int
    firmware_built: str
    link_mbit_s: int
    lens: str | None


class Devices(TypedDict):
    """Payload of ``devices``: identities, and the camera's settings as read back."""

    camera: CameraDeviceData
    stage: Sequence[DeviceData]
    light: DeviceData
    camera_settings: Mapping[str, Any]
    connections: NotRequired[Mapping[str, str]]


class DevicesLeft(TypedDict):
    """Payload of ``devices_left``: each device as in `RunEnded`, asked after the last step that needs devices."""

    devices: Sequence[Mapping[str, Any]]


class Event(StrEnum):
    """What a line of a run's journal states."""

    RUN_STARTED = "run_started"  # First line of a run
    RUN_RESUMED = "run_resumed"  # A process took the run up again
    DEVICES = "devices"  # The identities that the devices gave
    ENTERING = "entering"  # The machine is about to enter a state
    LEFT_OFF = "left_off"  # The work of a state ended
    CAPTURE_STORED = CAPTURE_STORED  # A recording is complete and in its place
    STEP_DONE = "step_done"  # A step of the script is done and will not be done again
    ATTEMPT_CHECKED = "attempt_checked"  # A recording was measured, and accepted or refused
    ATTEMPT_LOST = "attempt_lost"  # The camera could not complete a recording; nothing was stored
    SOLVED = "solved"  # A calibration stands: its main numbers
    WRITTEN = "written"  # Hashes of results, report, views and exports, which are written now
    # What an ``until`` found so far, and the next pose that it chose, or why it ended
    UNTIL_DECIDED = "until_decided"
    RECOVERED = "recovered"  # What a crash had left of the run folder
    ASKED = "asked"  # The run asks the operator a question
    ANSWERED = "answered"  # The operator's answer, or the default
    COMMANDED = "commanded"  # An operator's command from another terminal, taken or refused
    POSE_SKIPPED = "pose_skipped"  # A pose is given up. The report calls it a deviation
    INTERLOCK_RELEASED = "interlock_released"  # An interlock that held the run releases it
    SUPERVISOR_LOST = "supervisor_lost"  # The process that watched this one is gone; the run ends safely
    COMPUTER_BUSY = "computer_busy"  # The computer is too busy for the run
    DEVICES_LEFT = "devices_left"  # How the run left each device after the last step that needs devices
    DEVIATION = "deviation"  # The run departed from its sequence; printed in the report
    RUN_ENDED = "run_ended"  # Last line of a run


def event_name(payload: Callable[..., object]) -> str:
    """Return the name of the event whose payload a type is: ``attempt_checked`` for `AttemptChecked`."""
    return _NEXT_WORD.sub("_", getattr(payload, "__name__", "")).lower()


class LedgerPlace(TypedDict):
    """Where a run stands in the bench's ledger: its number, the ledger's head, and the runs of its camera by end.

    ``faults`` states breaks that nobody had explained when the run began, ``warnings`` what else a person
    should know of the ledger.
    """

    number: int
    head: str
    of_camera: Mapping[str, int]
    faults: NotRequired[Sequence[str]]
    warnings: NotRequired[Sequence[str]]


class RunStarted(TypedDict):
    """Payload of ``run_started``; ``plugins`` states the drivers of each package: ``stage epics_motor``."""

    id: str
    sequence: str
    station: str
    sha256: Mapping[str, str]
    seed: int
    operator: str | None
    simulated: bool
    software: Mapping[str, str]
    begun_with: NotRequired[Sequence[str]]  # Arguments of `starbench run` that begin it again
    plugins: NotRequired[Mapping[str, Sequence[str]]]
    ledger: NotRequired[LedgerPlace]
    rehearsal: NotRequired[bool]
    # Of the bench's earlier runs (`bench.record.pace`); left out if they took no longer
    pace: NotRequired[float]


class RunResumed(TypedDict):
    """Payload of ``run_resumed``; ``crash`` where the process before it crashed by itself."""

    torn_bytes: int
    software: Mapping[str, str]
    crash: NotRequired[str]
    ledger: NotRequired[LedgerPlace]
    rehearsal: NotRequired[bool]


class Circumstances(TypedDict, total=False):
    """What the journal adds to a change of state: the pose, the attempt, the target, or why the run holds."""

    pose: int
    pose_name: str
    target_deg: Mapping[str, float]
    attempt: int
    wait_s: float
    by: str
    rule: str
    why: str


class Entering(Circumstances, TypedDict("Left", {"from": str})):  # a key that is a keyword
    """Payload of ``entering``: the states, the step, and its circumstances."""

    state: str
    step: NotRequired[int]


class StateEntered(TypedDict):
    """A state that a run entered, with the time by the system's clock and by the monotonic clock."""

    state: str
    utc: str
    mono_s: float


class LeftOff(TypedDict):
    """Payload of ``left_off``; ``error`` where the work did not end well."""

    state: str
    error: NotRequired[str]


class LightSettingsData(TypedDict, total=False):
    """The light as it was read back (`drivers.light.LightSettings`)."""

    waveform: str
    frequency_hz: float
    duty_percent: float
    low_v: float
    high_v: float
    sync_output: bool


class RecordedData(TypedDict, total=False):
    """Facts of a recording by field: of `drivers.camera.RecordingFacts`, or of `drivers.camera.frames.FrameFacts`."""

    serial: str
    model: str
    width: int
    height: int
    bytes: int
    complete: bool
    duration_s: float
    events: int
    triggers: int
    biases: Mapping[str, int]
    filters: Mapping[str, bool]
    rate_controller_in: int | None
    rate_controller_out: int | None
    temperature_c: float | None
    illumination_lux: float | None
    gaps: Sequence[str]
    bits: int
    frames: int
    saturated_share: float


class CaptureStored(TypedDict):
    """Payload of ``capture_stored``: name, size and hash of the file, and what was known when it was recorded."""

    capture: str
    size: int
    sha256: str
    pose: int
    pose_name: str
    attempt: int
    commanded_deg: Mapping[str, float]
    measured_deg: Mapping[str, float]
    measured_after_deg: Mapping[str, float]
    light: LightSettingsData
    facts: RecordedData
    asleep_s: NotRequired[float]  # How long the computer was suspended meanwhile, s; only if it was


class StepDone(TypedDict):
    """Payload of ``step_done``."""

    step: int
    skipped: NotRequired[bool]


class AttemptChecked(TypedDict):
    """Payload of ``attempt_checked``: the verdict, its reasons, and the numbers behind it."""

    pose: int
    attempt: int
    accepted: bool
    reasons: Sequence[str]
    stars: int
    gates: Sequence[GateData]
    measured: MeasuredFacts


class AttemptData(RecordingCounts):
    """A recording in the results, accepted or refused."""

    attempt: int
    capture: str
    sha256: str
    accepted: bool
    reasons: Sequence[str]


class AttemptLost(TypedDict):
    """Payload of ``attempt_lost``; ``kept`` names the file that holds what there is of it."""

    pose: int
    pose_name: str
    attempt: int
    why: str
    kept: str | None


class CauseData(TypedDict):
    """What a person did to the bench (`calib.model.cause.Cause`)."""

    kind: str
    evidence: float  # 2 log of the odds for it
    value: float | None
    expanded: float | None
    unit: str
    stated: float | None
    axis: str
    before: str
    pose: str
    beside: Sequence[str]
    explains: Sequence[str]


class Solved(TypedDict):
    """Payload of ``solved``: model, convergence, rms, values and standard uncertainties by parameter.

    ``coverage_factors`` are the k of values that have their own; ``shared`` is the part of a standard uncertainty that
    all runs on the bench share; ``causes`` what a person did to the bench. An earlier version wrote none of them.
    """

    model: str
    converged: bool
    rms_px: float
    values: Mapping[str, float]
    sigma: Mapping[str, float]
    coverage_factor: NotRequired[float]
    coverage_factors: NotRequired[Mapping[str, float]]
    shared: NotRequired[Mapping[str, float]]
    causes: NotRequired[Sequence[CauseData]]


class VerdictData(TypedDict):
    """The verdict on a calibration, as the head of its report has it."""

    kind: str  # ``pass``, ``marginal`` or ``fail``
    headline: str  # With its first reservation, if nothing that a person did explains it


class Written(TypedDict):
    """Payload of ``written``: what the report step wrote; an earlier version wrote no ``verdict``."""

    head: str  # Hash of the journal's last line when the results were made; the report prints it
    # SHA-256 by name of results.json, views.h5, report.html and each file of exports/.
    files: Mapping[str, str]
    verdict: NotRequired[VerdictData]


class ChosenPose(TypedDict):
    """The pose that an ``until`` chose; ``expected`` px are the uncertainties with it, ``why`` the reason in words."""

    pose: int
    pose_name: str
    angles_deg: Mapping[str, float]
    expected: Mapping[str, float]
    why: str


class UntilDecided(TypedDict):
    """Payload of ``until_decided``: the uncertainties after the poses so far, and either ``chosen`` or ``ended``."""

    step: int
    until: int  # Number of the first step of the ``until``
    until_last: int  # Number of its last step
    recorded: int  # Accepted recordings of the ``until``
    poses: int  # Accepted recordings in the calibration: those before the ``until`` too
    worked_s: float  # Time that the ``until`` has worked, s
    wanted: Mapping[str, float]  # Goals: largest expanded uncertainties allowed, px, by name
    # Expanded uncertainties reached, px, by name; empty if the poses do not determine the camera yet.
    now: Mapping[str, float]
    # Expanded uncertainties expected with all poses allowed, px, by name; empty if none were asked for.
    at_end: Mapping[str, float]
    coverage_factor: float | None  # The k of the expanded uncertainties; None without a calibration
    model: str  # Name of the model of the calibration; empty without one
    # What the poses lack besides information: ``rim``, ``roll``, or nothing.
    lacks: Literal["", "rim", "roll"]
    problem: NotRequired[str]  # Why there is no calibration yet; absent if there is one
    chosen: NotRequired[ChosenPose]
    ended: NotRequired[UntilEnd]  # How the ``until`` ended
    why: NotRequired[str]  # Why it ended so, in words


class Recovered(TypedDict):
    """Payload of ``recovered``: recordings by what a restart found; all but the first two are now in quarantine."""

    intact: list[str]
    missing: list[str]  # That the journal names and that do not exist
    changed: list[str]  # That differ from the journal
    interrupted: list[str]  # Incomplete ones
    unnamed: list[str]  # Complete ones that the journal does not name: the run was cut off before that


class Asked(TypedDict):
    """Payload of ``asked``."""

    step: int
    text: str
    default: str
    timeout_s: float | None


class Answered(TypedDict):
    """Payload of ``answered``."""

    step: int
    answer: str
    by: str


class Commanded(TypedDict):
    """Payload of ``commanded``: the command, who gave it, whether it was taken, and why not."""

    id: str
    word: str
    taken: bool
    why: str
    by: NotRequired[str]
    known_by: NotRequired[str]
    pose: NotRequired[int]
    answer: NotRequired[str]


class PoseSkipped(TypedDict):
    """Payload of ``pose_skipped``."""

    pose: int
    pose_name: str
    what: str


class InterlockReleased(TypedDict):
    """Payload of ``interlock_released``; that the interlock held stands in the line ``entering``."""

    rule: str
    held_s: float


class SupervisorLost(TypedDict):
    """Payload of ``supervisor_lost``: nothing."""


class ComputerBusy(TypedDict):
    """Payload of ``computer_busy``: lateness of the last ``window_s``, and of all the time (`drivers.lateness`)."""

    late_s: float
    window_s: float
    lateness: LatenessData


class Deviation(TypedDict):
    """Payload of ``deviation``; ``hold`` if a person only had the run wait."""

    what: str
    hold: NotRequired[bool]
    # Time from which on the wire log lacks what this process and its devices said, s, on its monotonic clock
    wire_log_ended_s: NotRequired[float]


class RunEnded(TypedDict):
    """Payload of ``run_ended``; ``error`` where the run failed, ``crashed`` where the error was not foreseen.

    ``error`` is a `bench.base.failure.Failure` by field; ``devices`` states how each was left, a
    `bench.record.device_end.DeviceEnd` by field, ``lateness`` how late this process was woken.
    """

    how: Literal["finished", "aborted", "failed"]
    why: str
    error: NotRequired[Mapping[str, str]]
    crashed: NotRequired[bool]
    devices: NotRequired[Sequence[Mapping[str, Any]]]
    lateness: NotRequired[LatenessData]
