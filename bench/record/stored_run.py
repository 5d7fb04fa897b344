"""A stored run: the one reader of a run folder, finished, failed, in progress, or calibrated without devices.

Each part is read and checked when it is asked for, once. Nothing is written. What stands in a sealed folder can be any
bytes: the journal is verified as a chain, and JSON is read by the bounded reader and checked against its types.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.base.bounded_json import parse_json
from bench.base.errors import RunFolderError
from bench.record.history import History, replay
from bench.record.journal import Capture, read_journal, stored_captures
from bench.record.journal_line import Entry
from bench.record.run_folder import JOURNAL, MANIFEST, RESULTS, is_sealed, require_run
from bench.record.storage import read_bounded, sha256_of

if TYPE_CHECKING:
    from pydantic import TypeAdapter

    from bench.record.results import Results
    from calib.calibration import Calibration
    from calib.model.camera import CameraModel


@dataclass(frozen=True)
class StoredRun:
    """The folder of a run, or of results calculated without devices."""

    folder: Path

    @classmethod
    def open(cls, folder: Path) -> StoredRun:
        """Open the folder of a run that has begun. Raises RunFolderError if it has no journal."""
        require_run(folder)
        return cls(folder)

    @cached_property
    def _journal(self) -> tuple[list[Entry], bytes]:
        return read_journal(self.folder / JOURNAL)

    @property
    def entries(self) -> Sequence[Entry]:
        """The lines of the journal, verified. Raises JournalBroken or StorageError."""
        return self._journal[0]

    @property
    def torn(self) -> bytes:
        """What a power cut has left of a last line; empty if the journal ends with a whole one."""
        return self._journal[1]

    @property
    def head(self) -> str:
        """Hash of the last line of the journal; empty if it has none."""
        return self.entries[-1].hash if self.entries else ""

    @cached_property
    def history(self) -> History:
        """The journal replayed. Raises JournalBroken if a line has another form."""
        return replay(self.entries)

    @cached_property
    def captures(self) -> Mapping[str, Capture]:
        """The recordings that the journal names, by the name of their file."""
        return stored_captures(self.entries)

    @property
    def is_rehearsal(self) -> bool:
        """Whether nothing was measured; False where the journal has no line yet."""
        return bool(self.entries and self.entries[0].data.get("rehearsal", False))

    @property
    def is_sealed(self) -> bool:
        """Whether the folder has a signature, which is not verified."""
        return is_sealed(self.folder)

    @property
    def seal(self) -> str:
        """SHA-256 of the list of files, by which ledgers and certificates name the seal. Raises OSError without one."""
        return sha256_of(self.folder / MANIFEST)

    @property
    def has_results(self) -> bool:
        """Whether there is a results.json."""
        return (self.folder / RESULTS).is_file()

    @cached_property
    def results_bytes(self) -> bytes:
        """The bytes of results.json. Raises StorageError."""
        return read_bounded(self.folder / RESULTS)

    @cached_property
    def results(self) -> Results:
        """The content of results.json, of the types that docs/results.md states.

        Raises StorageError if there is none, RunFolderError if it cannot be read or has another form.
        """
        return results_of(self.results_bytes, self.folder / RESULTS)

    @cached_property
    def results_as_written(self) -> Mapping[str, Any]:
        """The JSON of any version of the program: an object, whose parts are not checked. Raises as `results`."""
        return object_of(self.results_bytes, self.folder / RESULTS)

    @cached_property
    def calibration(self) -> Calibration:
        """The calibration of results.json, without residuals and weights."""
        from bench.record.stored_calibration import stored_calibration

        return stored_calibration(self.results["calibration"])

    @property
    def camera(self) -> CameraModel:
        """The camera of results.json."""
        return self.calibration.camera


def object_of(data: bytes, where: Path) -> Mapping[str, Any]:
    """Read results.json of any version; RunFolderError if it is no object of JSON that two readers read alike."""
    try:
        content: Any = parse_json(data)
    except ValueError as error:
        raise RunFolderError(
            f"The results cannot be read: {error}.", where=str(where), remedy="Restore the file from a copy."
        ) from error
    if not isinstance(content, dict):
        raise RunFolderError("The results are not a JSON object.", where=str(where))
    return content


def results_of(data: bytes, where: Path) -> Results:
    """Read results.json and check its types; RunFolderError names the first value of another type."""
    from pydantic import ValidationError

    object_of(data, where)  # bounded, and read alike by all readers
    try:
        return _form().validate_json(data, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"])) or "the whole file"
        lacks = "is missing" if first["type"] == "missing" else "is of another type"
        raise RunFolderError(
            f"The results have another form: {place} {lacks}.",
            where=str(where),
            remedy="Another version of Starbench wrote them, or the file was changed. Read it with that version.",
        ) from error


@cache
def _form() -> TypeAdapter[Results]:
    from pydantic import ConfigDict, TypeAdapter, with_config

    from bench.record.results import Results

    # What the types do not name is kept: a device of a plug-in may have settings of its own.
    return TypeAdapter(with_config(ConfigDict(extra="allow"))(Results))
