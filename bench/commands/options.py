"""Argument and option types that several commands share; paths are checked before any work begins.

Each path type checks what it was given and, where it is wrong, says what to do. It changes no file. A wrong argument
ends the command with exit status 2.
"""

from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from bench.base.errors import UsageError

JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object to standard output.")
SEED = click.IntRange(0, 2**63 - 1)
_MOST_NAMED = 5
_SMALLEST, _LARGEST = 1e-9, 1e12
"""Size of any number that is not 0: no quantity of a bench lies outside."""
_CUTOFF_HZ = (0.01, 1000.0)


class Number(click.ParamType):
    """Finite number between ``least`` and ``most``, as far as these are given.

    least: Smallest number allowed; any where None.
    above: Whether ``least`` itself is refused.
    most: Largest number allowed; any where None.
    """

    name = "number"

    def __init__(self, *, least: float | None = None, above: bool = False, most: float | None = None) -> None:
        self._least, self._above, self._most = least, above, most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """See `click.ParamType.convert`."""
        try:
            number = math.nan if "_" in str(value) else float(value)  # Python reads 6_0 as 60
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a number.", param, ctx)
        if self._least is not None and (number < self._least or (self._above and number == self._least)):
            self.fail(f"{value} is not {'above' if self._above else 'at least'} {self._least:g}.", param, ctx)
        if self._most is not None and number > self._most:
            self.fail(f"{value} is more than {self._most:g}.", param, ctx)
        if number and not _SMALLEST <= abs(number) <= _LARGEST:
            self.fail(f"{value} is not between {_SMALLEST:g} and {_LARGEST:g}.", param, ctx)
        return number


