"""Hashes of the files that the report step of a run has written, for its line of the journal."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TypedDict

from bench.records.events import WireLogState
from bench.records.run_folder import REPORT, RESULTS
from bench.records.storage import sha256_of, storage_errors

EXPORTS = "exports"
VIEWS = "views.h5"
WIRE_LOG = "wire.jsonl"


class WrittenFiles(TypedDict):
    """Files and wire logs, as `bench.records.events.Written` holds them."""

    files: dict[str, str]
    wire: dict[str, WireLogState]


def written_files(folder: Path) -> WrittenFiles:
    """Hash the results of a run, and what its wire logs hold so far.

    Returns: ``files``: SHA-256 by name; ``wire``: size and SHA-256 by name.
    Raises StorageError: When a file cannot be read.
    """
    with storage_errors(folder):
        exported = sorted(path.name for path in (folder / EXPORTS).glob("*"))
        names = [RESULTS, VIEWS, REPORT, *(f"{EXPORTS}/{name}" for name in exported)]
        logs = sorted(path.name for path in folder.glob(f"{WIRE_LOG}*"))
        return {
            "files": {name: sha256_of(folder / name) for name in names if (folder / name).is_file()},
            "wire": {name: _wire_state(folder / name) for name in logs},
        }


def _wire_state(path: Path) -> WireLogState:
    data = path.read_bytes()  # at most 8 MB: full logs are rotated
    return {"size": len(data), "sha256": hashlib.sha256(data).hexdigest()}
