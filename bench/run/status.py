"""Status of a run, read from its folder by another process; the folder is not changed.

The journal and ``plan.json`` give the content; the lock of the folder shows whether a process works on the run.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any, NotRequired, TypedDict

from bench.base.errors import RunFolderError, StorageError
from bench.records.events import (
    Asked,
    AttemptChecked,
    Commanded,
    Entering,
    Event,
    InterlockReleased,
    LeftOff,
    RunEnded,
    RunResumed,
)
from bench.records.folder_lock import is_locked
from bench.records.history import History, replay
from bench.records.journal import read_journal
from bench.records.journal_entry import Entry
from bench.records.run_folder import JOURNAL, PLAN, is_sealed
from bench.records.storage import storage_errors
from bench.report.until_text import decision_text, reached_text
from bench.run.interlock_text import interlock_text
from bench.run.machine import END_STATES
from bench.terminal.duration import clock_text

LAST_LINES = 5
FOLLOW_S = 0.5


@dataclass(frozen=True)
class Status:
    """Status of a run.

    Attributes
    ----------
    run_id, folder, simulated
        Name and folder of the run, and whether any device is simulated.
    running, sealed
        Whether a process works on the run, and whether it is finished and sealed.
    state
        Last state that was entered; if no process works on the run, the state in which it was left.
    ended, why
        ``finished``, ``aborted`` or ``failed``, and why; empty while the run has not ended.
    pose, pose_name
        Number and name of the pose at work; None and empty between poses.
    poses, accepted, skipped, attempts
        How many poses there are, how many are recorded, how many are skipped; how many recordings were made. Poses that
        the run may still choose are not counted.
    most_poses
        How many poses there are at most, with those that the run may still choose.
    uncertainty
        What an ``until`` has reached, and its goals; empty if the run has decided nothing yet.
    left_s
        Expected time until the end, s; None if no process works on the run.
    held_by
        Operator or interlock that holds the run, and why; empty while none does.
    question
        Question to the operator; empty while there is none.
    resumed, deviations
        How often the run was resumed; deviations from the sequence.
    last
        Last journal lines as text, the newest last.
    advice
        What to do next.
    """

    run_id: str
    folder: str
    simulated: bool
    running: bool
    sealed: bool
    state: str
    ended: str
    why: str
    pose: int | None
    pose_name: str
    poses: int
    most_poses: int
    accepted: int
    skipped: int
    attempts: int
    uncertainty: str
    left_s: float | None
    held_by: str
    question: str
    resumed: int
    deviations: Sequence[str]
    last: Sequence[str]
    advice: str

    def to_dict(self) -> dict[str, Any]:
        """Return the status for JSON output.

        Returns
        -------
        dict
            Values that can be written as JSON.
        """
        return {"schema": "starbench/status/1", **asdict(self)}


class _Plan(TypedDict):
    """What a status needs of plan.json; the plan of an earlier version has neither ``most_poses`` nor ``untils``."""

    poses: Sequence[Mapping[str, Any]]
    most_poses: NotRequired[int]
    untils: NotRequired[Sequence[Mapping[str, Any]]]
    steps: Sequence[Mapping[str, Any]]
    duration_s: float
    simulated: bool


def read_status(folder: Path, utc_now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> Status:
    """Read the status of a run. Nothing is changed, and its process is not disturbed.

    Parameters
    ----------
    folder
        Run folder.
    utc_now
        Returns the present time, UTC.

    Returns
    -------
    Status
        The status.

    Raises
    ------
    RunFolderError
        If there is no run.
    JournalBroken
        If the hash chain of its journal is broken.
    StorageError
        If it cannot be read.
    """
    if not (folder / JOURNAL).is_file():
        raise RunFolderError(
            f"This is not a run folder: it has no {JOURNAL}.",
            where=str(folder),
            remedy="Name the folder of a run.",
        )
    entries, _ = read_journal(folder / JOURNAL)
    return _status(folder, entries, utc_now())


def follow(folder: Path, sleep: Callable[[float], None] = time.sleep) -> Iterator[Status]:
    """Read the status of a run after every change, as long as a process works on the run.

    Parameters
    ----------
    folder
        Run folder.
    sleep
        Waits between two reads of the journal.

    Yields
    ------
    Status
        One per change; the last one shows how the run ended.
    """
    seen = -1
    while True:
        with storage_errors(folder):
            size = (folder / JOURNAL).stat().st_size
        if size != seen or not is_locked(folder):
            seen, status = size, read_status(folder)
            yield status
            if not status.running:
                return
        sleep(FOLLOW_S)


def _status(folder: Path, entries: Sequence[Entry], now: datetime) -> Status:
    history, plan = replay(entries), _plan_of(folder)
    running, sealed = is_locked(folder), is_sealed(folder)
    names = {pose["index"]: pose["name"] for pose in plan["poses"]}
    names |= {d["chosen"]["pose"]: d["chosen"]["pose_name"] for d in history.decisions if "chosen" in d}
    held_by = _held_by(history) if running else ""
    going_on = running and not history.ended
    return Status(
        run_id=str(history.started.get("id", folder.name)),
        folder=str(folder),
        simulated=bool(history.started.get("simulated", plan["simulated"])),
        running=running,
        sealed=sealed,
        state=history.states[-1]["state"] if history.states else "idle",
        ended=history.ended,
        why=history.why,
        pose=history.at_pose,
        pose_name=names.get(history.at_pose or 0, ""),
        poses=len(names),
        most_poses=_most_poses(plan, history, len(names)),
        accepted=len(history.accepted()),
        skipped=len(history.skipped),
        attempts=len(history.attempts) + sum(history.lost.values()),
        uncertainty=reached_text(history.decisions[-1]) if history.decisions else "",
        left_s=_left_s(history, plan, entries, now) if going_on else None,
        held_by=held_by,
        question=history.question if running else "",
        resumed=history.resumed,
        deviations=tuple(history.deviations),
        last=_last_lines(entries),
        advice=_advice(folder, history, running=running, sealed=sealed),
    )


def _most_poses(plan: _Plan, history: History, known: int) -> int:
    """Return how many poses there can be; that is known once every ``until`` has ended."""
    ended = {decided["until"] for decided in history.decisions if "ended" in decided}
    if all(until["first"] in ended for until in plan.get("untils", ())):
        return known
    return max(known, plan.get("most_poses", known))


def _plan_of(folder: Path) -> _Plan:
    try:
        with storage_errors(folder / PLAN):
            plan: dict[str, Any] = json.loads((folder / PLAN).read_text(encoding="utf-8"))
        found = _Plan(**{name: plan[name] for name in _Plan.__required_keys__})  # type: ignore[typeddict-item]
        if "untils" in plan:
            found["most_poses"], found["untils"] = int(plan["most_poses"]), plan["untils"]
    except (StorageError, ValueError, KeyError, TypeError) as error:
        raise RunFolderError(
            f"{PLAN} cannot be read.",
            where=str(folder),
            remedy="The file is damaged or was written by another program.",
        ) from error
    return found


def _left_s(history: History, plan: _Plan, entries: Sequence[Entry], now: datetime) -> float:
    """Return the planned time after the last step done, less the time since then unless the run is held."""
    done_s = {step["number"]: step["done_after_s"] for step in plan["steps"]}
    done = (s for number, s in done_s.items() if number in history.done_steps or history.is_left_out(number))
    begun_s = max(done, default=0.0)
    marks = (e for e in reversed(entries) if e.event in {Event.STEP_DONE, Event.RUN_STARTED})
    mark = next(marks, None)
    since = (
        0.0 if mark is None or history.holder else (now - datetime.fromisoformat(mark.utc)).total_seconds()
    )
    return round(max(0.0, plan["duration_s"] - begun_s - max(0.0, since)), 1)


def _held_by(history: History) -> str:
    if history.interlock:
        name, _, why = history.interlock.partition(":")
        return f"the {interlock_text(name)} interlock:{why}"
    return history.holder


def _advice(folder: Path, history: History, *, running: bool, sealed: bool) -> str:
    if sealed:
        return f"Finished and sealed. To check the seal: starbench verify {folder}"
    if running and history.interlock:
        return (
            "No action is needed: the run continues by itself when this is over, or ends safely if it holds for too"
            " long."
        )
    if running and history.question:
        return f"The run asks: {history.question} To answer: starbench answer {folder} yes (or no)"
    if running and history.holder:
        return f"Held by {history.holder}. To continue: starbench release {folder}"
    if running:
        return f"No action is needed. To stop the run safely: starbench abort {folder}"
    return f"No process works on this run. To continue: starbench resume {folder}"


def _last_lines(entries: Sequence[Entry]) -> tuple[str, ...]:
    texts = (text for text in map(line_text, reversed(entries)) if text)
    return tuple(reversed(tuple(islice(texts, LAST_LINES))))


def line_text(entry: Entry) -> str:
    """Return a journal line as text.

    Parameters
    ----------
    entry
        Line of the journal.

    Returns
    -------
    str
        Time and text; empty for lines that only programs need.
    """
    make_text = _ENTRY_TEXTS.get(entry.event)
    text = make_text(entry.data) if make_text is not None else ""
    return f"{entry.utc[11:19]}  {text}" if text else ""


def _resumed_text(data: RunResumed) -> str:
    crash = data.get("crash")
    return f"the run was resumed{f' after a crash: {crash}' if crash else ''}"


def _entering_text(data: Entering) -> str:
    if "rule" in data:
        return f"held by the {interlock_text(data['rule'])} interlock: {data['why']}"
    # The line of the run's end states its end state already.
    return "" if data["state"] in END_STATES else f"{data['state']}{_at_pose(data.get('pose'))}"


def _left_off_text(data: LeftOff) -> str:
    return f"{data['state']} failed: {data['error']}" if "error" in data else ""


def _attempt_text(data: AttemptChecked) -> str:
    verdict = "accepted" if data["accepted"] else "; ".join(data["reasons"])
    return f"attempt {data['attempt']}{_at_pose(data['pose'])}: {verdict}"


def _command_text(data: Commanded) -> str:
    refused = "" if data["taken"] else f", refused: {data['why']}"
    return f"{data['word']} by {data.get('by', 'an unknown person')}{refused}"


def _end_text(data: RunEnded) -> str:
    return f"{data['how']}{': ' if data['why'] else ''}{data['why']}"


def _question_text(data: Asked) -> str:
    return f"question: {data['text']} ({data['default']} after {data['timeout_s']:g} s)"


def _interlock_released_text(data: InterlockReleased) -> str:
    return f"the {interlock_text(data['rule'])} interlock cleared after {data['held_s']:.0f} s"


def _at_pose(pose: int | None) -> str:
    return f" at pose {pose}" if pose else ""


_ENTRY_TEXTS: Mapping[str, Callable[[Any], str]] = {
    Event.RUN_STARTED: lambda _data: "the run began",
    Event.RUN_RESUMED: _resumed_text,
    Event.ENTERING: _entering_text,
    Event.LEFT_OFF: _left_off_text,
    Event.CAPTURE_STORED: lambda data: f"stored {data['capture']}",
    Event.ATTEMPT_CHECKED: _attempt_text,
    Event.COMMANDED: _command_text,
    Event.DEVIATION: lambda data: f"deviation: {data['what']}",
    Event.POSE_SKIPPED: lambda data: f"deviation: {data['what']}",
    Event.UNTIL_DECIDED: decision_text,
    Event.RUN_ENDED: _end_text,
    Event.ASKED: _question_text,
    Event.ANSWERED: lambda data: f"answer: {data['answer']} ({data['by']})",
    Event.INTERLOCK_RELEASED: _interlock_released_text,
    Event.SUPERVISOR_LOST: lambda _data: "the supervisor of this process has ended; the run continues",
}
"""Text of each kind of journal line that people read."""


def status_text(status: Status) -> str:
    """Return a status as text.

    Parameters
    ----------
    status
        The status.

    Returns
    -------
    str
        Lines of text.
    """
    most = "at most " if status.most_poses > status.poses else ""
    poses = f"{most}{status.most_poses}"
    at = f", pose {status.pose} of {poses} ({status.pose_name})" if status.pose else ""
    if status.running:
        held = (
            f", HELD by {status.held_by}"
            if status.held_by
            else ", WAITS FOR AN ANSWER"
            if status.question
            else ""
        )
        left = "" if status.left_s is None else f", about {clock_text(status.left_s)} left"
        head = f"running: {status.state}{at}{held}{left}"
    elif status.ended:
        head = f"{status.ended}{': ' if status.why else ''}{status.why}"
    else:
        head = f"interrupted (killed or power lost): {status.state}{at}"
    counts = f"{status.accepted} of {poses} poses recorded, {status.attempts} recordings"
    counts += f", {status.skipped} skipped" if status.skipped else ""
    counts += f", resumed {status.resumed} times" if status.resumed else ""
    simulated = "  SIMULATED" if status.simulated else ""
    lines = [f"Run {status.run_id}{simulated}", head, counts]
    lines += [f"Uncertainty after {status.uncertainty}"] if status.uncertainty else []
    lines += [f"Deviation: {what}" for what in status.deviations]
    return "\n".join([*lines, *(f"  {line}" for line in status.last), status.advice])
