"""What the helper process adds to a run's page: the coverage of the image so far, and the uncertainty to expect.

One task for each run that pages watch. It asks for what is missing, one thing after the other.
"""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from bench.panel.watching import RunWatch

# Asks the panel's helper process (`bench.panel.helper_process`); starts it when it is needed first.

Json = dict[str, Any]
Answer = tuple[Json, bytes]

_MODULE = "bench.panel.helper_process"
_MOST_PICTURES = 60
_END_S = 2.0


class Helper:
    """The helper process, for all pages together. For any thread; one request at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._kept: OrderedDict[tuple[Any, ...], Answer] = OrderedDict()
        self._closed = False

    def ask(self, operation: str, **arguments: Any) -> Answer:
        """Do an operation of `helper_process.OPERATIONS`; the answer has a ``fault`` if it failed."""
        with self._lock:
            if self._closed:
                return {"fault": "The panel is ending."}, b""
            try:
                return self._exchange({"operation": operation, **arguments})
            except (OSError, ValueError):
                self._end()
                return {
                    "fault": "The helper process of the panel has ended; it is started again with the next request."
                }, b""

    def picture(self, key: tuple[Any, ...], ask: Callable[[], Json]) -> Answer:
        """Return a picture; one that was made before is not made again. ``ask`` returns its arguments."""
        if key in self._kept:
            return self._kept[key]
        answer = self.ask("picture", **ask())
        if answer[1]:
            self._kept[key] = answer
            while len(self._kept) > _MOST_PICTURES:
                with suppress(KeyError):
                    self._kept.popitem(last=False)
        return answer

    def close(self) -> None:
        """End the process."""
        self._closed = True
        process = self._process
        if process is not None:
            process.kill()
        with self._lock:
            self._end()

    def _exchange(self, request: Json) -> Answer:
        process = self._process
        if process is None or process.poll() is not None:
            self._end()
            process = self._process = _start()
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(request).encode() + b"\n")
        process.stdin.flush()
        line = process.stdout.readline()
        if not line:
            raise OSError("no answer")
        answer = json.loads(line)
        data = process.stdout.read(answer.pop("bytes"))
        return answer, data

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        with suppress(subprocess.TimeoutExpired):
            process.wait(_END_S)
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()


def _start() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", _MODULE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=dict(os.environ),
    )


CELLS = (32, 18)
"""Columns and rows in which the coverage is counted."""
_MOST_GRIDS = 500
_MOST_FORECASTS = 8
_MOST_POSES_TO_FORECAST = 60


class Extras:
    """The additions to one run's page."""

    def __init__(self, watch: RunWatch, helper: Helper) -> None:
        self._watch = watch
        self._helper = helper
        self._generation = 0
        self._covered = 0
        self._counts = [0] * (CELLS[0] * CELLS[1])
        self._forecast: list[dict[str, Any]] = []
        self._forecast_left: list[int] | None = None

    async def keep_up(self) -> None:
        """Add to the page whatever can be calculated, until cancelled."""
        changes = self._watch.changes
        while True:
            number = changes.number
            if not await self._cover() and not await self._foresee():
                await changes.after(number)

    async def _cover(self) -> bool:
        """Count the stars of the recordings accepted since; return whether there were any."""
        model = self._watch.model
        with self._watch.lock:
            if model.generation != self._generation:
                self._generation, self._covered = model.generation, 0
                self._counts = [0] * len(self._counts)
                self._forecast, self._forecast_left = [], None
            grids = model.grids[self._covered : self._covered + _MOST_GRIDS]
            size = _image_size(model.history.devices.get("camera", {}), model.last_stored.get("facts", {}))
            poses = sum(1 for pose in model.plan.poses.values() if pose.get("angles_deg"))
        if self._forecast_left is None and poses:
            self._forecast_left = forecast_poses(poses)
        if not grids or size is None:
            return False
        answer, _ = await asyncio.to_thread(
            self._helper.ask,
            "coverage",
            folder=str(model.folder),
            size=size,
            cells=CELLS,
            grids=grids,
        )
        self._covered += len(grids)
        if "counts" in answer:
            self._counts = [a + b for a, b in zip(self._counts, answer["counts"], strict=True)]
            share = sum(count > 0 for count in self._counts) / len(self._counts)
            coverage = {"cells": CELLS, "counts": self._counts, "share": round(share, 4), "size": size}
            self._watch.tell({"coverage": {**coverage, "poses": self._covered}})
        return True

    async def _foresee(self) -> bool:
        """Forecast the uncertainty after one more number of poses; return whether there was one left."""
        if not self._forecast_left:
            return False
        poses = self._forecast_left.pop(0)
        answer, _ = await asyncio.to_thread(
            self._helper.ask, "forecast", folder=str(self._watch.model.folder), poses=poses
        )
        if answer.get("now"):
            self._forecast.append({"poses": poses, "now": answer["now"]})
            self._forecast.sort(key=lambda one: one["poses"])
            self._watch.tell({"forecast": list(self._forecast)})
        return True


def forecast_poses(poses: int) -> list[int]:
    """Return after how many poses of a plan the uncertainty is forecast: all of them first, then some before.

    Returns: At most eight numbers; a plan with very many poses is forecast up to a part of them only.

    Examples
    --------
    >>> forecast_poses(4)
    [4, 2, 3]
    >>> forecast_poses(40)
    [40, 2, 3, 5, 8, 14, 24]
    """
    most = min(poses, _MOST_POSES_TO_FORECAST)
    found = [2, 3]
    while found[-1] < most and len(found) < _MOST_FORECASTS - 1:
        found.append(max(found[-1] + 1, round(found[-1] * 1.7)))
    return [most, *(number for number in found if number < most)]


def _image_size(camera: Any, facts: Any) -> Sequence[int] | None:
    """Return width and height of the image, px, as the camera or the last recording states them."""
    for source in (camera, facts):
        if source.get("width") and source.get("height"):
            return int(source["width"]), int(source["height"])
    return None
