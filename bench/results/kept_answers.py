"""What `calibrate` printed about runs, kept until a byte of a run, an option or the program changes.

The same program gives the same answer for the same bytes, so the engine need not even be loaded. Answers are no
evidence; nothing but `calibrate` without an output folder reads them. Loads no mathematics.
"""

from __future__ import annotations

import errno
import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, ClassVar

from bench.base.bounded_json import parse_json
from bench.base.home import home_folder
from bench.records.kept_entries import KeptEntries
from bench.records.run_folder import JOURNAL, PASSPORT_COPY
from bench.records.storage import sha256_of
from bench.results.forms import forms

FORMAT = "starbench/kept-answer/2"
FOLDER = "kept-answers"
MOST_BYTES = 1 << 26
_TEXT, _JSON = "text", "json"
_OF_FILES = ("passport", "station", "board", "reconstruct_hz", "pictures_at")
"""Options that name files, or that are not about runs; with one of them nothing is kept."""
_BLOCK_BYTES = 512
_LARGE_BYTES = 100_000_000
_LEAST_STORED = 0.05
"""Share of a large file that is stored at least; file systems that compress may store a tenth."""
_LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "h5py", "pydantic")


class KeptAnswers(KeptEntries):
    """A folder of answers."""

    ending: ClassVar[str] = ".json"
    thing: ClassVar[str] = "answer"
    otherwise: ClassVar[str] = "it is calculated"

    @classmethod
    def of_bench(cls) -> KeptAnswers:
        """Return the folder of this user's bench.

        Returns: In the folder of the bench's own files.
        """
        return cls(home_folder() / FOLDER, MOST_BYTES)

    def answer(self, key: str, *, as_json: bool) -> str | None:
        """Return what was printed.

        key: As `answer_key` returns it.
        as_json: Whether the form for programs is asked for, not that for people.
        Returns: The text; None if there is none, or it is broken.
        """
        if not self.is_usable() or (data := self.read_entry(key)) is None:
            return None
        stated, _, body = data.partition(b"\n")
        if hashlib.sha256(key.encode() + body).hexdigest().encode() != stated:
            self.drop_entry(key, "its hash does not match")
            return None
        return str(parse_json(body)[_JSON if as_json else _TEXT])

    def keep(self, key: str, text: str, as_json: str) -> None:
        """Keep what is printed.

        key: As `answer_key` returns it.
        """
        body = json.dumps({_TEXT: text, _JSON: as_json}).encode()
        self.write_entry(key, hashlib.sha256(key.encode() + body).hexdigest().encode() + b"\n" + body)


def answer_key(paths: Sequence[Path], options: Mapping[str, Any]) -> str | None:
    """Return the hash of all that decides what `calibrate` prints.

    Returns: 64 hexadecimal digits; None if a path is no run, if an option names a file, or if a file cannot
      be read.
    """
    if any(options.get(name) is not None for name in _OF_FILES):
        return None
    try:
        if not all((path / JOURNAL).is_file() for path in paths):
            return None
        runs = [[path.resolve().name, _content(path)] for path in paths]
        signers = home_folder() / "allowed_signers"
        trusted = sha256_of(signers) if signers.is_file() else None
    except OSError:
        return None
    parts = {
        "format": FORMAT,
        "runs": runs,
        "options": {name: repr(value) for name, value in options.items()},
        "program": forms()["program"],
        "libraries": [_version(name) for name in _LIBRARIES],
        "platform": [platform.machine(), platform.python_version()],
        "signers": trusted,
        "day": _day(paths),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _day(runs: Sequence[Path]) -> str | None:
    """Return the day if it matters: a passport is valid until a day."""
    has_passport = any((run / PASSPORT_COPY).is_file() for run in runs)
    return datetime.now(UTC).date().isoformat() if has_passport else None


def _content(run: Path) -> dict[str, str]:
    """Return the hashes of all files of a run by their names. Raises OSError."""
    files = sorted(path for path in run.rglob("*") if path.is_file())
    for path in files:
        _refuse_holes(path)
    return {path.relative_to(run).as_posix(): sha256_of(path) for path in files}


def _refuse_holes(path: Path) -> None:
    """Refuse a large file that was hardly written, before hours go into its hash. Raises OSError."""
    found = path.stat()
    stored = getattr(found, "st_blocks", found.st_size) * _BLOCK_BYTES
    if found.st_size > _LARGE_BYTES and stored < _LEAST_STORED * found.st_size:
        raise OSError(errno.EINVAL, "This file has holes", str(path))


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return ""
