"""Status of a run, read by another process from journal, ``plan.json`` and lock; the folder is not changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from bench.base.encoding import clock_text, counted, printable_line, times
from bench.base.errors import RunFolderError, StorageError
from bench.base.home import home_folder
from bench.base.pasteable import pasteable
from bench.evidence.authorisations import known_authorisations
from bench.evidence.states import home_trust, shown_state
from bench.record.coverage import estimates, factors_text
from bench.record.device_end import NO_END, NOT_ASKED, DeviceEnd, all_ends, lost_ends
from bench.record.events import (
    AttemptChecked,
    Commanded,
    ComputerBusy,
    DevicesLeft,
    Entering,
    Event,
    InterlockReleased,
    RunEnded,
    RunResumed,
)
from bench.record.folder_lock import is_locked, resume_process, suspended_process
from bench.record.history import History, way_on
from bench.record.journal import CLOCK_JUMPED
from bench.record.journal_line import Entry
from bench.record.run_folder import PLAN, REPORT
from bench.record.storage import read_json
from bench.record.stored_run import StoredRun
from bench.run.interlocks import interlock_text
from bench.run.machine import END_STATES
from bench.run.time_left import TimeLeft
from bench.wording.causes import cause_sentences
from bench.wording.goals import decision_text, goals_missed, reached_text
from bench.wording.numbers import with_uncertainty
from drivers.lateness import LatenessData

_REASONS: Mapping[str, str] = {
    Event.RUN_ENDED: "why",
    Event.LEFT_OFF: "error",
    Event.ATTEMPT_CHECKED: "reasons",
}
"""Where journal lines state why something failed."""
LAST_LINES = 5  # What happened just now

_WORTH_TELLING_S = 5.0
"""A run that has ended tells how late the computer was if it lost more than this, s; less changes no recording."""


def event_text(entry: Entry) -> str:
    """Return what a journal line says, as text; empty for lines that only programs need."""
    make_text = _ENTRY_TEXTS.get(entry.event)
    return make_text(entry.data) if make_text is not None else ""


def line_text(entry: Entry) -> str:
    """Return a journal line as text with its time; empty for lines that only programs need."""
    text = event_text(entry)
    return f"{entry.utc[11:19]} UTC  {text}" if text else ""


def _resumed_text(data: RunResumed) -> str:
    crash = data.get("crash")
    return f"the run was resumed{f' after a crash: {crash}' if crash else ''}"


def _entering_text(data: Entering) -> str:
    if "rule" in data:
        return f"held by the {interlock_text(data['rule'])} interlock: {data['why']}"
    # The line of the run's end states its end state already.
    return "" if data["state"] in END_STATES else f"{data['state']}{_at_pose(data.get('pose'))}"


def _attempt_text(data: AttemptChecked) -> str:
    verdict = "accepted" if data["accepted"] else "; ".join(data["reasons"])
    return f"attempt {data['attempt']}{_at_pose(data['pose'])}: {verdict}"


def _command_text(data: Commanded) -> str:
    refused = "" if data["taken"] else f", refused: {data['why']}"
    typed = " (typed)" if data.get("known_by") == "typed" else ""
    return f"{data['word']} by {data.get('by', 'an unknown person')}{typed}{refused}"


def _end_text(data: RunEnded) -> str:
    ends = [DeviceEnd(**end) for end in data.get("devices", ())]
    used = any(end.state != "never opened" for end in ends)
    unsure = "".join(f"; {end.text}" for end in ends if used and end.state != "confirmed safe")
    return f"{data['how']}{': ' if data['why'] else ''}{data['why']}{unsure}"


def _left_text(data: DevicesLeft) -> str:
    ends = [DeviceEnd(**end) for end in data["devices"]]
    unsure = [end.text for end in ends if end.state != "confirmed safe"]
    return f"the devices after the last step that needs them: {'; '.join(unsure) or 'all confirmed safe'}"


def _interlock_released_text(data: InterlockReleased) -> str:
    return f"the {interlock_text(data['rule'])} interlock cleared after {data['held_s']:.0f} s"


def _busy_text(data: ComputerBusy) -> str:
    load = data["lateness"].get("load")
    at_load = "" if load is None else f" (load {load:g})"
    late = f"it was {data['late_s']:.1f} s late in {data['window_s']:.0f} s"
    return f"this computer is too busy: {late}{at_load}; deadlines are stretched"


def _at_pose(pose: int | None) -> str:
    return f" at pose {pose}" if pose else ""


_ENTRY_TEXTS: Mapping[str, Callable[[Any], str]] = {
    Event.RUN_STARTED: lambda _data: "the run began",
    Event.RUN_RESUMED: _resumed_text,
    Event.ENTERING: _entering_text,
    Event.LEFT_OFF: lambda data: f"{data['state']} failed: {data['error']}" if "error" in data else "",
    Event.CAPTURE_STORED: lambda data: f"stored {data['capture']}",
    Event.ATTEMPT_CHECKED: _attempt_text,
    Event.COMMANDED: _command_text,
    Event.DEVIATION: lambda data: f"deviation: {data['what']}",
    Event.POSE_SKIPPED: lambda data: f"deviation: {data['what']}",
    Event.UNTIL_DECIDED: decision_text,
    Event.RUN_ENDED: _end_text,
    Event.DEVICES_LEFT: _left_text,
    Event.ASKED: lambda data: f"question: {data['text']} ({data['default']} after {data['timeout_s']:g} s)",
    Event.ANSWERED: lambda data: f"answer: {data['answer']} ({data['by']})",
    Event.INTERLOCK_RELEASED: _interlock_released_text,
    Event.COMPUTER_BUSY: _busy_text,
    CLOCK_JUMPED: lambda data: f"the computer's clock jumped by {data.get('jump_s')} s",
    Event.SUPERVISOR_LOST: lambda _data: "the supervisor of this process has ended; the run continues",
}
"""Text of each kind of journal line that people read."""


@dataclass(frozen=True)
class Status:
    """Status of a run."""

    run_id: str  # Name of the run
    folder: str  # Folder of the run
    simulated: bool  # Whether any device is simulated
    running: bool  # Whether a process works on the run
    sealed: bool  # Whether the run is finished and sealed
    evidence: str  # ``DRAFT``, ``SEALED`` or ``AUTHORISED``, and who signed, as one line
    # Last state that was entered; if no process works on the run, the state in which it was left.
    state: str
    ended: str  # ``finished``, ``aborted`` or ``failed``; empty while it has not ended
    why: str  # Why it ended so; empty while it has not ended
    pose: int | None  # Number of the pose at work; None between poses
    pose_name: str  # Name of the pose at work; empty between poses
    poses: int  # Number of poses, without those that the run may still choose
    most_poses: int  # How many poses there are at most, with those that the run may still choose
    accepted: int  # Number of poses that are recorded
    skipped: int  # Number of poses that are skipped
    attempts: int  # Number of recordings made
    # What an ``until`` has reached, and its goals; empty if the run has decided nothing yet.
    uncertainty: str
    goals_missed: Sequence[str]  # Each ``until`` that ended without its goals, as sentences
    # Focal lengths with their expanded uncertainty, as text; empty if nothing is calibrated yet.
    result: str
    verdict: str  # The headline of its report; empty while it has none
    causes: Sequence[str]  # What a person did to the bench, as sentences, the most probable first
    left_s: float | None  # Expected time until the end, s; None if no process works on the run
    held_by: str  # Operator or interlock that holds the run, and why; empty while none does
    question: str  # Question to the operator; empty while there is none
    resumed: int  # How often the run was resumed
    deviations: Sequence[str]  # Deviations from the sequence
    last: Sequence[str]  # Last journal lines as text, the newest last
    advice: str  # What to do next
    report: str = ""  # Path of its report, or of the page of a run that ended early; empty while it has none
    # How stage, light and camera were left: ``device``, ``state``, ``said``. Empty while a process works on
    # the run.
    devices: Sequence[DeviceEnd] = ()
    busy: str = ""  # How late a busy computer was, as text; empty if the journal does not say
    lateness: LatenessData = field(default_factory=LatenessData)  # The same in seconds (`drivers.lateness`)
    ledger_number: int | None = None  # Number in the ledger of its bench; None for a rehearsal
    ledger_head: str | None = None  # Hash of its line in the ledger; None for a rehearsal

    @property
    def poses_text(self) -> str:
        """How many poses there are, as people read it."""
        return PoseCount(self.poses, self.most_poses).text

    @property
    def place(self) -> tuple[int, str] | None:
        """Number and hash of the run's line in the ledger; None if it is in no ledger."""
        if self.ledger_number is None or self.ledger_head is None:
            return None
        return self.ledger_number, self.ledger_head

    def to_dict(self) -> dict[str, Any]:
        """Return the status for JSON output."""
        return {"schema": "starbench/status/1", **asdict(self)}


