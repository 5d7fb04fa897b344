"""One reader for all pages: a thread that looks at the journals which pages show, and wakes the pages.

A journal that is shown is looked at 50 times a second by one system call, and read only where it has grown.
"""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from bench.base.failure import Failure
from bench.base.worker_process import WorkerProcess
from bench.extras.pages.panel.helper_process import (
    CoverageRequest,
    ForecastRequest,
    PictureAnswer,
    PictureRequest,
    Request,
)
from bench.extras.pages.panel.journal_tail import read_final
from bench.extras.pages.panel.run_head import ProcessState, head_of, look_at_process
from bench.extras.pages.panel.run_model import RunModel
from bench.extras.pages.panel.shown_run import Coverage, Forecast, RunExtras, RunHead, RunMessage
from bench.extras.pages.web.server_sent import Changes
from bench.record.history import History
from bench.run.last_view import LastView, read_last_view

LOOK_S = 0.02
"""Time between two looks at a journal, s: a person sees no delay."""
PROCESS_S = 0.5
"""Time between two looks at a run's process, s."""
AGAIN_S = 5.0
"""A run in progress is told again after this time, because its times change, s."""
LINGER_S = 20.0
"""A run without readers is kept for this time, s: a page that is loaded again finds it ready."""
MOST_VIEWS = 40
"""Pictures that are kept for each run; it bounds the memory of a night."""
T = TypeVar("T")
_MOST_PICTURES = 60  # So that a page left open for a night keeps its memory

CELLS = (32, 18)
"""Columns and rows in which the coverage is counted: squares of 40 px at 1280 x 720."""
_MOST_FORECASTS = 8  # Points of a curve
_MOST_POSES_TO_FORECAST = 60  # Further poses change little


class RunWatch:
    """One run that pages watch."""

    def __init__(self, folder: Path) -> None:
        self.model = RunModel(folder)
        self.process = ProcessState()
        self.changes = Changes()
        self.readers = 0
        self.left_at_s = time.monotonic()
        self.extras: RunExtras = {}
        self.views: dict[tuple[int, int], LastView] = {}
        """Pictures that the run has left, by pose and attempt; the newest last."""
        self.lock = threading.RLock()
        self._process_at_s = self._told_at_s = float("-inf")
        self._messages: dict[tuple[int, bool], str] = {}
        self._last_head: RunHead | None = None

    def look(self, now_s: float) -> bool:
        """Look at the run; wake the pages if anything is new. True if there is more to read at once."""
        with self.lock:
            new = self._refresh()
            if new:
                self._keep_view()
                self._keep_final()
            if new or now_s - self._process_at_s >= PROCESS_S:
                new = self._look_at_process(now_s) or new
            if now_s - self._told_at_s >= AGAIN_S and self.process.running:
                new = True
            if new:
                self._messages.clear()
                self._told_at_s = now_s
            more = self.model.tail.more
        if new:
            self.changes.tell()
        return more

    def message(self, after: int, generation: int | None) -> tuple[str, int, int]:
        """Return, as JSON, what is new after some lines of a ``generation`` (None: another process's)."""
        with self.lock:
            model = self.model
            anew = after <= 0 or after > model.lines or generation not in {None, model.generation}
            begin = 0 if anew else after
            text = self._messages.get((begin, anew))
            if text is None:
                body: RunMessage = {
                    "reset": anew,
                    "since": begin,
                    "line": model.lines,
                    "head": self._head(),
                    "rows": model.changed_rows(begin),
                    "log": model.log_after(begin),
                    **self.extras,
                }
                text = self._messages[begin, anew] = json.dumps(body, separators=(",", ":"), allow_nan=False)
            return text, model.lines, model.generation

    def tell(self, extras: RunExtras) -> None:
        """Add what the helper process has calculated, and wake the pages."""
        with self.lock:
            self.extras.update(extras)
            self._messages.clear()
        self.changes.tell()

    def _keep_final(self) -> None:
        """Keep the uncertainties of the results, once the run has ended; they go if it is resumed."""
        ended = bool(self.model.history.ended)
        if ended and "final" not in self.extras:
            self.extras["final"] = read_final(self.model.folder)
        elif not ended:
            self.extras.pop("final", None)

    def _head(self) -> RunHead:
        """Return the head; that of before, with the fault, if another version's journal confuses it."""
        try:
            self._last_head = head_of(self.model, self.process, datetime.now(UTC))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            if self._last_head is None:
                raise
            fault = f"The state of this run cannot be shown completely. {Failure.of(error).message}"
            return {**self._last_head, "faults": [*self._last_head["faults"], fault]}
        return self._last_head

    def _keep_view(self) -> None:
        """Keep the picture of the recording that was checked last; the next one will replace it in the folder."""
        checked = self.model.last_checked
        if checked is None or self.model.tail.more or self.model.history.ended:
            return
        place = checked["pose"], checked["attempt"]
        if place in self.views:
            return
        left = read_last_view(self.model.folder)
        if left is not None and (left.pose, left.attempt) == place:
            self.views[place] = left
            while len(self.views) > MOST_VIEWS:
                del self.views[next(iter(self.views))]

    def _refresh(self) -> bool:
        try:
            return self.model.refresh()
        except Exception as error:  # noqa: BLE001 - one journal must not stop the thread that reads all of them
            before, self.model.fault = self.model.fault, Failure.of(error).message
            return before != self.model.fault

    def _look_at_process(self, now_s: float) -> bool:
        self._process_at_s = now_s
        states = self.model.history.states
        state = look_at_process(self.model.folder, states[-1]["state"] if states else "idle")
        before, self.process = self.process, state
        return _told_of(before) != _told_of(state)


