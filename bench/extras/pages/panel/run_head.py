"""The upper part of a run's page as JSON: state, times, counts, last recording, devices, uncertainty, commands."""

from __future__ import annotations

import shutil
import time
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from bench.base.errors import BenchError
from bench.extras.pages.panel.run_model import RunModel
from bench.extras.pages.panel.shown_run import (
    CountsData,
    LastRecording,
    LeaveData,
    QuestionData,
    RunBrief,
    RunHead,
    StateData,
    TimesData,
)
from bench.record.events import Asked, AttemptChecked, CaptureStored
from bench.record.folder_lock import is_locked
from bench.record.history import History
from bench.record.run_folder import is_sealed
from bench.run.heartbeat import CONTROL, HEARTBEAT, SLOW_STALL_LIMIT_S, SLOW_STATES
from bench.run.interlocks import interlock_text
from bench.run.machine import END_STATES, MAX_HOLD_S
from bench.run.status import evidence_text
from bench.wording.causes import cause_sentences

_QUIET_LIMIT_S = 15.0  # Longer than a worker may be silent before its batch ends it
_GIGABYTE = 1e9  # Bytes, as disks are sold
_POSES_OF_A_SERIES = 3  # One bad pose is chance, three in a row a cause

_MOST_DEVIATIONS = 30  # A screen
_MOST_DECISIONS = 200  # A curve of more is not told from one of these
#: By the end of a run, and by the verdict of its report.
_TONES = {
    "finished": "good",
    "aborted": "warn",
    "failed": "bad",
    "interrupted": "bad",
    "running": "busy",
    "pass": "good",
    "marginal": "warn",
    "fail": "bad",
}


@dataclass(frozen=True)
class ProcessState:
    """What the file system tells of a run's process."""

    running: bool = False  # Whether a process works on the run
    sealed: bool = False  # Whether the run is sealed
    takes_commands: bool = False  # Whether the process accepts commands
    # Time since the last sign of life of its work, s, if it is longer than it should be; None otherwise.
    quiet_s: float | None = None
    free_bytes: int | None = None  # Free space of the disk; None if it is not known
    fault: str = ""  # Why the folder cannot be looked at; empty if it can


def look_at_process(folder: Path, state: str) -> ProcessState:
    """Look at the process of a run; a folder that cannot be read gives a ``fault``."""
    try:
        running = is_locked(folder)
    except BenchError as error:
        return ProcessState(fault=str(error))
    sealed = is_sealed(folder)
    if not running:
        return ProcessState(sealed=sealed)
    takes_commands = (folder / CONTROL).is_dir()
    return ProcessState(running, sealed, takes_commands, _quiet_s(folder, state), _free_bytes(folder))


def _quiet_s(folder: Path, state: str) -> float | None:
    """Return for how long the heartbeat is late; the states in which nothing moves may take long."""
    try:
        age_s = time.time() - (folder / CONTROL / HEARTBEAT).stat().st_mtime
    except OSError:
        return None
    limit_s = SLOW_STALL_LIMIT_S if state in SLOW_STATES else _QUIET_LIMIT_S
    return age_s if age_s > limit_s else None


def _free_bytes(folder: Path) -> int | None:
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


def _leave(safe: bool, text: str, until_utc: str = "") -> LeaveData:
    return {"safe": safe, "text": text, "until_utc": until_utc}


def may_leave(model: RunModel, process: ProcessState, now: datetime) -> LeaveData:
    """Return whether a run can be left alone."""
    history = model.history
    state = history.states[-1]["state"] if history.states else "idle"
    if not process.running:
        return _without_process(model)
    if history.ended or state in END_STATES:
        return _leave(True, "The run has ended; its process is about to end.")
    return _needs_a_person(model, process) or _needs_one_later(model, now)


def _without_process(model: RunModel) -> LeaveData:
    history = model.history
    if model.tail.fault or model.fault:
        return _leave(False, "The journal cannot be read further, so it is not known how the run ended.")
    if unsafe := _unsafe(history):
        return _leave(False, f"Check the bench. {' '.join(unsafe)}")
    if history.ended in {"finished", "aborted"}:
        return _leave(True, f"The run has {'finished' if history.ended == 'finished' else 'stopped'}.")
    if history.ended == "failed":
        return _leave(False, "The run has failed. Read why, and do what is said there.")
    if not model.lines:
        return _leave(False, "The run has not begun.")
    return _leave(
        False,
        "The run's process was killed or lost its power. Its journal does not say how it left the bench. Look at the"
        " light and the stage, then resume the run.",
    )


