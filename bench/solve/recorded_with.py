"""Compares the recordings of a sealed run with its journal: heads, sizes, and what follows the last event.

Behind the last event a camera writes time words only. Nothing is decoded, so this is quick.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import numpy as np

from bench.evidence.findings import Findings
from bench.record.events import Event
from bench.record.journal_line import Entry
from bench.record.run_folder import JOURNAL
from bench.record.stored_run import StoredRun
from drivers.camera.raw_header import MAX_HEADER_BYTES, RawHeader, parse_header
from drivers.errors import DriverError

_RAW: Final = ".raw"
_LONGEST_SHOWN: Final = 60
_KNOWN_KEYS: Final = frozenset(
    (
        *("camera_integrator_name", "integrator_name", "plugin_integrator_name", "plugin_name", "end"),
        *("date", "Date", "evt", "format", "geometry", "generation", "sensor_generation", "sensor_name"),
        *("firmware_version", "serial_number", "subsystem_ID", "system_ID"),
    )
)
"""Keys of heads that cameras and their software write (Prophesee, "RAW File Format")."""
_CLOCKS: Final = timedelta(hours=15)
"""A head states the time of the computer without its zone, which is at most 14 h from UTC."""
_DATE: Final = "%Y-%m-%d %H:%M:%S"
_OF_TIME: Final = frozenset({0x6, 0x8, 0xE, 0xF})
"""Types of EVT3 words that hold no event: times, and what the camera says of itself."""
_MOST_OTHERS: Final = 16
"""Words of a row or a vector whose events were cut off when the recording ended."""
_BLOCK_WORDS: Final = 1 << 19  # 1 MB: the last time stamp stands in the last block of nearly every file


def check_recorded_with(folder: Path) -> Findings:
    """Compare each recording with what the journal states of it."""
    findings = Findings()
    run = StoredRun(folder)
    camera = run.history.devices.get("camera") or {}
    for entry in run.entries:
        if entry.event == Event.CAPTURE_STORED:
            _check_one(folder / str(entry.data["capture"]), entry, camera, findings)
    return findings


def _check_one(path: Path, entry: Entry, camera: Mapping[str, Any], findings: Findings) -> None:
    name, facts = str(entry.data["capture"]), entry.data.get("facts") or {}
    stated = {key: facts.get(key) for key in ("serial", "width", "height") if key in facts}
    for key, value in stated.items():
        if key in camera and camera[key] != value:
            what = f"it was recorded with a camera whose {key} is {value}; the journal's camera has {camera[key]}"
            findings.fault("recording", name, what)
    if not path.is_file():
        return  # the journal tells that it was lost
    size = path.stat().st_size
    if "bytes" in facts and facts["bytes"] != size:
        what = f"it has {size} bytes; the camera had written {facts['bytes']} ({JOURNAL}:{entry.seq + 1})"
        findings.fault("recording", name, what)
    if path.suffix == _RAW:
        _check_raw(path, stated, entry, findings)


def _check_raw(path: Path, stated: Mapping[str, Any], entry: Entry, findings: Findings) -> None:
    """Compare the head of a RAW file with what is ``stated``, and look behind its last event."""
    name = str(entry.data["capture"])
    with path.open("rb") as file:
        start = file.read(MAX_HEADER_BYTES)
    try:
        head = parse_header(start, where=name)
    except DriverError:
        return  # a refused recording may be damaged; an accepted one is measured again with --again
    of_file = {
        "serial": head.fields.get("serial_number") or None,
        "width": head.width,
        "height": head.height,
    }
    for key, value in stated.items():
        if of_file[key] is not None and of_file[key] != value:
            what = (
                f"its head names the {key} {str(of_file[key])[:_LONGEST_SHOWN]}; the journal states {value}"
            )
            findings.fault("recording", name, what)
    _check_words_of_head(name, head, entry, findings)
    if others := _behind_last_event(path, head.size_bytes, path.stat().st_size):
        what = f"{others} words follow its last event that hold neither an event nor a time"
        findings.fault("recording", name, what)


def _check_words_of_head(name: str, head: RawHeader, entry: Entry, findings: Findings) -> None:
    """Tell what the head states besides the camera: another time than the journal's, and what no camera writes."""
    stated = head.fields.get("date") or head.fields.get("Date") or ""
    try:
        at = datetime.strptime(stated, _DATE).replace(tzinfo=UTC)
        stored = datetime.fromisoformat(entry.utc)
    except ValueError:
        at = stored = datetime.min.replace(tzinfo=UTC)
    if abs(at - stored) > _CLOCKS:
        findings.remarks.append(
            f"{name}: its head states the time {stated}, the journal {stored:%Y-%m-%d %H:%M} UTC;"
            " both are by the clock of one computer"
        )
    unknown = [
        f"{key} {text}"[:_LONGEST_SHOWN] for key, text in head.fields.items() if key not in _KNOWN_KEYS
    ]
    if unknown:
        findings.remarks.append(f"{name}: its head states what nothing compares: {'; '.join(unknown[:5])}")


def _behind_last_event(path: Path, begin: int, size: int) -> int:
    """Return how many words behind the last event no camera writes; 0 for the few of an end that was cut off."""
    count, others = (size - begin) // 2, 0
    words = np.memmap(path, "<u2", "r", begin, (count,)) if count else np.empty(0, "<u2")
    for last in range(count, 0, -_BLOCK_WORDS):
        kinds = np.asarray(words[max(0, last - _BLOCK_WORDS) : last]) >> 12
        events = np.flatnonzero(np.isin(kinds, (0x2, 0x3, 0x4, 0x5, 0xA)))
        after = kinds[events[-1] + 1 :] if len(events) else kinds
        others += int(np.count_nonzero(~np.isin(after, tuple(_OF_TIME))))
        if len(events):
            break
    return others if others > _MOST_OTHERS else 0
