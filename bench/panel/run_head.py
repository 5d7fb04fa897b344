"""The upper part of a run's page as JSON: state, times, counts, last recording, devices, uncertainty, commands."""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError
from bench.base.home import home_folder
from bench.evidence.authorisation import known_authorisations
from bench.evidence.states import home_trust, shown_state
from bench.panel.run_model import RunModel
from bench.records.run_folder import is_sealed
from bench.records.storage import is_locked
from bench.run.heartbeat import CONTROL, HEARTBEAT, SLOW_STALL_LIMIT_S, SLOW_STATES
from bench.run.interlocks import interlock_text
from bench.run.machine import END_STATES

# Whether a process works on a run, when it last gave a sign of life, and the free disk space. Writes
# nothing.

_QUIET_LIMIT_S = 15.0


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
    return ProcessState(
        running,
        sealed,
        (folder / CONTROL).is_dir(),
        _quiet_s(folder, state),
        _free_bytes(folder),
    )


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


# Whether a person may leave a run alone: the answer, and the reason.

MAX_HOLD_H = 8
"""As `bench.run.states.MAX_HOLD_S`, in hours; that module opens devices, which this one must not."""
_GIGABYTE = 1e9
_POSES_OF_A_SERIES = 3


@dataclass(frozen=True)
class Leave:
    """Whether the run can be left alone."""

    safe: bool  # Whether nobody is needed
    text: str
    # Time from which somebody is needed, ISO 8601; empty if it is not known or nobody is.
    until_utc: str = ""


def may_leave(model: RunModel, process: ProcessState, now: datetime) -> Leave:
    """Return whether a run can be left alone."""
    history = model.history
    state = history.states[-1]["state"] if history.states else "idle"
    if not process.running:
        return _without_process(model)
    if history.ended or state in END_STATES:
        return Leave(True, "The run has ended; its process is about to end.")
    return _needs_a_person(model, process) or _needs_one_later(model, now)


def _without_process(model: RunModel) -> Leave:
    history = model.history
    if model.tail.fault or model.fault:
        return Leave(False, "The journal cannot be read further, so it is not known how the run ended.")
    if history.ended in {"finished", "aborted"}:
        return Leave(True, f"The run has {'finished' if history.ended == 'finished' else 'stopped'}.")
    if history.ended == "failed":
        return Leave(False, "The run has failed. Read why, remove the cause, then resume it.")
    if not model.lines:
        return Leave(False, "The run has not begun.")
    return Leave(
        False,
        "The run's process was killed or lost its power. Nothing in its journal says how it left the bench: look at the"
        " light and the stage, then resume the run.",
    )


def _needs_a_person(model: RunModel, process: ProcessState) -> Leave | None:
    """Return why a person is needed now; None if none is."""
    history = model.history
    if process.quiet_s is not None:
        return Leave(
            False, f"Its process has given no sign of life for {process.quiet_s:.0f} s. Look at the bench."
        )
    if history.question:
        return Leave(False, "The run waits for an answer.")
    if history.interlock:
        name, _, why = history.interlock.partition(":")
        return Leave(False, f"The {interlock_text(name)} interlock holds the run:{why}.")
    if history.holder:
        return Leave(False, _hold_text(model))
    if process.free_bytes is not None and _needed_bytes(model) > process.free_bytes:
        free, needed = process.free_bytes / _GIGABYTE, _needed_bytes(model) / _GIGABYTE
        return Leave(False, f"The disk has {free:.1f} GB free; the run may need {needed:.1f} GB.")
    return None


def _hold_text(model: RunModel) -> str:
    holder, states = model.history.holder, model.history.states
    if not states or states[-1]["state"] != "holding":
        return f"{holder} has asked for a hold. The run holds at its next safe point."
    return f"{holder} holds the run. It waits for a release; after {MAX_HOLD_H} h of holding it is aborted."