@dataclass(frozen=True)
class RunPlan:
    """The plan of a run."""

    poses: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)
    most_poses: int = 0  # How many poses there are at most, with those that the run may still choose
    untils: Sequence[Mapping[str, Any]] = ()  # ``untils`` of the plan
    steps: Sequence[Mapping[str, Any]] = ()  # ``steps`` of the plan, in order
    prompts: Sequence[int] = ()
    duration_s: float = 0.0  # Planned time, s
    most_bytes: int = 0  # Disk space that the run may need, bytes
    simulated: bool = False  # Whether any device is simulated
    fault: str = ""  # Why there is no plan; empty if there is one

    @classmethod
    def from_dict(cls, plan: Mapping[str, Any]) -> RunPlan:
        """Return the plan that ``plan.json`` holds."""
        poses = {int(pose["index"]): pose for pose in plan["poses"]}
        return cls(
            poses,
            max(len(poses), int(plan.get("most_poses", 0))),
            plan.get("untils", ()),
            plan["steps"],
            [int(step["number"]) for step in plan["steps"] if step["what"] == "prompt"],
            float(plan["duration_s"]),
            int(plan.get("most_bytes", 0)),
            bool(plan.get("simulated", False)),
        )

    def count_poses(self, history: History) -> PoseCount:
        """Return how many poses a run has. No more can follow once every ``until`` has ended."""
        known = len(self.poses.keys() | history.chosen.keys())
        ended = {decided["until"] for decided in history.decisions if "ended" in decided}
        is_open = any(until["first"] not in ended for until in self.untils)
        return PoseCount(known, max(known, self.most_poses) if is_open else known)

    def name_of(self, pose: int | None, history: History) -> str:
        """Return the name of a pose, also of one that the run chose; empty for None."""
        chosen = (decision["chosen"] for decision in history.decisions if "chosen" in decision)
        names = {decided["pose"]: decided["pose_name"] for decided in chosen}
        names |= {number: planned["name"] for number, planned in self.poses.items()}
        return names.get(pose, "") if pose is not None else ""


