"""Compares the moves and the devices of a run's journal with the bytes on the wires."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from bench.base.bounded_json import parse_json
from bench.base.errors import StorageError
from bench.evidence.findings import Findings
from bench.plan.job import Job
from bench.records.events import Event
from bench.records.journal_entry import Entry
from bench.records.reading import read_bounded
from bench.records.run_folder import JOURNAL
from bench.records.written import WIRE_LOG

_WITH_STAGE = frozenset({"homing", "slewing", "parking"})
"""States in which the program speaks to the stage."""
_SLACK_S = 1e-3
_MOST_LOG_BYTES = 64 << 20
"""Logs are rotated at 8 MB."""


def check_wire_log(folder: Path, entries: Sequence[Entry], job: Job, found: Findings) -> None:
    """Check that the wire log holds what the journal's moves must have left in it, and the stage's serial numbers.

    Every stage is moved over a wire, so each move of the journal has bytes in the log at its time. The log keeps about
    the last 32 MB; earlier moves are not checked.

    found: Findings; faults are added.
    """
    moves = list(_moves(entries))
    try:
        times, replies, ports = _read_logs(folder)
    except (StorageError, ValueError, LookupError, TypeError) as error:
        found.fault("wire", WIRE_LOG, f"the wire log cannot be read ({error!r})")
        return
    if moves and not times:
        found.fault("wire", WIRE_LOG, "it holds no bytes, though the journal tells of moves of the stage")
        return
    for begin_s, end_s, entry in moves:
        if begin_s < times[0]:  # older bytes are not kept
            continue
        at = bisect_left(times, begin_s - _SLACK_S)
        if at == len(times) or times[at] > end_s + _SLACK_S:
            what = f"it holds no bytes of the time in which the journal tells of {entry.data['state']}"
            found.fault("wire", WIRE_LOG, f"{what} ({JOURNAL}:{entry.seq + 1})")
            return
    station = job.station
    stated = {*station.stage.ports, *station.light.ports}
    if times and not station.needs_simulated_bench and not ports & stated:
        what = f"its ports {sorted(ports)} are not those of the station, {sorted(stated)}"
        found.fault("wire", WIRE_LOG, what)
    _check_serials(entries, job, replies, found)


def _moves(entries: Sequence[Entry]) -> Iterator[tuple[float, float, Entry]]:
    """Yield begin and end of each move, monotonic time in s, with its line."""
    begun: Entry | None = None
    for entry in entries:
        if entry.event == Event.ENTERING:
            begun = entry if entry.data.get("state") in _WITH_STAGE else None
        elif entry.event == Event.LEFT_OFF and begun is not None:
            if "error" not in entry.data and entry.data.get("state") == begun.data["state"]:
                yield begun.mono_s, entry.mono_s, begun
            begun = None


def _read_logs(folder: Path) -> tuple[list[float], str, set[str]]:
    """Return the sorted times of all bytes, s, all bytes of devices, and the ports. Raises StorageError, ValueError."""
    times: list[float] = []
    replies: list[str] = []
    ports: set[str] = set()
    for path in sorted(folder.glob(f"{WIRE_LOG}*")):
        for line in read_bounded(path, _MOST_LOG_BYTES).splitlines():
            record: dict[str, Any] = parse_json(line.decode("ascii", "replace"))
            times.append(float(record["t"]))
            ports.add(str(record["port"]))
            if record["dir"] == "<":
                replies.append(str(record["bytes"]))
    return sorted(times), "".join(replies), ports


def _check_serials(entries: Sequence[Entry], job: Job, replies: str, found: Findings) -> None:
    """Compare the serial numbers of stage and light with the replies of devices that speak in text."""
    station = job.station
    in_text = {"stage": station.stage.driver == "zaber_ascii", "light": station.light.driver == "scpi"}
    for entry in entries:
        if entry.event != Event.DEVICES:
            continue
        for part in (part for part, is_text in in_text.items() if is_text):
            told = entry.data.get(part) or []
            for identity in told if isinstance(told, list) else [told]:
                serial = str(identity.get("serial") or "")
                if serial and serial not in replies:
                    what = (
                        f"no device told the serial number {serial}, which the journal states for the {part}"
                    )
                    found.fault("wire", WIRE_LOG, f"{what} ({JOURNAL}:{entry.seq + 1})")
