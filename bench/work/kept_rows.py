"""Pieces of work for one process, for the processes of this computer, or for a Dask scheduler: one interface for all.

A piece of work is a pure function at the top of a module: it may be done again after a worker died. Results are kept on
the disk, by the hash of all that decides them, as synced lines of JSON; half a line does not count.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from bench.base.bounded_json import parse_json
from bench.base.errors import BenchError, UsageError
from bench.base.program import forms
from bench.record.folder_lock import lock_folder
from bench.record.storage import make_folder, require_unsealed, sha256_of, storage_errors, whole_lines
from drivers.durable import write_all


def require_program_of(program: str) -> None:
    """Refuse work of another program, because its results would differ."""
    if (here := forms()["program"]) != program:
        raise BenchError(
            f"This worker has another Starbench ({here}) than the command ({program}).",
            remedy="Install the same version on all computers, and restart the workers.",
        )


def content_hash(path: Path) -> str:
    """Return the hash of a file, or of a folder's files and their names."""
    if not path.is_dir():
        return sha256_of(path)
    files = sorted(inner for inner in path.rglob("*") if inner.is_file())
    listed = "\n".join(f"{sha256_of(file)}  {file.relative_to(path).as_posix()}" for file in files)
    return hashlib.sha256(listed.encode()).hexdigest()


class Table:
    """Rows in one file of a folder, which is made if it does not exist, and holds nothing else without the file."""

    foreign = "The folder holds something else"

    def __init__(self, folder: Path, name: str) -> None:
        self.path = folder / name
        require_unsealed(self.path)
        with storage_errors(folder):
            inside = folder.iterdir() if folder.is_dir() else ()
            occupant = next((entry for entry in inside if not entry.name.startswith(".")), None)
        if occupant is not None and not self.path.is_file():
            raise UsageError(
                f"{self.foreign}: it contains {occupant.name}, but no {name}.",
                where=str(folder),
                remedy="Choose a new folder.",
            )
        make_folder(folder)
        self._lock = lock_folder(folder)
        try:
            self._rows = self._read()
            with storage_errors(self.path):
                self._stream = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        except BaseException:
            os.close(self._lock)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._stream)
        os.close(self._lock)

    def _known(self, row: Any) -> tuple[str, Any]:
        """Return key and value of a line. Raises KeyError, TypeError for a line of another kind."""
        raise NotImplementedError

    def append(self, row: Mapping[str, Any]) -> None:
        """Write a line, synced."""
        with storage_errors(self.path):
            write_all(self._stream, line_of(row))
            os.fsync(self._stream)
        key, value = self._known(row)
        self._rows[key] = value

    def _read(self) -> dict[str, Any]:
        rows: dict[str, Any] = {}
        for line in whole_lines(self.path):
            with suppress(ValueError, KeyError, TypeError):
                key, value = self._known(parse_json(line))
                rows[key] = value
        return rows


def line_of(row: Mapping[str, Any]) -> bytes:
    """Return a row as a line of the file."""
    return (json.dumps(row, allow_nan=False) + "\n").encode()


class KeptRows(Table):
    """Results by their key."""

    def get(self, key: str) -> Any:
        """Return a result of this key as JSON holds it; None if it is not known."""
        return self._rows.get(key)

    def add(self, key: str, value: Any) -> None:
        """Keep a result."""
        self.append({"key": key, "value": value})

    def _known(self, row: Any) -> tuple[str, Any]:
        return row["key"], row["value"]
