"""How a run stands, for somebody who looks on from another terminal: read from its folder, which stays untouched.

What is told comes from the journal and ``plan.json``; whether a process works on it, from the folder's lock.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

from bench.base.errors import RunFolderError, StorageError
from bench.records.events import Event
from bench.records.folder_lock import is_locked
from bench.records.history import History, replay
from bench.records.journal import read_journal
from bench.records.journal_entry import Entry
from bench.records.run_folder import JOURNAL, PLAN, is_sealed
from bench.records.storage import storage_errors
from bench.run.interlock_text import interlock_text
from bench.run.machine import END_STATES
from bench.terminal.duration import clock_text

LAST_LINES = 5
FOLLOW_S = 0.5


@dataclass(frozen=True)
class Status:
    """How a run stands.

    Attributes
    ----------
    run_id, folder, simulated
        Its name and place, and whether any device is simulated.
    running, sealed
        Whether a process works on it, and whether it is finished and sealed.
    state
        The last state entered; where no process works on it any more, the state in which it was left.
    ended, why
        ``finished``, ``aborted`` or ``failed``, and why; empty while it has not ended.
    pose, pose_name
        The pose at work; None between poses.
    poses, accepted, skipped, attempts
        How many poses there are, are recorded, are skipped; how many recordings were made.
    left_s
        Expected time to its end, s; None where none is expected.
    held_by
        Who, or which interlock, holds it, and why; empty while nothing does.
    question
        What it asks the operator; empty while it asks nothing.
    resumed, deviations
        How often it was taken up again; what went otherwise than the sequence says.
    last
        Its last lines, in words, the newest last.
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
    accepted: int
    skipped: int
    attempts: int
    left_s: float | None
    held_by: str
    question: str
    resumed: int
    deviations: Sequence[str]
    last: Sequence[str]
    advice: str

    def to_dict(self) -> dict[str, Any]:
        """Give it as JSON carries it."""
        return {"schema": "starbench/status/1", **asdict(self)}


def read_status(folder: Path, utc_now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> Status:
    """Look at a run; nothing is changed, and no process of it is disturbed.

    Raises
    ------
    RunFolderError
        When there is no run.
    JournalBroken
        When its journal does not hold.
    StorageError
        When it cannot be read.
    """
    if not (folder / JOURNAL).is_file():
        raise RunFolderError(
            f"This is not a run folder: it has no {JOURNAL}.",
            where=str(folder),
            remedy="Name the folder a run was written to.",
        )
    entries, _ = read_journal(folder / JOURNAL)
    return _status(folder, entries, utc_now())


def follow(folder: Path, sleep: Callable[[float], None] = time.sleep) -> Iterator[Status]:
    """Look at a run again and again while a process works on it; the last look is at how it ended."""
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
        accepted=len(history.accepted()),
        skipped=len(history.skipped),
        attempts=len(history.attempts) + sum(history.lost.values()),
        left_s=_left_s(history, plan, entries, now) if going_on else None,
        held_by=held_by,
        question=history.question if running else "",
        resumed=history.resumed,
        deviations=tuple(history.deviations),
        last=_last_lines(entries),
        advice=_advice(folder, history, running=running, sealed=sealed),
    )


def _plan_of(folder: Path) -> Mapping[str, Any]:
    try:
        with storage_errors(folder / PLAN):
            plan: dict[str, Any] = json.loads((folder / PLAN).read_text(encoding="utf-8"))
        return {name: plan[name] for name in ("poses", "steps", "duration_s", "simulated")}
    except (StorageError, ValueError, KeyError, TypeError) as error:
        raise RunFolderError(
            f"{PLAN} cannot be read.", where=str(folder), remedy="It is not what the run began with."
        ) from error


def _left_s(history: History, plan: Mapping[str, Any], entries: Sequence[Entry], now: datetime) -> float:
    """Count the plan's time down: from the last step done, by the time since then; nothing while it is held."""
    done_s = {step["number"]: step["done_after_s"] for step in plan["steps"]}
    begun_s = max((done_s.get(number, 0.0) for number in history.done_steps), default=0.0)
    marks = (e for e in reversed(entries) if e.event in {Event.STEP_DONE, Event.RUN_STARTED})
    mark = next(marks, None)
    since = (
        0.0 if mark is None or history.holder else (now - datetime.fromisoformat(mark.utc)).total_seconds()
    )
    return round(max(0.0, plan["duration_s"] - begun_s - max(0.0, since)), 1)


