"""The runs and batches of a folder as the first page lists them: those in progress, failures, and the others.

A run that has ended is read once; of a run in progress only new lines are read. Nothing is written.
"""

from __future__ import annotations

import os
import stat
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from bench.base.bounded_json import parse_json
from bench.base.errors import RunFolderError, StorageError
from bench.base.failure import Failure
from bench.extras.pages.panel.run_head import ProcessState, brief_of, faults_of, look_at_process
from bench.extras.pages.panel.run_model import RunModel
from bench.extras.pages.panel.shown_run import FolderContent, ListedBatch, ListedRun
from bench.record.journal import MOST_LINE_BYTES
from bench.record.run_folder import JOURNAL
from bench.record.run_index import QUEUE_COPY
from bench.record.storage import open_to_read, storage_errors
from bench.wording.causes import listed_verdict

Stamp = tuple[int, int, int, int]
_BatchStamp = tuple[Stamp, bool, float]

_BATCH_AGAIN_S = 10.0  # A running batch is read again so often: its expected end changes
MOST_NEW = 1000
"""Most runs that are read for the first time at one look: the list appears after a second, and grows."""


@dataclass
class _Known:
    """What is known of a run: its row, and its model while it may still change."""

    stamp: Stamp
    row: ListedRun
    model: RunModel | None  # None if only a new line of its journal can change the row


class FolderList:
    """The runs and batches of a folder, which need not exist yet, of its subfolders and of theirs."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._runs: dict[str, _Known] = {}
        self._batches: dict[str, tuple[_BatchStamp, ListedBatch]] = {}
        self._lock = threading.Lock()

    def look(self) -> FolderContent:
        """Look at the folder; what cannot be read is a fault."""
        content: FolderContent = {
            "root": str(self.root.absolute()),
            "exists": True,
            "unread": 0,
            "runs": [],
            "batches": [],
            "faults": [],
        }
        with self._lock:
            try:
                content["exists"] = self.root.is_dir()
                folders = dict(self._folders(content["faults"]))
            except Exception as error:  # noqa: BLE001 - the pages must show it; the next look may succeed
                content["faults"].append(Failure.of(error).message)
                return content
            new = 0
            for folder, stamp in folders.items():
                known = self._runs.get(folder)
                new += known is None and folder not in self._batches
                if known is not None and known.model is None and known.stamp == stamp:
                    content["runs"].append(known.row)
                elif known is None and new > MOST_NEW:
                    content["unread"] += 1
                else:
                    self._look_at(Path(folder), stamp, content)
            for kept in (self._runs, self._batches):
                for gone in kept.keys() - folders.keys():
                    kept.pop(gone)
        content["runs"].sort(key=_begin, reverse=True)
        content["batches"].sort(key=_begin, reverse=True)
        return content

    def _look_at(self, folder: Path, stamp: Stamp, content: FolderContent) -> None:
        try:
            self.inside(folder / JOURNAL)
            if (folder / QUEUE_COPY).is_file():
                content["batches"].append(self._batch(folder, stamp))
            else:
                content["runs"].append(self._run(folder, stamp))
        except Exception as error:  # noqa: BLE001 - one folder must not hide the others
            message = Failure.of(error).message
            content["faults"].append(message if str(folder) in message else f"{folder}: {message}")

    def folder_of(self, key: str) -> Path:
        """Return the folder that a page names by its path relative to the root, with slashes; ``.`` for the root."""
        parts = key.split("/")
        if not key or "\0" in key or any(part in {"", ".."} or "\\" in part or ":" in part for part in parts):
            raise _no_such_run(key, self.root)
        folder = self.root.joinpath(*parts)
        self.inside(folder / JOURNAL)
        with storage_errors(folder):
            stamp = _journal_stamp(str(folder))
        if stamp is None:
            raise _no_such_run(key, self.root)
        return folder

    def inside(self, path: Path) -> Path:
        """Return a path below the root if no link leads out: pages could else read other files of this computer."""
        with storage_errors(path):
            if path.resolve().is_relative_to(self.root.resolve()):
                return path
        raise RunFolderError(
            "A link leads out of the folder of the panel, and the panel does not follow it.",
            where=str(path),
            remedy="Start a panel in the folder to which it leads.",
        )

    def key_of(self, folder: Path) -> str:
        """Return the name of a folder as `folder_of` takes it: its path relative to the root."""
        return folder.relative_to(self.root).as_posix()

    def _folders(self, faults: list[str]) -> Iterator[tuple[str, Stamp]]:
        """Yield every folder with a journal, two levels deep, and its stamp; a batch's runs belong to its own page."""
        levels = [[str(self.root)]]
        for _ in range(3):
            below = []
            for folder in levels[-1]:
                stamp = _stamp_or_fault(folder, faults)
                if stamp is not None:
                    yield folder, stamp
                else:
                    below.append(folder)
            levels.append([inner for folder in below for inner in _subfolders(folder, faults)])

    def _run(self, folder: Path, stamp: Stamp) -> ListedRun:
        known = self._runs.get(str(folder))
        model = (known.model if known is not None else None) or RunModel(folder)
        while model.refresh():
            pass
        states = model.history.states
        process = look_at_process(folder, states[-1]["state"] if states else "idle")
        row = self._row(model, process)
        # An interrupted run may be resumed at any time; its lock tells so before its journal does.
        is_over = not process.running and bool(model.history.ended)
        self._runs[str(folder)] = _Known(stamp, row, None if is_over else model)
        return row

    def _row(self, model: RunModel, process: ProcessState) -> ListedRun:
        return {
            **brief_of(model, process, datetime.now(UTC)),
            "headline": listed_verdict(model.history.verdict, model.history.solved.get("causes", ())),
            "key": self.key_of(model.folder),
            "camera": model.history.devices.get("camera", {}).get("serial", ""),
            "fault": next(iter(faults_of(model, process)), ""),
        }

    def _batch(self, folder: Path, journal: Stamp) -> ListedBatch:
        from bench.batch.batch_status import read_batch_status
        from bench.record.folder_lock import is_locked

        running = is_locked(folder)
        stamp = journal, running, time.time() // _BATCH_AGAIN_S if running else 0
        kept = self._batches.get(str(folder))
        if kept is not None and kept[0] == stamp:
            return kept[1]
        status = read_batch_status(folder)
        failed = [run.item for run in status.done if run.how != "finished"]
        ended = status.ended or "interrupted"
        bad = "bad" if failed or ended == "interrupted" else "good" if ended == "finished" else "warn"
        row: ListedBatch = {
            "key": self.key_of(folder),
            "queue": status.queue,
            "running": running,
            "rehearsal": status.rehearsal,
            "simulated": status.simulated,
            "verdict": "running" if running else ended,
            "tone": "busy" if running else bad,
            "why": status.why,
            "done": len(status.done),
            "failed": failed,
            "coming": len(status.upcoming),
            "current_run": status.current_run,
            "end_utc": status.end.isoformat() if status.end and running else "",
            "ended_utc": status.last_end.isoformat() if status.last_end and status.ended else "",
            "started_utc": _first_utc(folder),
        }
        self._batches[str(folder)] = stamp, row
        return row


