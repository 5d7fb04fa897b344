"""Folders with recordings, on a disk or behind a URL that fsspec reads (extra `cluster`).

What is behind a URL, such as ``s3://bucket/runs``, is copied to a folder for temporary files, for one piece of work at
a time: small files of the run, and one recording at most. Writes nothing else.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench.base.errors import BenchError, StorageError, UsageError
from bench.measure.views_file import VIEWS
from bench.record.run_folder import JOURNAL, REPORT
from bench.solve.view_sources import natural_order

_URL = re.compile(r"[a-z][a-z0-9+.-]+://")
_NOT_COPIED = {REPORT, VIEWS}
_MOST_SMALL_BYTES = 1 << 28
"""Size of a file of a run that is copied; a journal of a thousand poses has some megabytes."""
_SIDE_BY_SIDE = 8
"""Requests at a time; the connections of S3's client are ten."""


@dataclass(frozen=True)
class Place:
    """A folder with a run or with recordings."""

    name: str

    @property
    def is_remote(self) -> bool:
        """Whether it is a URL."""
        return _URL.match(self.name) is not None

    @property
    def base_name(self) -> str:
        """The last part of the name."""
        if self.is_remote:
            return posixpath.basename(self.name.rstrip("/"))
        return Path(self.name).absolute().name

    @contextmanager
    def folder(self, *captures: str, only: Collection[str] | None = None) -> Iterator[Path]:
        """Give the folder as a path here; of a URL a copy that exists in the block, of ``only`` these small files."""
        if not self.is_remote:
            yield Path(self.name)
            return
        with TemporaryDirectory(prefix="starbench-") as made:
            copy = Path(made) / self.base_name
            copy.mkdir()
            with _remote_errors(self.name):
                _copy(self.name, copy, captures, only)
            yield copy

    def renamed(self, text: str, folder: Path) -> str:
        """Return a text with the name of this place where it names the copy in ``folder``."""
        return text.replace(str(folder), self.name) if self.is_remote else text


def find_places(names: Sequence[str]) -> list[Place]:
    """Return the folders that hold runs or recordings: each once, in order; the runs of one in natural order."""
    places: dict[str, Place] = {}
    for name in names:
        place = Place(name)
        for run in _remote_runs(name) if place.is_remote else _local_runs(Path(name)):
            same = run.rstrip("/") if place.is_remote else str(Path(run).resolve())
            places.setdefault(same, Place(run if place.is_remote else str(Path(run).absolute())))
    return list(places.values())


def _local_runs(path: Path) -> list[str]:
    if not path.is_dir():
        what = "This is a file, not a folder." if path.exists() else "There is no such folder."
        raise UsageError(what, where=str(path), remedy="Give folders of runs or recordings.")
    if (path / JOURNAL).is_file():
        return [str(path)]
    runs = [file.parent.name for file in path.glob(f"[!.]*/{JOURNAL}") if file.is_file()]
    return [str(path / name) for name in sorted(runs, key=natural_order)] or [str(path)]


def _remote_runs(url: str) -> list[str]:
    with _remote_errors(url):
        system, root = file_system(url)
        if system.exists(f"{root}/{JOURNAL}"):
            return [url]
        listed = system.ls(root, detail=True)
        folders = [entry["name"].rstrip("/") for entry in listed if entry["type"] == "directory"]
        are_runs = _side_by_side(system, system.exists, [(f"{folder}/{JOURNAL}",) for folder in folders])
        runs = [posixpath.basename(name) for name, is_run in zip(folders, are_runs, strict=True) if is_run]
    if not runs:
        raise UsageError(
            "No run was found. From a URL, only folders of runs are read.",
            where=url,
            remedy=f"Give the URL of a folder with {JOURNAL}, or of a folder of such folders; copy other files here.",
        )
    return [f"{url.rstrip('/')}/{name}" for name in sorted(runs, key=natural_order)]


def _copy(url: str, to: Path, captures: Iterable[str], only: Collection[str] | None) -> None:
    system, root = file_system(url)
    names = []
    for entry in system.ls(root, detail=True):
        name = posixpath.basename(entry["name"].rstrip("/"))
        is_small = entry["type"] == "file" and name and entry["size"] <= _MOST_SMALL_BYTES
        if is_small and (name not in _NOT_COPIED if only is None else name in only):
            names.append(name)
    for name in captures:
        local = to / name
        if to not in local.resolve().parents:
            raise StorageError("A recording lies outside of its run.", where=f"{url}/{name}")
        local.parent.mkdir(parents=True, exist_ok=True)
        names.append(name)
    _side_by_side(system, system.get_file, [(f"{root}/{name}", str(to / name)) for name in names])


def _side_by_side(system: Any, request: Callable[..., Any], calls: Sequence[tuple[str, ...]]) -> list[Any]:
    """Make several requests at a time, of a file system that may be used by several threads: those of its own loop."""
    if not getattr(system, "async_impl", False):
        return [request(*arguments) for arguments in calls]
    with ThreadPoolExecutor(_SIDE_BY_SIDE) as pool:
        return list(pool.map(lambda arguments: request(*arguments), calls))


def file_system(url: str) -> tuple[Any, str]:
    """Return the file system of a URL, and its path there. Listings are asked for anew each time."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise _missing(url) from error
    try:
        system, root = url_to_fs(url, use_listings_cache=False)
    except ImportError as error:
        raise _missing(url) from error
    except ValueError as error:
        raise UsageError(
            f"This URL cannot be read: {error}.", where=url, remedy="Known is, for example, s3://."
        ) from error
    system.invalidate_cache()
    return system, root.rstrip("/")


def _missing(url: str) -> UsageError:
    what = "What reads this URL is not installed."
    return UsageError(what, where=url, remedy="Install it: pip install 'starbench[cluster]'")


@contextmanager
def _remote_errors(url: str) -> Iterator[None]:
    """Turn the errors of fsspec and of the libraries below it into ours."""
    try:
        yield
    except BenchError:
        raise
    except FileNotFoundError as error:
        raise UsageError(
            "There is no such folder or file.",
            where=str(error.args[0] if error.args else url),
            remedy=f"Check {url}.",
        ) from error
    except PermissionError as error:
        remedy = "Check the credentials of this computer and of the workers."
        raise StorageError(f"No permission: {error}.", where=url, remedy=remedy) from error
    except Exception as error:  # each file system raises its own errors
        what = f"It cannot be read: {type(error).__name__}: {error}"
        remedy = (
            "Check the URL, the endpoint and the network, then repeat the command: what was done is kept."
        )
        raise StorageError(what, where=url, remedy=remedy) from error
