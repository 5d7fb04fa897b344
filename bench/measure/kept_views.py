"""Views kept from earlier calculations, so that the stars of a recording are found once only.

Each is a file, named by the hash of all that decides its content. Entries are no evidence, and their folder may be
deleted at any time: `starbench verify` never reads them. An entry belongs to a recording's bytes, options and detector:
its sources and libraries, by hash. One that does not match its own hash is found again, and that is told. The folder
belongs to one user, and has a largest size. An entry that cannot be read or written is told, and never an error.
"""

from __future__ import annotations

import functools
import hashlib
import io
import json
import os
import platform
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.base.bounded_json import content_key, parse_json
from bench.base.home import home_folder
from bench.base.program import hash_of_files, installed_versions
from bench.measure.views_file import arrays_of, view_of
from bench.record.storage import sha256_of
from calib.errors import InputMismatch
from calib.view import View
from drivers.camera.raw_check import require_regular, require_whole
from drivers.errors import DriverError

_BUCKETS = 256  # Folders by the first two digits of a key, each with its share of the room
_STALE_S = 3600.0  # A younger part may still be written by another process
_KEPT_FORMAT = "starbench/kept-view/1"
FOLDER = "kept-views"
MOST_BYTES = 1 << 30
"""Size of all entries together. The views of about 30,000 recordings have room."""

DETECTOR_SOURCES = (
    "calib/arrays.py",
    "calib/compiled.py",
    "calib/errors.py",
    "calib/target.py",
    "calib/view.py",
    "calib/model/homography.py",
    "calib/model/local_consistency.py",
    "calib/boards",
    "calib/events",
    "calib/stars",
    "drivers/camera",
    "drivers/clock.py",
    "drivers/errors.py",
    "bench/solve/view_sources.py",
    "bench/measure",
)
"""Sources of the program that decide which view a recording gives. If one changes, the detector has a new version."""
_LIBRARIES = ("numpy", "opencv-python-headless", "numba", "scipy", "h5py")


@dataclass
class KeptViews:
    """A folder of views. Several processes may use it at the same time."""

    folder: Path  # The folder; it is made at the first entry, readable for its owner only
    # Size of all entries together. The entries that were used least recently are deleted first.
    most_bytes: int = MOST_BYTES
    # Sentences for the user: which entries were broken, and why none can be kept.
    remarks: list[str] = field(default_factory=list)
    found: int = 0
    used: int = 0
    _usable: bool | None = field(default=None, init=False, repr=False)

    @classmethod
    def of_bench(cls) -> KeptViews:
        """Return the folder of this user's bench."""
        return cls(home_folder() / FOLDER)

    def view(self, path: Path, options: Mapping[str, Any], find: Callable[[], View]) -> View:
        """Return the view of a recording, as ``find`` returns it. One in which no stars are found is not kept."""
        if not self.is_usable():
            return find()
        try:
            require_regular(path)
            require_whole(path)  # its missing parts would be read as gigabytes of zeros
            recording = sha256_of(path)
        except (OSError, DriverError):
            return find()  # it states what is wrong with the file
        key = view_key(recording, options)
        if (kept := self.read(key)) is not None:
            self.used += 1
            return kept
        view = find()
        self.found += 1
        with suppress(OSError):
            if sha256_of(path) == recording:  # else the file was replaced meanwhile
                self.write(key, view)
        return view

    def read(self, key: str) -> View | None:
        """Return the view of a `view_key`; None if there is none, or it is broken: then it is deleted and told."""
        path = self._path(key)
        try:
            if path.stat().st_size > self.most_bytes // _BUCKETS:
                raise ValueError("it is larger than any entry")  # noqa: TRY301 - as any other broken entry
            data = path.read_bytes()
            with suppress(OSError):
                os.utime(path)
            return unpack_view(data, key)
        except FileNotFoundError:
            return None
        except OSError as error:
            self.remarks.append(
                f"{path}: a kept view cannot be read ({error.strerror}); the stars are found again."
            )
        except (ValueError, KeyError, TypeError, EOFError, InputMismatch, zipfile.BadZipFile) as error:
            self.remarks.append(f"{path}: a kept view is broken ({error}); the stars are found again.")
            with suppress(OSError):
                path.unlink()
        return None

    def write(self, key: str, view: View) -> None:
        """Keep a view under a `view_key`. If this is not possible, say so and go on."""
        if not self.is_usable():
            return
        path, data = self._path(key), pack_view(view, key)
        if len(data) > self.most_bytes // _BUCKETS:
            return
        try:
            path.parent.mkdir(mode=0o700, exist_ok=True)
            self._make_room(path.parent, len(data))
            descriptor, part = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".tmp")
            try:
                with os.fdopen(descriptor, "wb") as stream:
                    stream.write(data)
                Path(part).replace(path)
            except OSError:
                with suppress(OSError):
                    Path(part).unlink()
                raise
        except OSError as error:
            self._refuse(f"{error.strerror or error}")

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}.view"

    def _make_room(self, bucket: Path, size: int) -> None:
        """Delete the entries of a bucket that were used least recently, and parts that dead processes left."""
        entries = []
        for entry in os.scandir(bucket):
            with suppress(FileNotFoundError):
                status = entry.stat(follow_symlinks=False)
                if entry.name.startswith("."):
                    if time.time() - status.st_mtime > _STALE_S:
                        Path(entry.path).unlink(missing_ok=True)
                    continue
                entries.append((status.st_mtime_ns, status.st_size, entry.path))
        total = size + sum(kept[1] for kept in entries)
        for _, had, name in sorted(entries):
            if total <= self.most_bytes // _BUCKETS:
                break
            Path(name).unlink(missing_ok=True)
            total -= had

    def is_usable(self) -> bool:
        """Return whether the folder is there, belongs to this user, and nobody else may write to it."""
        if self._usable is None:
            self._usable = True
            try:
                self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
                status = self.folder.stat()
                if hasattr(os, "getuid"):
                    if status.st_uid != os.getuid():
                        self._refuse("the folder belongs to another user")
                    elif status.st_mode & 0o077:
                        self._refuse(
                            f"other users may use the folder; change its mode: chmod 700 {self.folder}"
                        )
            except OSError as error:
                self._refuse(f"{error.strerror or error}")
        return self._usable

    def _refuse(self, why: str) -> None:
        if self._usable is not False:
            self.remarks.append(
                f"{self.folder}: views cannot be kept ({why}); the stars are found each time."
            )
        self._usable = False


