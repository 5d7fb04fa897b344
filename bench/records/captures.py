"""The recordings of a run as its journal tells of them: their names, sizes and hashes.

Knows journal lines and names; touches no file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from bench.base.errors import RunFolderError
from bench.records.journal_entry import Entry

CAPTURES = "captures"
CAPTURE_STORED = "capture_stored"
"""The event that tells the journal of a capture; it carries what ``Capture.as_data`` gives."""


@dataclass(frozen=True)
class Capture:
    """A recording in its place: its name within the folder, size in bytes and SHA-256."""

    name: str
    size: int
    sha256: str

    def as_data(self) -> dict[str, Any]:
        """Give what the journal's ``capture_stored`` carries of it."""
        return {"capture": self.name, "size": self.size, "sha256": self.sha256}


def capture_name(pose_index: int, attempt: int, ending: str = ".raw") -> str:
    """Name of a pose's recording within the run folder.

    Parameters
    ----------
    pose_index
        Number of the pose, from 1.
    attempt
        Number of the attempt, from 1.
    ending
        Of the name, as the kind of camera has it.

    Examples
    --------
    >>> capture_name(1, 2)
    'captures/pose-001-attempt-2.raw'
    """
    return f"{CAPTURES}/pose-{pose_index:03d}-attempt-{attempt}{ending}"


def stored_captures(entries: Iterable[Entry]) -> dict[str, Capture]:
    """Find the captures a journal tells of, by name; the last entry of a name counts."""
    captures = {}
    for entry in entries:
        if entry.event == CAPTURE_STORED:
            capture = _capture_of(entry.data)
            captures[capture.name] = capture
    return captures


def _capture_of(data: Mapping[str, Any]) -> Capture:
    try:
        return Capture(str(data["capture"]), int(data["size"]), str(data["sha256"]))
    except (KeyError, TypeError, ValueError) as error:
        raise RunFolderError(
            "The journal tells of a capture without its name, size or hash.",
            remedy="This journal was not written by this program; the run cannot be resumed.",
        ) from error
