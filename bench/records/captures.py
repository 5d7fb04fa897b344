"""The recordings of a run as its journal lists them: names, sizes and hashes.

This module uses journal lines only; it touches no file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from bench.base.errors import RunFolderError
from bench.records.journal_entry import Entry

CAPTURES = "captures"
CAPTURE_STORED = "capture_stored"
"""Event of a journal line about a capture; the line holds ``Capture.as_data``."""


@dataclass(frozen=True)
class Capture:
    """A recording in the run folder."""

    name: str
    size: int  # Size, bytes
    sha256: str  # SHA-256, hexadecimal

    def as_data(self) -> dict[str, Any]:
        """Return what the journal's ``capture_stored`` holds about this recording.

        Returns: ``capture``, ``size`` and ``sha256``.
        """
        return {"capture": self.name, "size": self.size, "sha256": self.sha256}


def capture_name(pose_index: int, attempt: int, ending: str = ".raw") -> str:
    """Return the name of a pose's recording within the run folder.

    pose_index: Number of the pose, from 1.
    attempt: Number of the attempt, from 1.

    Examples
    --------
    >>> capture_name(1, 2)
    'captures/pose-001-attempt-2.raw'
    """
    return f"{CAPTURES}/pose-{pose_index:03d}-attempt-{attempt}{ending}"


def stored_captures(entries: Iterable[Entry]) -> dict[str, Capture]:
    """Return the captures that a journal lists; the last entry of a name counts.

    Raises RunFolderError: If a line about a capture is incomplete.
    """
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
            "The journal lists a capture without its name, size or hash.",
            remedy="This journal was not written by this program; the run cannot be resumed.",
        ) from error
