"""Recovery of a run folder after a crash: what the journal names completely stays, the rest is set aside."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from bench.record.journal import CAPTURES, Capture, Journal, stored_captures
from bench.record.run_folder import PART, REPORT, RESULTS, RunFolder
from bench.record.storage import is_plain_file, is_temporary, make_folder, sha256_of, storage_errors

if TYPE_CHECKING:
    from bench.record.events import Recovered
    from bench.record.journal_line import Entry

EXPORTS = "exports"
VIEWS = "views.h5"
WIRE_LOG = "wire.jsonl"
_State = Literal["intact", "changed", "interrupted", "unnamed"]
"""Of a recording that is there after a crash: keys of `Recovered`."""


def recover(folder: RunFolder, journal: Journal) -> Recovered:
    """Put a run folder, locked by this process, in order after a crash.

    Recordings that are incomplete, changed or not in the journal go to ``quarantine/``; temporary files are deleted.
    """
    stored = stored_captures(journal.entries)
    found: Recovered = {"intact": [], "missing": [], "changed": [], "interrupted": [], "unnamed": []}
    make_folder(folder.path / CAPTURES)
    with storage_errors(folder.path):
        for path in [p for p in folder.path.rglob("*") if is_temporary(p)]:
            path.unlink()
        for path in sorted((folder.path / CAPTURES).iterdir()):
            name = f"{CAPTURES}/{path.name}"
            state = _state_of(path, stored.get(name))
            found[state].append(name)
            if state != "intact":
                folder.quarantine(path)
    found["missing"] = sorted(set(stored) - set(found["intact"]) - set(found["changed"]))
    return found


def gone_captures(folder: Path, entries: Iterable[Entry]) -> list[str]:
    """Return the recordings that a run has no more, or that are of another size; nothing is read or moved."""
    stored = stored_captures(entries)
    return [name for name, capture in stored.items() if not _is_as_large(folder / name, capture)]


def _is_as_large(path: Path, capture: Capture) -> bool:
    return is_plain_file(path) and path.stat().st_size == capture.size


def _state_of(path: Path, capture: Capture | None) -> _State:
    """Return the state of a recording after a crash."""
    if path.name.endswith(PART):
        return "interrupted"
    if capture is None:
        return "unnamed"
    return "intact" if _is_as_large(path, capture) and sha256_of(path) == capture.sha256 else "changed"


def written_files(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of a run's results, report, views and exports, by name."""
    with storage_errors(folder):
        exported = sorted(path.name for path in (folder / EXPORTS).glob("*"))
        names = [RESULTS, VIEWS, REPORT, *(f"{EXPORTS}/{name}" for name in exported)]
        return {name: sha256_of(folder / name) for name in names if (folder / name).is_file()}
