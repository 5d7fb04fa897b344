"""A batch as its page shows it: failures first, the queue, the time of each run, the trend of each parameter.

The summary is read again only when the batch's journal has grown; what comes next is told every few seconds.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError
from bench.batch.batch_status import read_batch_status
from bench.batch.batch_summary import RUNS, read_batch, summarise
from bench.record.folder_lock import is_locked
from bench.record.run_folder import JOURNAL
from bench.record.storage import storage_errors
from bench.record.summaries import BatchSummary, ItemData

LOOK_S = 0.5  # Below what a person waits for
AGAIN_S = 3.0  # Times in the page advance so often without a change of the journal
_FAILURES = frozenset({"failed", "died", "hung", "cut off"})
_NOT_BEGUN = frozenset({"not begun", "withdrawn"})


class BatchView:
    """One batch, for all its pages."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock = threading.Lock()
        self._stamp: tuple[Any, ...] = ()
        self._summary: BatchSummary | None = None
        self._lines = 0
        self._text = ""
        self._made_at_s = float("-inf")

    def text(self) -> tuple[str, int]:
        """Return the batch as JSON. May read many files, so not for the server's own thread."""
        with self._lock:
            try:
                self._look()
            except BenchError as error:
                self._text = json.dumps({"fault": str(error), "line": self._lines})
            return self._text, self._lines

    def _look(self) -> None:
        running = is_locked(self.folder)
        with storage_errors(self.folder):
            file_status = (self.folder / JOURNAL).stat()
        stamp = file_status.st_size, file_status.st_mtime_ns, running
        now_s = time.monotonic()
        is_new = stamp != self._stamp
        if not is_new and (not running or now_s - self._made_at_s < AGAIN_S):
            return
        summary = self._summary
        if is_new or summary is None:
            record = read_batch(self.folder)
            summary = self._summary = summarise(self.folder, record)
            self._lines = _line_count(self.folder / JOURNAL)
        status = read_batch_status(self.folder).to_dict()
        shown = {name: value for name, value in summary.items() if name != "items"}
        body = {
            **shown,
            "fault": "",
            "line": self._lines,
            "status": status,
            "items": _failures_first(summary["items"]),
            "runs_folder": RUNS,
        }
        self._text = json.dumps(body, separators=(",", ":"), allow_nan=False)
        self._stamp, self._made_at_s = stamp, now_s


def _failures_first(items: Sequence[ItemData]) -> list[ItemData]:
    """Return the runs of a batch: failures, then those with a result and others, then those that have not begun."""

    def place(item: ItemData) -> int:
        return 0 if item["how"] in _FAILURES else 2 if item["how"] in _NOT_BEGUN else 1

    return sorted(items, key=place)


def _line_count(path: Path) -> int:
    with storage_errors(path), path.open("rb") as stream:
        return sum(line.endswith(b"\n") for line in stream)
