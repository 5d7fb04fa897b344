"""Journal lines as text for people: time and a short sentence. Lines that only programs need have no text."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from bench.base.device_ends import DeviceEnd
from bench.records.device_events import DevicesLeft
from bench.records.events import (
    Asked,
    AttemptChecked,
    Commanded,
    ComputerBusy,
    Entering,
    Event,
    InterlockReleased,
    LeftOff,
    RunEnded,
    RunResumed,
)
from bench.records.journal_entry import Entry
from bench.report.until_text import decision_text
from bench.run.interlocks import interlock_text
from bench.run.machine import END_STATES


def line_text(entry: Entry) -> str:
    """Return a journal line as text.

    Returns: Time and text; empty for lines that only programs need.
    """
    make_text = _ENTRY_TEXTS.get(entry.event)
    text = make_text(entry.data) if make_text is not None else ""
    return f"{entry.utc[11:19]} UTC  {text}" if text else ""


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
    typed = " (typed)" if data.get("known_by") == "typed" else ""
    return f"{data['word']} by {data.get('by', 'an unknown person')}{typed}{refused}"


def _end_text(data: RunEnded) -> str:
    ends = [DeviceEnd.from_dict(end) for end in data.get("devices", ())]
    used = any(end.state != "never opened" for end in ends)
    unsure = "".join(f"; {end.text}" for end in ends if used and end.state != "confirmed safe")
    return f"{data['how']}{': ' if data['why'] else ''}{data['why']}{unsure}"


def _left_text(data: DevicesLeft) -> str:
    ends = [DeviceEnd.from_dict(end) for end in data["devices"]]
    unsure = [end.text for end in ends if end.state != "confirmed safe"]
    return f"the devices after the last step that needs them: {'; '.join(unsure) or 'all confirmed safe'}"


def _question_text(data: Asked) -> str:
    return f"question: {data['text']} ({data['default']} after {data['timeout_s']:g} s)"


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
    Event.LEFT_OFF: _left_off_text,
    Event.CAPTURE_STORED: lambda data: f"stored {data['capture']}",
    Event.ATTEMPT_CHECKED: _attempt_text,
    Event.COMMANDED: _command_text,
    Event.DEVIATION: lambda data: f"deviation: {data['what']}",
    Event.POSE_SKIPPED: lambda data: f"deviation: {data['what']}",
    Event.UNTIL_DECIDED: decision_text,
    Event.RUN_ENDED: _end_text,
    Event.DEVICES_LEFT: _left_text,
    Event.ASKED: _question_text,
    Event.ANSWERED: lambda data: f"answer: {data['answer']} ({data['by']})",
    Event.INTERLOCK_RELEASED: _interlock_released_text,
    Event.COMPUTER_BUSY: _busy_text,
    Event.SUPERVISOR_LOST: lambda _data: "the supervisor of this process has ended; the run continues",
}
"""Text of each kind of journal line that people read."""
