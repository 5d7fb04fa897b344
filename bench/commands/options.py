"""Words that commands share: paths checked before any work begins, options that several commands take.

Knows what a folder or file must look like to be what was asked for, and says what to do where it is not. Reads and
changes nothing inside them; messages end with status 2, as every wrong word does.
"""

from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

import click

from bench.base.errors import UsageError

JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output.")
SEED = click.IntRange(0, 2**63 - 1)
_MOST_NAMED = 5


class Number(click.ParamType):
    """A number that is finite, from ``least`` (above it, where ``above``) to ``most``, as far as these are given."""

    name = "number"

    def __init__(self, *, least: float | None = None, above: bool = False, most: float | None = None) -> None:
        self._least, self._above, self._most = least, above, most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Give the number. Raises click.BadParameter."""
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a number.", param, ctx)
        if self._least is not None and (number < self._least or (self._above and number == self._least)):
            self.fail(f"{value} is not {'above' if self._above else 'at least'} {self._least:g}.", param, ctx)
        if self._most is not None and number > self._most:
            self.fail(f"{value} is more than {self._most:g}.", param, ctx)
        return number


class _Path(click.ParamType, ABC):
    """A path that must be something before the command begins."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Give the path, once it is found to be what is asked for. Raises UsageError, OSError."""
        del param, ctx
        path = Path(value)
        self.check(path)
        return path

    @abstractmethod
    def check(self, path: Path) -> None:
        """Raise UsageError where the path is not what is asked for."""


class ExistingFile(_Path):
    """A file that is there."""

    name = "file"

    def check(self, path: Path) -> None:
        """Refuse what is missing, and folders."""
        if not path.exists():
            raise UsageError("There is no such file.", where=str(path), remedy="Check the path.")
        if path.is_dir():
            raise UsageError("This is a folder, not a file.", where=str(path), remedy="Name a file.")


class ExistingFolder(_Path):
    """A folder that is there."""

    name = "folder"

    def check(self, path: Path) -> None:
        """Refuse what is missing, and files."""
        if not path.is_dir():
            what = "This is a file, not a folder." if path.exists() else "There is no such folder."
            raise UsageError(what, where=str(path), remedy="Check the path.")


class ExistingPath(_Path):
    """A file or folder that is there."""

    def check(self, path: Path) -> None:
        """Refuse what is missing."""
        if not path.exists():
            raise UsageError("There is no such file or folder.", where=str(path), remedy="Check the path.")


class NewFile(_Path):
    """A file that is not there yet, in a folder that is: seen before an hour's work goes into it."""

    name = "file"

    def check(self, path: Path) -> None:
        """Refuse a name that is taken, and one in a folder that is not there."""
        if path.exists() or path.is_symlink():
            raise UsageError(
                "There is something of this name already.", where=str(path), remedy="Choose another name."
            )
        if not path.parent.is_dir():
            raise UsageError(
                f"There is no folder {path.parent} to write it in.", where=str(path), remedy="Make it first."
            )


class OutputFolder(_Path):
    """A folder to write into; made where it is missing."""

    name = "folder"

    def check(self, path: Path) -> None:
        """Refuse a file, and what would lie inside one."""
        there = next((p for p in (path, *path.parents) if os.path.lexists(p)), None)
        if there is not None and not there.is_dir():
            raise UsageError(
                f"{there} is a file, not a folder." if there != path else "This is a file, not a folder.",
                where=str(path),
                remedy="Choose another --output.",
            )


class RunFolder(_Path):
    """The folder of a run; where ``batch`` allows it, that of a batch. With ``journal``, one that has begun."""

    name = "folder"

    def __init__(self, *, batch: bool = False, journal: bool = True) -> None:
        self._batch, self._journal = batch, journal

    def check(self, path: Path) -> None:
        """Refuse what is missing, files, batches where a run is wanted, and folders of something else."""
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
                "This is a file; a run is a folder.", where=where, remedy=f"Check the path.{inside}"
            )
        if is_batch(path):
            if not self._batch:
                raise UsageError("This is a batch, not a run.", where=where, remedy=_batch_remedy(path))
        elif self._journal and not (path / JOURNAL).is_file() and not is_locked(path):
            raise UsageError(
                "This is not a run folder: it has no journal.jsonl.", where=where, remedy=_inside(path)
            )


def _batch_remedy(path: Path) -> str:
    """Tell how a batch goes on, and that its runs are inside."""
    return (
        f"The batch goes on with `starbench batch QUEUE.yaml --output {path}`, QUEUE.yaml being the file it was begun"
        f" with ({path / 'queue.yaml'} is a copy). `starbench status {path}` shows its runs;"
        f" each can be named itself: {path / 'runs'}/..."
    )


def _inside(path: Path) -> str:
    """Name the runs inside a folder that is none itself."""
    from bench.records.run_index import run_folders

    found = [str(folder) for folder in run_folders(path)]
    if not found:
        return "Name the folder a run was written to; `starbench runs` lists the runs of this bench."
    more = f" and {len(found) - _MOST_NAMED} more" if len(found) > _MOST_NAMED else ""
    return f"Name one of the runs in it: {', '.join(found[:_MOST_NAMED])}{more}."


RUN = click.argument("run_folder", metavar="RUN", type=RunFolder())
