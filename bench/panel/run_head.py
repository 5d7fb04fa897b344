"""The upper part of a run's page as JSON: state, times, counts, last recording, devices, uncertainty, commands."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from bench.base.home import home_folder
from bench.evidence.ledger_authorisation import known_authorisations
from bench.evidence.shown_state import home_trust, shown_state
from bench.panel.leave import may_leave
from bench.panel.process_state import ProcessState
from bench.panel.run_model import RunModel
from bench.run.interlocks import interlock_text
from bench.run.machine import END_STATES

Json = dict[str, Any]

_MOST_DEVIATIONS = 30
_MOST_DECISIONS = 200
_TONES = {"finished": "good", "aborted": "warn", "failed": "bad", "interrupted": "bad", "running": "busy"}


def verdict_of(model: RunModel, process: ProcessState) -> tuple[str, str]:
    """Return how a run stands, in one or two words, and the tone of it.

    Returns: The words; ``good``, ``warn``, ``bad`` or ``busy``.
    """
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
    """Return the upper part of a run's page.

    now: The present time, with its time zone.
    """
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
    interlock, _, why = history.interlock.partition(":")
    row = model.rows.get(history.at_pose or 0)
    return {
        "state": last["state"] if last else "idle",
        "state_utc": last["utc"] if last else "",
        "pose": history.at_pose,
        "pose_name": row["name"] if row else "",
        "holder": history.holder if process.running else "",
        "interlock": interlock_text(interlock) if process.running else "",
        "interlock_why": why.strip(),
        "held_since_utc": model.held_since_utc,
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
    known, most = len(model.rows), model.plan.most_poses
    ended = {decided["until"] for decided in history.decisions if "ended" in decided}
    if all(until["first"] in ended for until in model.plan.untils):
        most = known
    recordings, lost = len(history.attempts), sum(history.lost.values())
    return {
        "poses": known,
        "most_poses": max(known, most),
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
        "capture": stored["capture"],
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
