"""A batch as its page shows it: failures first, the queue, the time of each run, and the trend of each parameter.

The summary is read again only when the batch's journal has grown; what comes next is told every few seconds.
"""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError
from bench.batch.batch_status import read_batch_status
from bench.batch.batch_summary import RUNS, read_batch, summarise
from bench.records.folder_lock import is_locked
from bench.records.run_folder import JOURNAL
from bench.records.storage import storage_errors
from bench.web.stream import Message

Json = dict[str, Any]

LOOK_S = 0.5
AGAIN_S = 3.0
_FAILURES = frozenset({"failed", "died", "hung", "cut off"})
_NOT_BEGUN = frozenset({"not begun", "withdrawn"})


class BatchView:
    """One batch, for all its pages."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock = threading.Lock()
        self._stamp: tuple[Any, ...] = ()
        self._summary: Json = {}
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
            found = (self.folder / JOURNAL).stat()
        stamp = found.st_size, found.st_mtime_ns, running
        now_s = time.monotonic()
        is_new = stamp != self._stamp
        if not is_new and (not running or now_s - self._made_at_s < AGAIN_S):
            return
        if is_new:
            record = read_batch(self.folder)
            self._summary = summarise(self.folder, record)
            self._lines = _line_count(self.folder / JOURNAL)
        status = read_batch_status(self.folder).to_dict()
        shown = {name: value for name, value in self._summary.items() if name != "items"}
        body = {
            **shown,
            "fault": "",
            "line": self._lines,
            "status": status,
            "items": _failures_first(self._summary["items"]),
            "runs_folder": RUNS,
        }
        self._text = json.dumps(body, separators=(",", ":"), allow_nan=False)
        self._stamp, self._made_at_s = stamp, now_s

    async def messages(self) -> AsyncIterator[Message]:
        """Tell the batch, and again whenever something has changed."""
        told = ""
        while True:
            text, lines = await asyncio.to_thread(self.text)
            if text != told:
                told = text
                yield Message(text, "update", str(lines))
            await asyncio.sleep(LOOK_S)


def _failures_first(items: list[Json]) -> list[Json]:
    """Return the runs of a batch: failures, then those with a result and others, then those that have not begun."""

    def place(item: Json) -> int:
        return 0 if item["how"] in _FAILURES else 2 if item["how"] in _NOT_BEGUN else 1

    return sorted(items, key=place)


def _line_count(path: Path) -> int:
    with storage_errors(path), path.open("rb") as stream:
        return sum(line.endswith(b"\n") for line in stream)
