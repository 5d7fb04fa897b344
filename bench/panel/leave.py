"""Whether a person may leave a run alone: the answer, and the reason. Says only what journal and folder show."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from bench.panel.process_state import ProcessState
from bench.panel.run_model import RunModel
from bench.run.interlocks import interlock_text
from bench.run.machine import END_STATES

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
    """Return whether a run can be left alone.

    now: The present time, with its time zone.
    """
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
