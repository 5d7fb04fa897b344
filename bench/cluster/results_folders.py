"""The folder of a recalculation of many runs: a folder of results for each, and one table of all, as lines of JSON.

A row is written before its folder gets its name; after a power cut the row without folder counts as not done. Rows are
added while the work goes on; at the end the table is written again, one row for each run, in the order of the runs.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from bench.base.bounded_json import parse_json
from bench.base.errors import EvidenceError, StorageError, UsageError
from bench.evidence.keys import BenchKey
from bench.evidence.seal import seal_folder
from bench.records.folder_lock import lock_folder
from bench.records.reading import MOST_TABLE_BYTES, read_bounded
from bench.records.run_folder import RESULTS
from bench.records.storage import make_folder, sha256_of, storage_errors, sync_folder, write_all, write_atomic
from bench.results.offline_folder import write_files

TABLE = "recalculated.jsonl"
DONE, FAILED = "done", "failed"
_PART = ".part-"
_KEY_SHOWN = 8


class ResultsFolders:
    """The folder of a recalculation; one process at a time works in it.

    folder: The folder; it is made if it does not exist. What an earlier, interrupted recalculation did is
      used.
    key: The bench's key; None leaves the results drafts.
    table_only: True writes the table alone, and no folder for a run.
    Raises UsageError: If the folder holds something else.
    Raises RunFolderError: If another process works in it.
    Raises StorageError: If it cannot be read or written.
    """

    def __init__(self, folder: Path, key: BenchKey | None, *, table_only: bool = False) -> None:
        self.folder, self.key, self.table_only = folder, key, table_only
        self._reserved: set[str] = set()
        self._refuse_foreign()
        make_folder(folder)
        self._lock = lock_folder(folder)
        try:
            self._remove_parts()
            self._rows = self._read()
            with storage_errors(self._table):
                self._stream = os.open(self._table, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
            self._end_torn_line()
        except BaseException:
            os.close(self._lock)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._stream)
        os.close(self._lock)

    @property
    def _table(self) -> Path:
        return self.folder / TABLE

    def done(self, place: str, key: str) -> dict[str, Any] | None:
        """Return the row of a calibration that is done already.

        key: Hash of all that decides the calibration.
        Returns: None if it is to be done: it was not, or its results are not there as they were written.
        """
        row = self._rows.get(place)
        if row is None or row["state"] != DONE or row["key"] != key:
            return None
        if self.table_only:
            return row
        if row["results"] is None:
            return None
        results = self.folder / str(row["results"]) / RESULTS
        try:
            whole = results.is_file() and sha256_of(results) == row["results_sha256"]
        except OSError:
            return None
        return row if whole else None

    def name_for(self, place_name: str, key: str) -> str:
        """Return a free name for a folder of results, which is not given out again.

        place_name: Last part of the name of the calibrated folder.
        key: Hash of all that decides the calibration.
        Returns: The name: that of the calibrated folder, and the first digits of the key.
        """
        name = f"{place_name}-{key[:_KEY_SHOWN]}"
        number = 1
        while name in self._reserved or (self.folder / name).exists():
            number += 1
            name = f"{place_name}-{key[:_KEY_SHOWN]}-{number}"
        self._reserved.add(name)
        return name

    def write(self, name: str, files: Mapping[str, bytes], row: dict[str, Any]) -> None:
        """Write, seal and name a folder of results, and add its row.

        name: Its name, of `name_for`.
        Raises EvidenceError: If it cannot be sealed.
        Raises StorageError: If a file cannot be written.
        """
        part = self.folder / f"{_PART}{name}"
        try:
            write_files(part, files)
            if self.key is not None:
                seal_folder(part, self.key)
        except (StorageError, EvidenceError):
            _remove(part)
            raise
        self.add(row)
        with storage_errors(part):
            part.rename(self.folder / name)
            sync_folder(self.folder)

    def add(self, row: dict[str, Any]) -> None:
        """Add a row to the table, synced.

        Raises StorageError: If it cannot be written.
        """
        with storage_errors(self._table):
            write_all(self._stream, _line(row))
            os.fsync(self._stream)
        self._rows[row["folder"]] = row

    def finish(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Write the table again, in the order given; rows of folders that were not given this time stay behind them.

        Raises StorageError: If it cannot be written.
        """
        given = {str(row["folder"]): row for row in rows}
        others = [row for place, row in self._rows.items() if place not in given]
        write_atomic(self._table, b"".join(_line(row) for row in (*given.values(), *others)))

    def _refuse_foreign(self) -> None:
        with storage_errors(self.folder):
            if not self.folder.exists():
                return
            if not self.folder.is_dir():
                raise UsageError(
                    "This is a file, not a folder.", where=str(self.folder), remedy="Choose another -o."
                )
            found = next((one for one in self.folder.iterdir() if not one.name.startswith(".")), None)
        if found is not None and not self._table.is_file():
            raise UsageError(
                f"The folder is not that of a recalculation: it contains {found.name}, but no {TABLE}.",
                where=str(self.folder),
                remedy="Choose a new folder.",
            )

    def _read(self) -> dict[str, dict[str, Any]]:
        """Return the last row of each folder; a line that was cut off does not count."""
        rows: dict[str, dict[str, Any]] = {}
        if not self._table.is_file():
            return rows
        with storage_errors(self._table):
            lines = read_bounded(self._table, MOST_TABLE_BYTES).splitlines()
        for line in lines:
            with suppress(ValueError, KeyError, TypeError):
                row = parse_json(line)
                if {"state", "key", "results", "results_sha256"} <= row.keys():
                    rows[str(row["folder"])] = row
        return rows

    def _end_torn_line(self) -> None:
        with storage_errors(self._table):
            data = self._table.read_bytes()
            if data and not data.endswith(b"\n"):
                write_all(self._stream, b"\n")

    def _remove_parts(self) -> None:
        """Remove what a process that was killed left behind."""
        for part in self.folder.glob(f"{_PART}*"):
            _remove(part)


def _line(row: Mapping[str, Any]) -> bytes:
    return (json.dumps(row, allow_nan=False) + "\n").encode()


def _remove(part: Path) -> None:
    """Remove a folder that never got its name; its seal may have made it read-only."""
    if not part.is_dir():
        return
    with storage_errors(part):
        for path in (part, *part.rglob("*")):
            if path.is_dir() and not path.is_symlink():
                path.chmod(0o755)
        shutil.rmtree(part)