class _Path(click.ParamType, ABC):
    """A path that is checked before the command begins."""

    name = "path"
    completed_as = "file"

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """See `click.ParamType.shell_complete`: the shell completes the path."""
        del ctx, param
        return [CompletionItem(incomplete, type=self.completed_as)]

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path after checking it. Raises UsageError, OSError."""
        del param, ctx
        path = Path(value)
        self.check(path)
        return path

    @abstractmethod
    def check(self, path: Path) -> None:
        """Raise UsageError if the path is not of the kind that is needed."""


class ExistingFile(_Path):
    """A file that exists."""

    name = "file"

    def check(self, path: Path) -> None:
        """Check that the file exists and is not a folder.

        Raises UsageError: If there is no such file, or it is a folder, a pipe or a device.
        """
        if not path.exists():
            raise UsageError("There is no such file.", where=str(path), remedy="Check the path.")
        if path.is_dir():
            raise UsageError("This is a folder, not a file.", where=str(path), remedy="Name a file.")
        _require_no_device(path)


class EventFile(ExistingFile):
    """A file of events, or the folder of a ROS 2 bag."""

    def check(self, path: Path) -> None:
        """See `ExistingFile.check`; a folder with ``metadata.yaml`` is a bag."""
        if not (path / "metadata.yaml").is_file():
            super().check(path)


class ExistingFolder(_Path):
    """A folder that exists."""

    name = "folder"
    completed_as = "dir"

    def check(self, path: Path) -> None:
        """Check that the folder exists.

        Raises UsageError: If there is no such folder, or it is a file.
        """
        if not path.is_dir():
            what = "This is a file, not a folder." if path.exists() else "There is no such folder."
            raise UsageError(what, where=str(path), remedy="Check the path.")


class ExistingPath(_Path):
    """A file or folder that exists."""

    def check(self, path: Path) -> None:
        """Check that the file or folder exists.

        Raises UsageError: If there is no such file or folder, or it is a pipe or a device.
        """
        if not path.exists():
            raise UsageError("There is no such file or folder.", where=str(path), remedy="Check the path.")
        _require_no_device(path)


class NewFile(_Path):
    """A file that does not exist yet, in a folder that exists. Checked before long work begins."""

    name = "file"

    def check(self, path: Path) -> None:
        """Check that the name is free and the folder exists.

        Raises UsageError: If the name is taken, or its folder does not exist.
        """
        if path.exists() or path.is_symlink():
            raise UsageError(
                "A file or folder with this name already exists.",
                where=str(path),
                remedy="Choose another name.",
            )
        if not path.parent.is_dir():
            raise UsageError(
                f"There is no folder {path.parent}.", where=str(path), remedy="Create the folder first."
            )


class OutputFolder(_Path):
    """A folder to write into; the command creates it if it does not exist."""

    name = "folder"
    completed_as = "dir"

    def check(self, path: Path) -> None:
        """Check that neither the path nor a folder above it is a file.

        Raises UsageError: If the path, or what should be a folder above it, is a file.
        """
        there = next((p for p in (path, *path.parents) if os.path.lexists(p)), None)
        if there is not None and not there.is_dir():
            raise UsageError(
                f"{there} is a file, not a folder." if there != path else "This is a file, not a folder.",
                where=str(path),
                remedy="Choose another --output.",
            )


class RunFolder(_Path):
    """The folder of a run.

    batch: Whether the folder of a batch is accepted too.
    journal: Whether the run must have begun: the folder holds a journal, or a process has it locked.
    """

    name = "folder"
    completed_as = "dir"

    def __init__(self, *, batch: bool = False, journal: bool = True) -> None:
        self._batch, self._journal = batch, journal

    def check(self, path: Path) -> None:
        """Check that the folder is a run, or a batch if that is accepted.

        Raises UsageError: If the path does not exist, is a file, is a batch where a run is needed, or is
          another kind of folder.
        """
        from bench.records.folder_lock import is_locked
        from bench.records.run_folder import JOURNAL
        from bench.records.run_index import is_batch

        where = str(path)
        if not path.exists():
            remedy = "Check the path; `starbench runs` lists the runs of this bench."
            raise UsageError("There is no such run folder.", where=where, remedy=remedy)
        if not path.is_dir():
            inside = f" Did you mean {path.parent}?" if (path.parent / JOURNAL).is_file() else ""
            raise UsageError(
                "This is a file, not the folder of a run.", where=where, remedy=f"Check the path.{inside}"
            )
        if is_batch(path):
            if not self._batch:
                raise UsageError("This is a batch, not a run.", where=where, remedy=_batch_remedy(path))
        elif self._journal and not (path / JOURNAL).is_file() and not is_locked(path):
            raise UsageError(
                "This is not a run folder: it has no journal.jsonl.", where=where, remedy=_inside(path)
            )


def _require_no_device(path: Path) -> None:
    """Refuse a pipe, a socket or a device: reading it may never end. Raises UsageError."""
    if not path.is_file() and not path.is_dir():
        raise UsageError(
            "This is a pipe, a socket or a device, not a file.", where=str(path), remedy="Name a file."
        )


def _batch_remedy(path: Path) -> str:
    """Return how to continue a batch if that is possible, and where its runs are."""
    from bench.records.run_index import is_rehearsal

    shown = f"`starbench status {path}` shows its runs; name one of them: {path / 'runs'}/..."
    if is_rehearsal(path):
        return f"This is a rehearsal. It cannot be continued. {shown}"
    return (
        f"To continue the batch: `starbench batch QUEUE.yaml --output {path}`, where QUEUE.yaml is the file it was"
        f" begun with ({path / 'queue.yaml'} is a copy). {shown}"
    )


def _inside(path: Path) -> str:
    """Return which runs lie inside a folder that is not a run itself."""
    from bench.records.run_index import run_folders

    found = [str(folder) for folder in run_folders(path)]
    if not found:
        return "Name the folder of a run; `starbench runs` lists the runs of this bench."
    more = f" and {len(found) - _MOST_NAMED} more" if len(found) > _MOST_NAMED else ""
    return f"Name one of the runs in it: {', '.join(found[:_MOST_NAMED])}{more}."


RUN = click.argument("run_folder", metavar="RUN", type=RunFolder())


class CutoffFrequency(click.ParamType):
    """Cutoff frequency of the filter that reconstructs pictures, Hz."""

    name = "hz"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """See `click.ParamType.convert`. The value may be a path that follows the option."""
        try:
            frequency_hz = float(value)
        except ValueError:
            frequency_hz = 0.0
        if not _CUTOFF_HZ[0] <= frequency_hz <= _CUTOFF_HZ[1]:  # nan too
            self.fail(
                f"{value!r} is not a frequency of {_CUTOFF_HZ[0]:g} to {_CUTOFF_HZ[1]:g} Hz. "
                "Put --reconstruct after the paths, or write a number: --reconstruct 10.",
                param,
                ctx,
            )
        return frequency_hz