def _held_by(history: History) -> str:
    if history.rule:
        name, _, why = history.rule.partition(":")
        return f"the {interlock_text(name)} interlock:{why}"
    return history.holder


def _advice(folder: Path, history: History, *, running: bool, sealed: bool) -> str:
    if sealed:
        return f"Finished and sealed; check it with: starbench verify {folder}"
    if running and history.rule:
        return (
            "Nothing: it goes on by itself once that is over, or ends safely when it has held for too long."
        )
    if running and history.question:
        return f"It asks: {history.question} Answer with: starbench answer {folder} yes (or no)"
    if running and history.holder:
        return f"Held by {history.holder}; let it go on with: starbench release {folder}"
    if running:
        return f"Nothing. To stop it safely: starbench abort {folder}"
    return f"No process works on it; go on with: starbench resume {folder}"


def _last_lines(entries: Sequence[Entry]) -> tuple[str, ...]:
    words = (text for text in map(line_text, reversed(entries)) if text)
    return tuple(reversed(tuple(islice(words, LAST_LINES))))


def line_text(entry: Entry) -> str:
    """Say what a line of a journal tells, in words; empty for lines that only machines need."""
    text = _words(entry)
    return f"{entry.utc[11:19]}  {text}" if text else ""


def _words(entry: Entry) -> str:
    data, text = entry.data, ""
    pose = f" at pose {data['pose']}" if data.get("pose") else ""
    match entry.event:
        case Event.RUN_STARTED:
            text = "the run was begun"
        case Event.RUN_RESUMED:
            crash = data.get("crash")
            text = f"the run was taken up again{f', after a crash: {crash}' if crash else ''}"
        case Event.ENTERING if "rule" in data:
            text = f"held by the {interlock_text(data['rule'])} interlock: {data['why']}"
        case Event.ENTERING if data["state"] not in END_STATES:  # the line of the end says that once
            text = f"{data['state']}{pose}"
        case Event.LEFT_OFF if "error" in data:
            text = f"{data['state']} failed: {data['error']}"
        case Event.CAPTURE_STORED:
            text = f"stored {data['capture']}"
        case Event.ATTEMPT_CHECKED:
            judged = "accepted" if data["accepted"] else "; ".join(data["reasons"])
            text = f"attempt {data['attempt']}{pose}: {judged}"
        case Event.COMMANDED:
            not_taken = "" if data["taken"] else f", not taken: {data['why']}"
            text = f"{data['word']} by {data.get('by', 'somebody')}{not_taken}"
        case Event.DEVIATION | Event.POSE_SKIPPED:
            text = f"deviation: {data['what']}"
        case Event.RUN_ENDED:
            text = f"{data['how']}{': ' if data['why'] else ''}{data['why']}"
        case _:
            text = _words_of_waiting(entry)
    return text


def _words_of_waiting(entry: Entry) -> str:
    data, text = entry.data, ""
    match entry.event:
        case Event.ASKED:
            text = f"asks: {data['text']} ({data['default']} after {data['timeout_s']:g} s)"
        case Event.ANSWERED:
            text = f"answered: {data['answer']} ({data['by']})"
        case Event.INTERLOCK_RELEASED:
            text = f"the {interlock_text(data['rule'])} interlock lets go after {data['held_s']:.0f} s"
        case Event.SUPERVISOR_LOST:
            text = "what watched this process is gone; the run goes on"
    return text


def status_text(status: Status) -> str:
    """Say how a run stands, for people."""
    at = f", pose {status.pose} of {status.poses} ({status.pose_name})" if status.pose else ""
    if status.running:
        held = f", HELD by {status.held_by}" if status.held_by else ", ASKS" if status.question else ""
        left = "" if status.left_s is None else f", {clock_text(status.left_s)} left"
        head = f"running: {status.state}{at}{held}{left}"
    elif status.ended:
        head = f"{status.ended}{': ' if status.why else ''}{status.why}"
    else:
        head = f"killed or cut off: {status.state}{at}"
    counts = f"{status.accepted} of {status.poses} poses recorded, {status.attempts} recordings"
    counts += f", {status.skipped} skipped" if status.skipped else ""
    counts += f", resumed {status.resumed} times" if status.resumed else ""
    simulated = "  SIMULATED" if status.simulated else ""
    lines = [f"Run {status.run_id}{simulated}", head, counts]
    lines += [f"Deviation: {what}" for what in status.deviations]
    return "\n".join([*lines, *(f"  {line}" for line in status.last), status.advice])