def view_key(recording_sha256: str, options: Mapping[str, Any]) -> str:
    """Return the key of a view, 64 hexadecimal digits, from the SHA-256 of its recording and the options."""
    return content_key(
        {
            "format": _KEPT_FORMAT,
            "recording": recording_sha256,
            "options": options,
            "detector": detector_version(),
        }
    )


@functools.cache
def detector_version() -> str:
    """Return the version of everything that finds stars: this program's sources, the libraries, the processor."""
    root = Path(__file__).parents[2]
    parts = {
        "computer": f"{platform.machine()} {platform.python_version()}",
        "libraries": installed_versions(_LIBRARIES),  # another distribution may bring one, as opencv-python
        "sources": hash_of_files(root, source_files(root)),
    }
    return content_key(parts)


def source_files(root: Path) -> Iterable[Path]:
    """Return the source files of `DETECTOR_SOURCES`."""
    for name in DETECTOR_SOURCES:
        path = root / name
        if path.is_dir():
            yield from path.rglob("*.py")
        else:
            yield path


def pack_view(view: View, key: str) -> bytes:
    """Return a view as an entry: a line of JSON with the hash of the rest, then the arrays as a NumPy archive."""
    head: dict[str, Any] = {
        "format": _KEPT_FORMAT,
        "key": key,
        "name": view.name,
        "image_size": list(view.image_size),
    }
    if view.rim is not None:
        head["rim_level_sigma_mm"] = view.rim.level_sigma_mm
    memory = io.BytesIO()
    np.savez(memory, allow_pickle=False, **arrays_of(view))
    body = json.dumps(head).encode() + b"\n" + memory.getvalue()
    return hashlib.sha256(body).hexdigest().encode() + b"\n" + body


def unpack_view(data: bytes, key: str) -> View:
    """Return the view that `pack_view` made an entry of, to the last bit; it must be whole, and of this key."""
    stated, _, body = data.partition(b"\n")
    if hashlib.sha256(body).hexdigest().encode() != stated:
        raise ValueError("its hash does not match")
    line, _, archive = body.partition(b"\n")
    head = parse_json(line)
    if (head["format"], head["key"]) != (_KEPT_FORMAT, key):
        raise ValueError("it belongs to another recording")
    with np.load(io.BytesIO(archive), allow_pickle=False) as arrays:
        return view_of(head["name"], head["image_size"], arrays.__getitem__, head.get("rim_level_sigma_mm"))
