"""`views.h5`: stars, residuals and image of each calibrated pose (layout: docs/run-folder.md); and views that are kept.

An entry that is kept belongs to a recording's bytes, options and detector: its sources and libraries, by hash. It is no
evidence: `starbench verify` never reads it. One that does not match its own hash is found again, and that is told.
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
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from bench.base.bounded_json import parse_json
from bench.base.errors import RunFolderError
from bench.base.home import home_folder
from bench.measure.view_picture import ViewPicture
from bench.record.storage import sha256_of
from calib.errors import InputMismatch
from calib.view import RimPoints, View
from drivers.camera.formats.hdf5_reading import dataset, member, whole
from drivers.camera.raw_writer import require_regular, require_whole
from drivers.errors import DriverError, RecordingFileError

VIEWS = "views.h5"
FORMAT = "starbench/views/1"

_ARRAYS = {"ids": np.int64, "points_px": np.float64, "target_mm": np.float64, "covariances_px2": np.float64}
_RIM = ("points_mm", "sigmas_mm", "lit_mm")
_MOST_BYTES = 1 << 30
_REMEDY = "Delete the file; `starbench.load` then finds the stars again in the captures."


@dataclass(frozen=True, eq=False)
class StoredView:
    """One pose as `views.h5` holds it."""

    view: View
    # (N, 2) float64, px, star found minus star projected by the run's calibration.
    residuals_px: NDArray[np.float64]
    # Reads its image, (H, W) uint8, grey values, when it is needed: a run may have a thousand. None without one.
    picture: Callable[[], NDArray[np.uint8]] | None = None

    def shown(self, *, pictured: bool = False) -> ViewPicture:
        """Return the pose as a report shows it, with its image if it is ``pictured``."""
        image = self.picture() if pictured and self.picture is not None else None
        view = self.view
        return ViewPicture(view.name, image, view.points_px, view.points_px - self.residuals_px, view.ids)


def views_file(views: Iterable[StoredView]) -> bytes:
    """Return views, residuals and images, where there are any, as an HDF5 file."""
    memory = io.BytesIO()
    with h5py.File(memory, "w") as file:
        file.attrs["format"] = FORMAT
        for number, stored in enumerate(views, 1):
            view, group = stored.view, file.create_group(_group_name(number))
            group.attrs["name"] = view.name
            group.attrs["image_size"] = view.image_size
            for name, values in _arrays_of(view, {"residuals_px": stored.residuals_px}).items():
                group.create_dataset(name, data=values)
            if view.rim is not None:
                group.attrs["rim_level_sigma_mm"] = view.rim.level_sigma_mm
            if stored.picture is not None:
                group.create_dataset("picture", data=stored.picture(), compression="gzip", compression_opts=4)
    return memory.getvalue()


def read_views(path: Path) -> list[StoredView]:
    """Read a `views.h5` in the order of its groups; recalculated results have no images."""
    with _opened(path) as file:
        pictured = all("picture" in group for group in file.values())
        return [
            _stored_view(member(file, _group_name(n)), partial(read_picture, path, n) if pictured else None)
            for n in range(1, len(file) + 1)
        ]


def read_picture(path: Path, number: int) -> NDArray[np.uint8]:
    """Read the image of a group from 1 of a `views.h5`: (H, W) uint8, grey values as the report shows them."""
    with _opened(path) as file:
        return np.asarray(_array(member(file, _group_name(number)), "picture"), np.uint8)


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """Open a `views.h5` for reading; every fault inside the block becomes a RunFolderError."""
    try:
        require_regular(path)
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT:
                raise RunFolderError(
                    f"The file does not have the format {FORMAT}.", where=str(path), remedy=_REMEDY
                )
            yield file
    except RecordingFileError as error:
        raise RunFolderError(error.what, where=str(path), remedy=_REMEDY) from error
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError, InputMismatch) as error:
        raise RunFolderError(f"The file cannot be read: {error}.", where=str(path), remedy=_REMEDY) from error


def _array(group: h5py.Group, name: str) -> NDArray[Any]:
    """Read an array that lies in the file itself, of a size that a view can have."""
    return whole(dataset(group, name), _MOST_BYTES)


def _arrays_of(view: View, more: Mapping[str, NDArray[np.float64]] | None = None) -> dict[str, NDArray[Any]]:
    """Return the arrays of a view by name, with ``more`` of its stars."""
    arrays = {name: getattr(view, name) for name in _ARRAYS} | dict(more or {})
    if view.rim is None:
        return arrays
    return arrays | {f"rim_{name}": getattr(view.rim, name) for name in _RIM}


def _view_of(
    name: str, size: Iterable[int], arrays: Callable[[str], NDArray[Any]], level_sigma_mm: float | None
) -> View:
    """Return the view of arrays by name; it has no rim without the uncertainty of its level."""
    rim = None
    if level_sigma_mm is not None:
        of_rim = {name: np.asarray(arrays(f"rim_{name}"), np.float64) for name in _RIM}
        rim = RimPoints(**of_rim, level_sigma_mm=float(level_sigma_mm))
    width, height = (int(side) for side in size)
    stars: dict[str, Any] = {name: np.asarray(arrays(name), kind) for name, kind in _ARRAYS.items()}
    return View(name=name, image_size=(width, height), rim=rim, **stars)


def _group_name(number: int) -> str:
    return f"pose-{number:03d}"


def _stored_view(group: h5py.Group, picture: Callable[[], NDArray[np.uint8]] | None) -> StoredView:
    # Files of earlier versions have no rim.
    level_sigma_mm = group.attrs["rim_level_sigma_mm"] if "rim_points_mm" in group else None
    view = _view_of(
        str(group.attrs["name"]), group.attrs["image_size"], partial(_array, group), level_sigma_mm
    )
    residuals_px = np.asarray(_array(group, "residuals_px"), np.float64)
    if residuals_px.shape != view.points_px.shape:
        raise InputMismatch(
            f"{len(view)} stars, but residuals of shape {residuals_px.shape}", where=group.name
        )
    return StoredView(view, residuals_px, picture)


# Views kept from earlier calculations, so that the stars of a recording are found once only.
# A file each, named by the hash of all that decides its content.
#
# Entries are no evidence, and their folder may be deleted at any time. It belongs to one user, and has a
# largest size. An entry that cannot be read or written is told, and never an error.

_BUCKETS = 256
_STALE_S = 3600.0
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
        total = size + sum(one[1] for one in entries)
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
    parts = {
        "format": _KEPT_FORMAT,
        "recording": recording_sha256,
        "options": options,
        "detector": detector_version(),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True, allow_nan=False).encode()).hexdigest()


@functools.cache
def detector_version() -> str:
    """Return the version of everything that finds stars: this program's sources, the libraries, the processor."""
    digest = hashlib.sha256(f"{platform.machine()} {platform.python_version()}\n".encode())
    for library in _LIBRARIES:
        try:
            digest.update(f"{library} {version(library)}\n".encode())
        except PackageNotFoundError:  # another distribution brings it, as opencv-python
            digest.update(f"{library} ?\n".encode())
    root = Path(__file__).parents[2]
    for path in sorted(source_files(root)):
        data = path.read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{path.relative_to(root).as_posix()} {len(data)}\n".encode() + data)
    return digest.hexdigest()


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
    np.savez(memory, allow_pickle=False, **_arrays_of(view))
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
        return _view_of(head["name"], head["image_size"], arrays.__getitem__, head.get("rim_level_sigma_mm"))