def _told_of(process: ProcessState) -> tuple[Any, ...]:
    """Return what of a process's state is worth a message at once."""
    return process.running, process.sealed, process.takes_commands, process.quiet_s is None, process.fault


class Watcher:
    """Looks at all runs that pages watch, in one thread."""

    def __init__(self) -> None:
        self._watches: dict[Path, RunWatch] = {}
        self._lock = threading.Lock()
        self._awake = threading.Event()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="journals", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def close(self) -> None:
        """Look no more."""
        self._closing = True
        self._awake.set()
        if self._thread.is_alive():
            self._thread.join()

    @contextmanager
    def watched(self, folder: Path) -> Iterator[RunWatch]:
        """Watch a run for a moment. Not for the server's own thread, as `open`."""
        watch = self.open(folder)
        try:
            yield watch
        finally:
            self.leave(watch)

    def open(self, folder: Path) -> RunWatch:
        """Watch a run for one more page. Reads the begin of its journal, so not for the server's own thread."""
        with self._lock:
            watch = self._watches.get(folder)
            is_new = watch is None
            if watch is None:
                watch = self._watches[folder] = RunWatch(folder)
            watch.readers += 1
        if is_new:
            watch.look(time.monotonic())
        self._awake.set()
        return watch

    def leave(self, watch: RunWatch) -> None:
        """Watch a run for one page fewer."""
        with self._lock:
            watch.readers -= 1
            watch.left_at_s = time.monotonic()

    def _run(self) -> None:
        while not self._closing:
            watches = self._in_use()
            if not watches:
                self._awake.wait(LINGER_S)
                self._awake.clear()
                continue
            begin_s = time.monotonic()
            more = [watch.look(begin_s) for watch in watches]
            if not any(more):
                time.sleep(max(LOOK_S - (time.monotonic() - begin_s), LOOK_S / 4))

    def _in_use(self) -> list[RunWatch]:
        """Return the runs that pages watch; forget those that none has watched for a while."""
        now_s = time.monotonic()
        with self._lock:
            for folder, watch in list(self._watches.items()):
                if watch.readers <= 0 and now_s - watch.left_at_s > LINGER_S:
                    del self._watches[folder]
            return [watch for watch in self._watches.values() if watch.readers > 0]