def _needs_one_later(model: RunModel, now: datetime) -> Leave:
    step = model.time_left.next_of(model.plan.prompts, model.history.done_steps)
    if step is not None:
        moment = now + timedelta(seconds=model.time_left.left_at_step_s(step))
        return Leave(False, "The run will ask a question.", moment.isoformat())
    bad = _failed_in_a_row(model)
    if bad >= _POSES_OF_A_SERIES:
        return Leave(False, f"The last {bad} poses were rejected. Look at their reasons.")
    return Leave(True, "The run needs nobody until its end.")


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
    poses = max(model.plan.most_poses, 1)
    done = len(model.history.accepted()) + len(model.history.skipped)
    return model.plan.most_bytes * max(0.0, 1.0 - done / poses)


Json = dict[str, Any]

_MOST_DEVIATIONS = 30
_MOST_DECISIONS = 200
_TONES = {"finished": "good", "aborted": "warn", "failed": "bad", "interrupted": "bad", "running": "busy"}


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
    if how == "finished" and not process.sealed and not history.started.get("rehearsal", False):
        return ("being sealed", "busy") if process.running else ("not sealed", "warn")
    return how, _TONES[how]


def head_of(model: RunModel, process: ProcessState, now: datetime) -> Json:
    """Return the upper part of a run's page."""
    history, plan = model.history, model.plan
    started = history.started
    verdict, tone = verdict_of(model, process)
    leave = may_leave(model, process, now)
    return {
        "id": started.get("id", model.folder.name),
        "sequence": started.get("sequence", ""),
        "station": started.get("station", ""),
        "operator": started.get("operator"),
        "simulated": bool(started.get("simulated", False)),
        "rehearsal": bool(started.get("rehearsal", False)),
        "camera": dict(history.devices.get("camera", {})),
        "verdict": verdict,
        "tone": tone,
        "running": process.running,
        "sealed": process.sealed,
        "evidence": _evidence(model.folder, now) if process.sealed else "",
        "ended": history.ended,
        "why": history.why,
        "remedy": history.failures[-1]["remedy"] if history.ended == "failed" and history.failures else "",
        "faults": [fault for fault in (model.tail.fault, model.fault, process.fault, plan.fault) if fault],
        "incomplete": model.tail.incomplete and not process.running,
        "read_share": round(model.tail.read_share, 3) if model.tail.more else 1.0,
        "leave": {"safe": leave.safe, "text": leave.text, "until_utc": leave.until_utc},
        **_state(model, process),
        **_times(model, process, now),
        **_counts(model),
        "deviations": history.deviations[-_MOST_DEVIATIONS:],
        "deviation_count": len(history.deviations),
        "gate_failures": model.gate_failures,
        "last": _last(model),
        "checked": _checked_place(model),
        "light": _light(model),
        "stage": _stage(model),
        "can": _possible(model, process),
        "decisions": [_decision(one) for one in history.decisions[-_MOST_DECISIONS:]],
        "solved": _solved(history.solved),
    }


def _state(model: RunModel, process: ProcessState) -> Json:
    history = model.history
    last = history.states[-1] if history.states else None
    interlock = history.interlock.partition(":")[0]
    row = model.rows.get(history.at_pose or 0)
    return {
        "state": last["state"] if last else "idle",
        "state_utc": last["utc"] if last else "",
        "pose": history.at_pose,
        "pose_name": row["name"] if row else "",
        "holder": history.holder if process.running else "",
        "interlock": interlock_text(interlock) if process.running else "",
        "question": _question(model) if process.running and history.question else None,
    }


def _question(model: RunModel) -> Json:
    timeout_s = model.asked.get("timeout_s")
    until = ""
    if timeout_s is not None and model.asked_utc:
        until = (datetime.fromisoformat(model.asked_utc) + timedelta(seconds=float(timeout_s))).isoformat()
    return {
        "text": model.history.question,
        "default": model.asked.get("default", ""),
        "until_utc": until,
        "answered": model.history.answer is not None,
    }