def _begin(row: ListedRun | ListedBatch) -> str:
    return row["started_utc"]


def _no_such_run(key: str, root: Path) -> RunFolderError:
    return RunFolderError(
        f"There is no run or batch {key!r} in this folder.",
        where=str(root),
        remedy="Go back to the list. The folder may have been moved or removed.",
    )


def _journal_stamp(folder: str) -> Stamp | None:
    """Return which file a folder's journal is, its size and time; None if it has none."""
    try:
        # Of a path as text: a list has ten thousand of them, and ``Path.stat`` takes several times as long.
        status = os.stat(f"{folder}/{JOURNAL}")  # noqa: PTH116
    except (FileNotFoundError, NotADirectoryError):
        return None
    if not stat.S_ISREG(status.st_mode):
        return None
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _stamp_or_fault(folder: str, faults: list[str]) -> Stamp | None:
    try:
        return _journal_stamp(folder)
    except OSError as error:
        faults.append(_fault(error, folder))
        return None


def _fault(error: OSError, folder: str) -> str:
    """Return an error of the system as a sentence with its remedy."""
    try:
        with storage_errors(Path(folder)):
            raise error
    except StorageError as fault:
        return str(fault)


def _subfolders(folder: str, faults: list[str]) -> list[str]:
    try:
        with os.scandir(folder) as entries:
            return sorted(
                entry.path for entry in entries if entry.is_dir() and not entry.name.startswith(".")
            )
    except OSError as error:
        if Path(folder).exists():
            faults.append(_fault(error, folder))
        return []


def _first_utc(folder: Path) -> str:
    """Return the time of the first line of a journal; empty if it cannot be read."""
    try:
        with open_to_read(folder / JOURNAL) as stream:
            return str(parse_json(stream.readline(MOST_LINE_BYTES))["utc"])
    except (StorageError, ValueError, KeyError, TypeError):
        return ""