def _unsafe(history: History) -> list[str]:
    """Return a sentence for stage and light each if it did not confirm at the run's end that it is safe."""
    return [
        end.text for end in history.devices_at_end if end.state == "not confirmed" and end.device != "camera"
    ]


def _needs_a_person(model: RunModel, process: ProcessState) -> LeaveData | None:
    """Return why a person is needed now; None if none is."""
    history = model.history
    if process.quiet_s is not None:
        return _leave(
            False, f"Its process has given no sign of life for {process.quiet_s:.0f} s. Look at the bench."
        )
    if history.question:
        return _leave(False, "The run waits for an answer.")
    if history.interlock:
        held = history.interlock
        return _leave(False, f"The {interlock_text(held.rule)} interlock holds the run: {held.why}.")
    if history.holder:
        return _leave(False, _hold_text(model))
    if process.free_bytes is not None and _needed_bytes(model) > process.free_bytes:
        free, needed = process.free_bytes / _GIGABYTE, _needed_bytes(model) / _GIGABYTE
        return _leave(False, f"The disk has {free:.1f} GB free; the run may need {needed:.1f} GB.")
    return None


def _hold_text(model: RunModel) -> str:
    holder, states = model.history.holder, model.history.states
    if not states or states[-1]["state"] != "holding":
        return f"{holder} has asked for a hold. The run holds at its next safe point."
    return f"{holder} holds the run. It waits for a release; after {MAX_HOLD_S / 3600:g} h of holding it is aborted."


def _needs_one_later(model: RunModel, now: datetime) -> LeaveData:
    step = model.time_left.next_of(model.plan.prompts, model.history.done_steps)
    if step is not None:
        moment = now + timedelta(seconds=model.time_left.left_at_step_s(step))
        return _leave(False, "The run will ask a question.", moment.isoformat())
    bad = _failed_in_a_row(model)
    if bad >= _POSES_OF_A_SERIES:
        return _leave(False, f"The last {bad} poses were rejected. Look at their reasons.")
    return _leave(True, "The run needs nobody until its end.")


def _failed_in_a_row(model: RunModel) -> int:
    count = 0
    for row in model.newest_rows():
        if row["state"] in {"at work", "planned"}:
            continue
        if row["state"] == "accepted":
            break
        count += 1
    return count


def _needed_bytes(model: RunModel) -> float:
    """Return the disk space that the poses still to come may need."""
    of_pose = model.plan.most_bytes / max(model.plan.most_poses, 1)
    done = len(model.history.accepted()) + len(model.history.skipped)
    return of_pose * max(0, model.plan.count_poses(model.history).most - done)


def verdict_of(model: RunModel, process: ProcessState) -> tuple[str, str]:
    """Return how a run stands, in one or two words, and its tone: ``good``, ``warn``, ``bad`` or ``busy``."""
    history = model.history
    if process.running and not history.ended:
        if history.question:
            return "asks", "warn"
        return ("held", "warn") if history.interlock or history.holder else ("running", "busy")
    if model.tail.fault or model.fault:
        return "not readable", "bad"
    how = history.ended or "interrupted"
    tone = _TONES[history.verdict["kind"] if how == "finished" and history.verdict else how]
    needs_seal = how == "finished" and not process.sealed and not history.started.get("rehearsal", False)
    if needs_seal and tone != "bad":
        return ("being sealed", "busy") if process.running else ("not sealed", "warn")
    return how, tone


def brief_of(model: RunModel, process: ProcessState, now: datetime) -> RunBrief:
    """Return what the list of a folder shows of a run, too."""
    history = model.history
    started = history.started
    verdict, tone = verdict_of(model, process)
    return {
        "id": started.get("id", model.folder.name),
        "sequence": started.get("sequence", ""),
        "station": started.get("station", ""),
        "operator": started.get("operator"),
        "simulated": bool(started.get("simulated", False)),
        "rehearsal": bool(started.get("rehearsal", False)),
        "verdict": verdict,
        "tone": tone,
        "running": process.running,
        "why": history.why,
        "headline": history.verdict["headline"] if history.verdict else "",
        "unsafe": [] if process.running else _unsafe(history),
        "deviation_count": len(history.deviations),
        "leave": may_leave(model, process, now),
        **_state(model, process),
        **_times(model, process, now),
        **_counts(model),
    }