class PoseCount(NamedTuple):
    """How many poses a run has: those whose angles are known, and the most, with those that it may still choose."""

    known: int
    most: int

    @property
    def text(self) -> str:
        """The number as people read it: ``25`` or ``at most 25``."""
        return f"{'at most ' if self.most > self.known else ''}{self.most}"


def read_plan(folder: Path) -> RunPlan:
    """Read the plan of a run; one that is missing or damaged gives a ``fault``."""
    try:
        return RunPlan.from_dict(read_json(folder / PLAN))
    except StorageError as error:
        return RunPlan(fault=f"{PLAN} cannot be read: {error.what}")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        return RunPlan(fault=f"{PLAN} is damaged, or another version wrote it ({error}).")


def read_status(folder: Path, utc_now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> Status:
    """Read the status of a run. Nothing is changed, and its process is not disturbed."""
    return read_with_entries(folder, utc_now())[0]


def read_with_entries(folder: Path, now: datetime) -> tuple[Status, Sequence[Entry]]:
    """Read status, at a time in UTC, and journal; the lock first, lest a run that ends meanwhile appears killed."""
    run = StoredRun.open(folder)
    running, sealed = is_locked(folder), run.is_sealed
    return _status(run, now, running=running, sealed=sealed), run.entries


def _status(run: StoredRun, now: datetime, *, running: bool, sealed: bool) -> Status:
    folder, entries, history = run.folder, run.entries, run.history
    plan = _plan_of(folder)
    poses = plan.count_poses(history)
    going_on = running and not _is_over(history)
    suspended = suspended_process(folder) if going_on else 0
    return Status(
        run_id=str(history.started.get("id", folder.name)),
        folder=str(folder),
        simulated=bool(history.started.get("simulated", plan.simulated)),
        running=running,
        sealed=sealed,
        evidence=evidence_text(folder, now),
        state=history.states[-1]["state"] if history.states else "idle",
        ended=history.ended,
        why=history.why,
        pose=history.at_pose,
        pose_name=plan.name_of(history.at_pose, history),
        poses=poses.known,
        most_poses=poses.most,
        accepted=len(history.accepted()),
        skipped=len(history.skipped),
        attempts=len(history.attempts) + sum(history.lost.values()),
        uncertainty=reached_text(history.decisions[-1]) if history.decisions else "",
        goals_missed=goals_missed(history.decisions),
        result=_result_text(history),
        verdict=history.verdict["headline"] if history.verdict else "",
        causes=cause_sentences(history.solved.get("causes", ())),
        left_s=_left_s(history, plan, entries, now) if going_on and not suspended else None,
        held_by=_held_by(history, suspended) if running else "",
        question=history.question if running else "",
        resumed=history.resumed,
        deviations=tuple(history.deviations),
        last=_last_lines(entries, history.why),
        report=str(folder / REPORT) if (folder / REPORT).is_file() else "",
        advice=_advice(folder, history, suspended, running=running, sealed=sealed),
        devices=() if going_on else _devices_left(history),
        busy=history.busy,
        lateness=history.lateness,
        ledger_number=history.ledger.get("number"),
        ledger_head=history.ledger.get("head"),
    )


def _plan_of(folder: Path) -> RunPlan:
    """Read the plan of a run. Raises RunFolderError if that is not possible."""
    plan = read_plan(folder)
    if plan.fault:
        raise RunFolderError(
            f"{PLAN} cannot be read.",
            where=str(folder),
            remedy="The file is damaged or was written by another program.",
        )
    return plan


def evidence_text(folder: Path, now: datetime) -> str:
    """Return what the signatures of a run say now, as one line."""
    home = home_folder()
    return shown_state(folder, home_trust(home), now, known_authorisations(home)).text


def _devices_left(history: History) -> Sequence[DeviceEnd]:
    """Return how each device was left, by the last line that states it; a process that was killed states nothing."""
    stated = history.devices_at_end or history.devices_left
    if stated or history.ended:
        return stated
    return lost_ends(NOT_ASKED) if history.states else all_ends(())


def _result_text(history: History) -> str:
    """Return fx and fy with their expanded uncertainties; empty without a calibration that converged."""
    solved = history.solved
    if not solved or not solved["converged"]:
        return ""
    focal_lengths = {name: estimate for name, estimate in estimates(solved).items() if name in {"fx", "fy"}}
    parts = [
        "{} {} ± {} px".format(name, *with_uncertainty(estimated.value, estimated.expanded))
        for name, estimated in focal_lengths.items()
    ]
    factors = factors_text(estimated.k for estimated in focal_lengths.values())
    return f"{', '.join(parts)} ({factors})" if parts else ""


def _left_s(history: History, plan: RunPlan, entries: Sequence[Entry], now: datetime) -> float:
    """Return the time left by plan and pace; a held run has its whole rest before it."""
    left = TimeLeft(plan.steps, plan.duration_s)
    for entry in entries:
        left.apply(entry, history)
    return round(left.left_s(now, held=history.waits), 1)


def _held_by(history: History, suspended: int) -> str:
    if suspended:
        return f"the suspended process {suspended}"
    if history.interlock:
        return f"the {interlock_text(history.interlock.rule)} interlock: {history.interlock.why}"
    return history.holder


def _advice(folder: Path, history: History, suspended: int, *, running: bool, sealed: bool) -> str:
    if suspended:
        return resume_process(suspended)
    if running and not sealed:
        return _advice_while_running(folder, history)
    if sealed:
        state = "Finished and sealed." if history.ended else "The journal was changed after the seal."
        return f"{state} To check the seal: {pasteable('verify', folder)}"
    if history.ended == "finished":
        return f"The run has finished, but it is not sealed. To seal it: {pasteable('resume', folder)}"
    return "No process works on this run. {} {}".format(*way_on(history, folder))


def _advice_while_running(folder: Path, history: History) -> str:
    if _is_over(history):
        return "No action is needed: the run has ended, and its process is about to end."
    if history.interlock:
        return "No action is needed: the run continues when this is over, or ends safely if it holds for too long."
    if history.question:
        return f"The run asks: {history.question} To answer: {pasteable('tell', folder, 'yes')} (or no)"
    if history.holder:
        return f"Held by {history.holder}. To continue: {pasteable('tell', folder, 'release')}"
    return f"No action is needed. To stop the run safely: {pasteable('tell', folder, 'abort')}"


def _is_over(history: History) -> bool:
    """Return whether nothing of the run is left to do but to seal it."""
    return bool(history.ended) or (bool(history.states) and history.states[-1]["state"] in END_STATES)


def _last_lines(entries: Sequence[Entry], why: str) -> tuple[str, ...]:
    """Return the last journal lines as text; what the reason of the run's end tells already is not told again."""
    texts = (text for entry in reversed(entries) if (text := line_text(_reason_once(entry, why))))
    return tuple(reversed(tuple(islice(texts, LAST_LINES))))


def _reason_once(entry: Entry, why: str) -> Entry:
    """Return a journal line that refers to the reason of the run's end instead of stating it again."""
    name = _REASONS.get(entry.event, "")
    reason = entry.data.get(name, "")
    is_list = not isinstance(reason, str)
    text = "; ".join(reason) if is_list else reason
    if not text or text.rstrip(".") not in why:
        return entry
    return entry._replace(data={**entry.data, name: ["as above"] if is_list else "as above"})


def status_text(status: Status) -> str:
    """Return a status as text."""
    return "\n".join([*head_lines(status), *(f"  {line}" for line in status.last), status.advice])


def head_lines(status: Status) -> list[str]:
    """Return the first part of a status as text: state, counts, uncertainty and deviations."""
    counts = (
        f"{status.accepted} of {status.poses_text} poses recorded, {counted(status.attempts, 'recording')}"
    )
    counts += f", {status.skipped} skipped" if status.skipped else ""
    counts += f", resumed {times(status.resumed)}" if status.resumed else ""
    lines = [
        f"Run {printable_line(status.run_id)}{'  SIMULATED' if status.simulated else ''}",
        _state(status),
        counts,
    ]
    rows = {"Uncertainty after": status.uncertainty, "Result:": status.result, **_busy(status)}
    lines += [status.verdict] if status.verdict else []
    lines += [*status.causes, *(f"{name} {text}" for name, text in rows.items() if text)]
    lines += [*status.goals_missed, *_unasked(status)]
    lines += [f"Evidence: {status.evidence}"] if status.ended and not status.running else []
    lines += [f"Report: {printable_line(str(status.report))}"] if status.report else []
    return [*lines, *(f"Deviation: {what}" for what in status.deviations)]


def _state(status: Status) -> str:
    """Return the state of a run as one line."""
    at = f", pose {status.pose} of {status.poses_text} ({status.pose_name})" if status.pose else ""
    end = status.ended or (status.state if status.state in END_STATES else "")
    if status.running and end:
        why = f": {status.why}" if status.why else ""
        being_sealed = end == "finished" and not status.sealed
        return f"{end}{why}{'; the run folder is being sealed' if being_sealed else ''}"
    if status.running:
        held = f", HELD by {status.held_by}" if status.held_by else ""
        held = held or (", WAITS FOR AN ANSWER" if status.question else "")
        left = "" if status.left_s is None else f", about {clock_text(status.left_s)} left"
        return f"running: {status.state}{at}{held}{left}"
    if status.ended:
        return f"{status.ended}{': ' if status.why else ''}{status.why}"
    if status.sealed:
        return "sealed, but the journal does not say how the run ended"
    return f"interrupted ({NO_END}): {status.state}{at}"


def _busy(status: Status) -> dict[str, str]:
    """Return how late the computer is, or was if the run has ended."""
    if not status.ended:
        return {"Computer busy:": status.busy}
    lost_s = status.lateness.get("lost_s", 0.0)
    if lost_s < _WORTH_TELLING_S:
        return {}
    longest_s = status.lateness.get("longest_s", 0.0)
    return {"The computer was busy:": f"{lost_s:.0f} s were lost in all, {longest_s:.1f} s at once at most"}


def _unasked(status: Status) -> list[str]:
    """Return what may be the case after a run whose process was killed. Other ends state it in their last line."""
    ends = () if status.ended or status.sealed else status.devices
    advice = [end.advice for end in ends if end.state == "not confirmed" and end.advice]
    if not advice:
        return []
    return [" ".join(["CHECK THE BENCH: nothing states how the devices were left.", *advice])]