def _times(model: RunModel, process: ProcessState, now: datetime) -> Json:
    history = model.history
    ended_utc = history.states[-1]["utc"] if history.ended and history.states else ""
    going_on = process.running and not history.ended and not model.plan.fault
    if not going_on or (history.states and history.states[-1]["state"] in END_STATES):
        return {"started_utc": history.started_utc, "ended_utc": ended_utc, "left_s": None, "end_utc": ""}
    held = bool(history.holder or history.interlock or history.question)
    left_s = model.time_left.left_s(now, held=held)
    end_utc = "" if held else (now + timedelta(seconds=left_s)).isoformat(timespec="seconds")
    return {
        "started_utc": history.started_utc,
        "ended_utc": "",
        "left_s": round(left_s, 1),
        "end_utc": end_utc,
    }


def _counts(model: RunModel) -> Json:
    history = model.history
    known = len(model.rows)
    recordings, lost = len(history.attempts), sum(history.lost.values())
    return {
        "poses": known,
        "most_poses": model.plan.most_of(history, known),
        "accepted": len(history.accepted()),
        "skipped": len(history.skipped),
        "recordings": recordings + lost,
        "lost": lost,
        "retries": max(
            0, recordings + lost - len({*history.lost, *(a.pose_index for a in history.attempts)})
        ),
        "resumed": history.resumed,
    }


def _last(model: RunModel) -> Json | None:
    """Return the newest recording; its verdict only if that belongs to it."""
    stored, checked = model.last_stored, model.last_checked
    if not stored:
        return None
    found: Json = {
        "pose": stored["pose"],
        "pose_name": stored["pose_name"],
        "attempt": stored["attempt"],
        "utc": model.stored_utc,
        "facts": {
            name: stored.get("facts", {}).get(name)
            for name in ("events", "duration_s", "triggers", "temperature_c", "frames", "exposure_us")
            if stored.get("facts", {}).get(name) is not None
        },
        "checked": False,
    }
    if checked and (checked["pose"], checked["attempt"]) == (stored["pose"], stored["attempt"]):
        found |= {name: checked[name] for name in ("accepted", "reasons", "stars", "gates")}
        measured = checked.get("measured", {})
        found["edge_width_px"] = measured.get("edge_width_px")
        found["flicker_hz"] = measured.get("flicker_hz")
        found["checked"] = True
    elif checked:
        found["gates_before"] = checked.get("gates", [])
    return found


def _checked_place(model: RunModel) -> Json | None:
    """Return which recording was checked last; the run has left its picture."""
    checked = model.last_checked
    return {"pose": checked["pose"], "attempt": checked["attempt"]} if checked else None


def _light(model: RunModel) -> Json | None:
    """Return the light as it was read back at the last recording."""
    light = model.last_stored.get("light")
    return {"utc": model.stored_utc, "settings": dict(light)} if light else None


def _stage(model: RunModel) -> Json:
    return {
        "target_deg": dict(model.last_target_deg),
        "measured_deg": dict(model.last_stored.get("measured_deg", {})),
        "utc": model.stored_utc,
    }


def _possible(model: RunModel, process: ProcessState) -> Json:
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


def _decision(decided: Mapping[str, Any]) -> Json:
    chosen = decided.get("chosen", {})
    return {
        "poses": decided["poses"],
        "now": dict(decided["now"]),
        "wanted": dict(decided["wanted"]),
        "expected": dict(chosen.get("expected", {})),
        "next": chosen.get("pose_name", ""),
        "why": chosen.get("why") or decided.get("why") or decided.get("problem") or "",
        "ended": decided.get("ended", ""),
    }


def _solved(solved: Mapping[str, Any]) -> Json | None:
    if not solved:
        return None
    sigma = solved.get("sigma", {})
    values = [
        {"name": name, "value": value, "sigma": sigma[name]}
        for name, value in solved.get("values", {}).items()
        if name in sigma
    ]
    return {"model": solved.get("model", ""), "rms_px": solved.get("rms_px"), "parameters": values}


def _evidence(folder: Path, now: datetime) -> str:
    """Return the state of the folder as one line."""
    home = home_folder()
    return shown_state(folder, home_trust(home), now, known_authorisations(home)).text