def head_of(model: RunModel, process: ProcessState, now: datetime) -> RunHead:
    """Return the upper part of a run's page."""
    history = model.history
    failure = history.failure
    left_s = _left_s(model, process, now)
    return {
        **brief_of(model, process, now),
        "camera": dict(history.devices.get("camera", {})),
        "sealed": process.sealed,
        "evidence": evidence_text(model.folder, now) if process.sealed else "",
        "ended": history.ended,
        "why": failure.what if failure else history.why,
        "remedy": failure.remedy if failure else "",
        "faults": faults_of(model, process),
        "incomplete": model.tail.incomplete and not process.running,
        "read_share": round(model.tail.read_share, 3) if model.tail.more else 1.0,
        "left_s": None if left_s is None else round(left_s, 1),
        "deviations": history.deviations[-_MOST_DEVIATIONS:],
        "gate_failures": model.gate_failures,
        "last": _last(model),
        "target_deg": dict(model.last_target_deg),
        "can": _possible(model, process),
        "decisions": history.decisions[-_MOST_DECISIONS:],
        "solved": history.solved or None,
        "causes": cause_sentences(history.solved.get("causes", ())),
    }


def faults_of(model: RunModel, process: ProcessState) -> list[str]:
    """Return why a run cannot be shown completely."""
    return [fault for fault in (model.tail.fault, model.fault, process.fault, model.plan.fault) if fault]


def _state(model: RunModel, process: ProcessState) -> StateData:
    history = model.history
    last = history.states[-1] if history.states else None
    row, asked = model.rows.get(history.at_pose or 0), model.asked
    return {
        "state": last["state"] if last else "idle",
        "state_utc": last["utc"] if last else "",
        "pose": history.at_pose,
        "pose_name": row["name"] if row else "",
        "holder": history.holder if process.running else "",
        "interlock": interlock_text(history.interlock.rule) if process.running and history.interlock else "",
        "question": _question(model, asked) if process.running and history.question and asked else None,
    }


def _question(model: RunModel, asked: Asked) -> QuestionData:
    timeout_s, until = asked["timeout_s"], ""
    if timeout_s is not None:
        until = (datetime.fromisoformat(model.asked_utc) + timedelta(seconds=timeout_s)).isoformat()
    return {"text": model.history.question, "default": asked["default"], "until_utc": until}


def _left_s(model: RunModel, process: ProcessState, now: datetime) -> float | None:
    """Return how much work is left, s; None where no end is expected."""
    history = model.history
    if not process.running or history.ended or model.plan.fault:
        return None
    if history.states and history.states[-1]["state"] in END_STATES:
        return None
    return model.time_left.left_s(now, held=history.waits)


def _times(model: RunModel, process: ProcessState, now: datetime) -> TimesData:
    history = model.history
    left_s = _left_s(model, process, now)
    expected = now + timedelta(seconds=left_s) if left_s is not None and not history.waits else None
    return {
        "started_utc": history.started_utc,
        "ended_utc": history.states[-1]["utc"] if history.ended and history.states else "",
        "end_utc": expected.isoformat(timespec="seconds") if expected is not None else "",
    }


def _counts(model: RunModel) -> CountsData:
    history = model.history
    poses = model.plan.count_poses(history)
    recordings, lost = len(history.attempts), sum(history.lost.values())
    return {
        "poses": poses.known,
        "most_poses": poses.most,
        "poses_text": poses.text,
        "accepted": len(history.accepted()),
        "skipped": len(history.skipped),
        "recordings": recordings + lost,
        "retries": recordings + lost - len({*history.lost, *(a.pose_index for a in history.attempts)}),
        "resumed": history.resumed,
    }


def _last(model: RunModel) -> LastRecording | None:
    """Return the newest recording; its verdict only if that belongs to it."""
    stored, checked = model.last_stored, model.last_checked
    if stored is None:
        return None
    is_own = checked is not None and _place(checked) == _place(stored)
    return {
        "utc": model.stored_utc,
        "stored": stored,
        "checked": checked if is_own else None,
        "before": None if is_own else checked,
    }


def _place(recording: CaptureStored | AttemptChecked) -> tuple[int, int]:
    return recording["pose"], recording["attempt"]


def _possible(model: RunModel, process: ProcessState) -> dict[str, bool]:
    """Return which commands make sense now; the run itself decides on each."""
    history = model.history
    takes = process.running and process.takes_commands and not history.ended
    return {
        "hold": takes and not history.holder,
        "release": takes and bool(history.holder),
        "skip": takes,
        "abort": takes,
        "answer": takes and bool(history.question) and history.answer is None,
    }
