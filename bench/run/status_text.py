"""Status of a run as lines of text, for the terminal, messages and the panel."""

from __future__ import annotations

from bench.base.device_ends import DeviceEnd
from bench.run.machine import END_STATES
from bench.run.status import Status
from bench.terminal.duration import clock_text
from bench.terminal.wording import counted, times

_WORTH_TELLING_S = 5.0
"""A run that has ended tells how late the computer was if it lost more than this, s."""


def status_text(status: Status) -> str:
    """Return a status as text."""
    return "\n".join([*head_lines(status), *(f"  {line}" for line in status.last), status.advice])


def head_lines(status: Status) -> list[str]:
    """Return the first part of a status as text: state, counts, uncertainty and deviations."""
    poses = f"{'at most ' if status.most_poses > status.poses else ''}{status.most_poses}"
    counts = f"{status.accepted} of {poses} poses recorded, {counted(status.attempts, 'recording')}"
    counts += f", {status.skipped} skipped" if status.skipped else ""
    counts += f", resumed {times(status.resumed)}" if status.resumed else ""
    lines = [f"Run {status.run_id}{'  SIMULATED' if status.simulated else ''}", _state(status, poses), counts]
    told = {"Uncertainty after": status.uncertainty, "Result:": status.result, **_busy(status)}
    lines += [f"{name} {text}" for name, text in told.items() if text]
    lines += _unasked(status)
    lines += [f"Evidence: {status.evidence}"] if status.ended and not status.running else []
    return [*lines, *(f"Deviation: {what}" for what in status.deviations)]


def _state(status: Status, poses: str) -> str:
    """Return the state of a run as one line."""
    at = f", pose {status.pose} of {poses} ({status.pose_name})" if status.pose else ""
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
    return f"interrupted (killed or power lost): {status.state}{at}"


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
    ends = [] if status.ended else [DeviceEnd.from_dict(one) for one in status.devices]
    advice = [end.advice for end in ends if end.state == "not confirmed" and end.advice]
    if not advice:
        return []
    return [" ".join(["CHECK THE BENCH: the process ended before it could ask the devices.", *advice])]