class Helper:
    """The helper process, for all pages together. For any thread; one request at a time."""

    def __init__(self) -> None:
        self._worker = WorkerProcess("bench.extras.pages.panel.helper_process")
        self._kept: OrderedDict[tuple[Path, int, int, bool], tuple[PictureAnswer, bytes]] = OrderedDict()

    def ask(self, request: Request[T]) -> T | str:
        """Return the answer to a request, or say why it has none."""
        try:
            answer: T | str = self._worker.ask(request)
        except EOFError:
            ended = "The helper process of the panel has ended; it is started again with the next request."
            return "The panel is ending." if self._worker.closed else ended
        return answer

    def picture(self, request: PictureRequest) -> tuple[PictureAnswer, bytes]:
        """Return a picture; one that was made before is not made again."""
        key = request.folder, request.pose, request.attempt, request.accepted
        if key in self._kept:
            return self._kept[key]
        answer = self.ask(request)
        if isinstance(answer, str):
            return {"fault": answer}, b""
        if answer[1]:
            self._kept[key] = answer
            while len(self._kept) > _MOST_PICTURES:
                with suppress(KeyError):
                    self._kept.popitem(last=False)
        return answer

    def close(self) -> None:
        """End the process."""
        self._worker.close()


class Extras:
    """The additions to one run's page."""

    def __init__(self, watch: RunWatch, helper: Helper) -> None:
        self._watch = watch
        self._helper = helper
        self._covered = self._planned = 0, 0
        """Generation of the journal, with the number of recordings counted, and of poses planned."""
        self._forecast: list[Forecast] = []
        self._forecast_left: list[int] = []

    async def keep_up(self) -> None:
        """Add to the page whatever can be calculated, until cancelled."""
        changes = self._watch.changes
        while True:
            number = changes.number
            if not await self._cover() and not await self._foresee():
                await changes.after(number)

    async def _cover(self) -> bool:
        """Count the stars of the accepted recordings if there are new ones; return whether there were."""
        model = self._watch.model
        with self._watch.lock:
            grids, size = _grids(model.history), _image_size(model)
            now = model.generation, len(grids)
        if not grids or size is None or now == self._covered:
            return False
        counts = await asyncio.to_thread(self._helper.ask, CoverageRequest(model.folder, size, CELLS, grids))
        self._covered = now
        if not isinstance(counts, str):
            share = round(sum(count > 0 for count in counts) / len(counts), 4)
            coverage = Coverage(cells=CELLS, counts=counts, share=share, size=size, poses=len(grids))
            self._watch.tell({"coverage": coverage})
        return True

    async def _foresee(self) -> bool:
        """Forecast the uncertainty after one more number of poses; return whether there was one left."""
        model = self._watch.model
        with self._watch.lock:
            planned = model.generation, sum(1 for pose in model.plan.poses.values() if pose["angles_deg"])
        if planned[1] and planned != self._planned:
            self._planned = planned
            self._forecast, self._forecast_left = [], forecast_poses(planned[1])
        if not self._forecast_left:
            return False
        poses = self._forecast_left.pop(0)
        now = await asyncio.to_thread(self._helper.ask, ForecastRequest(model.folder, poses))
        if now and not isinstance(now, str):
            self._forecast.append({"poses": poses, "now": now})
            self._forecast.sort(key=lambda forecast: forecast["poses"])
            self._watch.tell({"forecast": list(self._forecast)})
        return True


def _grids(history: History) -> list[tuple[Sequence[Sequence[float]], int]]:
    """Return grid and number of stars of the accepted recordings, in the order of their acceptance."""
    checked = [check.checked for check in history.accepted().values() if check.checked is not None]
    return [(check["measured"]["grid"], check["stars"]) for check in checked if "grid" in check["measured"]]


def forecast_poses(poses: int) -> list[int]:
    """Return after how many poses of a plan the uncertainty is forecast: all of them first, then some before.

    There are at most eight numbers; a plan with very many poses is forecast up to a part of them only.

    >>> forecast_poses(4)
    [4, 2, 3]
    >>> forecast_poses(40)
    [40, 2, 3, 5, 8, 14, 24]
    """
    most = min(poses, _MOST_POSES_TO_FORECAST)
    counts = [2, 3]
    while counts[-1] < most and len(counts) < _MOST_FORECASTS - 1:
        counts.append(max(counts[-1] + 1, round(counts[-1] * 1.7)))
    return [most, *(number for number in counts if number < most)]


def _image_size(model: RunModel) -> tuple[int, int] | None:
    """Return width and height of the image, px, as the camera or the last recording states them."""
    camera, last = model.history.devices.get("camera", {}), model.last_stored
    for source in (camera, last["facts"] if last else {}):
        if source.get("width") and source.get("height"):
            return int(source["width"]), int(source["height"])
    return None
