"""Recovery of a run folder after a crash: what is complete and named in the journal stays, the rest is set aside."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.records.captures import CAPTURES, Capture, stored_captures
from bench.records.journal import Journal
from bench.records.run_folder import PART, RunFolder
from bench.records.storage import is_temporary, make_folder, sha256_of, storage_errors


@dataclass(frozen=True)
class RecoveryNotes:
    """What a restart has found in a run folder."""

    intact: tuple[Capture, ...] = ()
    missing: tuple[str, ...] = ()  # Recordings that the journal names and that do not exist
    changed: tuple[str, ...] = ()  # Recordings that differ from the journal; now in ``quarantine/``
    interrupted: tuple[str, ...] = ()  # Incomplete recordings; now in ``quarantine/``
    # Complete recordings that the journal does not name, because the run was cut off before that; now in
    # ``quarantine/``.
    unnamed: tuple[str, ...] = ()

    def as_data(self) -> dict[str, Any]:
        """Return the notes as data of a journal line."""
        return {
            "intact": [capture.name for capture in self.intact],
            "missing": list(self.missing),
            "changed": list(self.changed),
            "interrupted": list(self.interrupted),
            "unnamed": list(self.unnamed),
        }


def recover(folder: RunFolder, journal: Journal) -> RecoveryNotes:
    """Put a run folder in order after a crash.

    No recording is deleted. Recordings that are incomplete, changed, or not named in the journal are moved to
    ``quarantine/``. Temporary files of reports and similar files, which can be written again, are deleted.

    folder: The folder, locked by this process.
    Raises StorageError: When a file cannot be read or moved.
    """
    stored = stored_captures(journal.entries)
    found: dict[str, list[str]] = {"intact": [], "changed": [], "interrupted": [], "unnamed": []}
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
    return RecoveryNotes(
        intact=tuple(stored[name] for name in found["intact"]),
        missing=tuple(sorted(set(stored) - set(found["intact"]) - set(found["changed"]))),
        changed=tuple(found["changed"]),
        interrupted=tuple(found["interrupted"]),
        unnamed=tuple(found["unnamed"]),
    )


def _state_of(path: Path, capture: Capture | None) -> str:
    """Return the state of a recording after a crash: a field of `RecoveryNotes`."""
    if path.name.endswith(PART):
        return "interrupted"
    if capture is None:
        return "unnamed"
    whole = path.is_file() and not path.is_symlink() and path.stat().st_size == capture.size
    return "intact" if whole and sha256_of(path) == capture.sha256 else "changed"
