"""The live picture: one thread records a short slice, lets it be measured, shows it, and begins again.

Slices lie in a private folder, in memory where there is room, until they are measured; a killed process leaves its
folder to the next session. Settings change between two slices, by the same thread (`LiveLoop.on_camera`).
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from bench.base.background import settle
from bench.base.clock import Aborted
from bench.base.failure import Failure
from bench.base.memory_folder import temporary_parent
from bench.extras.pages.align.figure_rows import FigureRow, SteadyVerdicts, figure_rows
from bench.extras.pages.align.focus_curve import FocusCurve
from bench.extras.pages.align.live_figures import LiveFigures, LiveSetting, LiveSlice
from bench.extras.pages.align.meter import Meter
from bench.measure.camera_kinds import event_camera, frame_camera
from bench.stations.devices import Camera
from drivers.camera import PreviewCamera, RecordingFacts
from drivers.camera.frames import FrameFacts

_ROOM_BYTES = 500_000_000
"""Least room in memory for slices: the link of an EVK4 brings 200 MB a second, and most slices are far shorter."""
_NAME = re.compile(r"starbench-align-(\d+)-\w+")
SHORT_S = 1 / 60
"""Shortest length of a slice, s, rounded to whole flicker periods. A short slice makes a quick picture."""
PERIODS = 3
"""Least periods of a slice at rest: it holds two sync edges of each direction at any phase of the light."""
MOVING_PERIODS = 1
"""Periods of a slice while the stage turns: more would smear the picture."""
LONGEST_SLICE_S = 4.0
"""Longest slice, s. With a slower flicker, a slice holds no whole period."""
_AFTER_FAULT_S = 1.0  # Until the next try
SHORTEST_S = 0.1
"""Shortest time from one slice to the next, s. A person sees no more in more pictures."""

T = TypeVar("T")


def make_slice_folder() -> Path:
    """Make a folder that only this user can read, in memory if it has room; remove those left behind."""
    parent = temporary_parent(_ROOM_BYTES)
    _remove_left_behind(parent)
    return Path(tempfile.mkdtemp(prefix=f"starbench-align-{os.getpid()}-", dir=parent))


def _remove_left_behind(parent: Path) -> None:
    """Remove this user's folders of processes that have ended."""
    for folder in parent.glob("starbench-align-*"):
        name = _NAME.fullmatch(folder.name)
        try:
            if name and folder.lstat().st_uid == os.getuid() and not _is_alive(int(name[1])):
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:  # another session removes it at the same time
            continue


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def slice_duration_s(setting: LiveSetting, *, moving: bool) -> float:
    """Return how long a slice is, s. It holds whole periods of the flicker, if the light flickers."""
    if not setting.light_on or not setting.frequency_hz:
        return SHORT_S
    periods = MOVING_PERIODS if moving else max(PERIODS, round(SHORT_S * setting.frequency_hz))
    return min(periods / setting.frequency_hz, LONGEST_SLICE_S)


@dataclass(frozen=True)
class LivePicture:
    """The newest picture and its figures."""

    number: int = 0  # Counts the pictures, from 1; 0 before the first one
    jpeg: bytes = b""  # White print is bright
    figures: LiveFigures = field(default_factory=LiveFigures)
    rows: Sequence[FigureRow] = ()  # What the page shows of them
    # Time, s, and edge width, px, of each picture of the last minute in which it was measured.
    focus_curve: Sequence[tuple[float, float]] = ()


class LiveLoop:
    """Records and measures slices until it is closed; ``on_picture`` is called from its thread."""

    def __init__(
        self,
        camera: Camera,
        setting: Callable[[], LiveSetting],
        reading_deg: Callable[[], Mapping[str, float]],
        on_picture: Callable[[], None],
        meter: Meter,
        moving: Callable[[], bool],
    ) -> None:
        self._camera = camera
        self._setting = setting
        self._reading_deg = reading_deg
        self._on_picture = on_picture
        self._moving = moving
        self._folder = make_slice_folder()
        self._meter = meter
        self._wake = threading.Condition()
        self._tasks: deque[tuple[Callable[[], Any], Future[Any]]] = deque()
        self._closing = False
        self._lit: tuple[bool | None, float | None] = (None, None)
        self.curve = FocusCurve()
        self._verdicts = SteadyVerdicts()
        self.latest = LivePicture()
        """The newest picture."""
        self.failure: Failure | None = None
        """Why there is no new picture; None while pictures come."""
        self._thread = threading.Thread(target=self._work, name="align-live", daemon=True)

    def start(self) -> None:
        """Begin to record."""
        self._thread.start()

    def on_camera(self, task: Callable[[], T]) -> Future[T]:
        """Let the recording thread do something with the camera between two slices. The present slice ends early."""
        future: Future[T] = Future()
        with self._wake:
            if self._closing:
                future.cancel()
                return future
            self._tasks.append((task, future))
            self._wake.notify_all()
        self._camera.stop()
        return future

    def forget(self) -> None:
        """Begin the curve of the focus anew."""
        self.curve = FocusCurve()

    def close(self) -> bool:
        """End the recording, and remove the temporary folder; True if the camera records no more."""
        with self._wake:
            self._closing = True
            self._wake.notify_all()
        self._camera.stop()
        self._meter.close()
        if self._thread.is_alive():
            self._thread.join(timeout=6.0)
        for _, future in self._tasks:
            future.cancel()
        shutil.rmtree(self._folder, ignore_errors=True)
        return not self._thread.is_alive()

    def _work(self) -> None:
        while not self._closing:
            self._do_tasks()
            due_s = time.monotonic() + SHORTEST_S
            try:
                self._make_picture()
            except Aborted:
                return
            except Exception as error:  # noqa: BLE001 - one bad slice must not end the live picture
                due_s = time.monotonic() + _AFTER_FAULT_S
                self._fail(Failure.of(error))
            with self._wake:
                self._wake.wait_for(lambda: self._closing or self._tasks, max(0.0, due_s - time.monotonic()))

    def _do_tasks(self) -> None:
        while self._tasks:
            with self._wake:
                task, future = self._tasks.popleft()
            if future.set_running_or_notify_cancel():
                settle(future, task)

    def _make_picture(self) -> None:
        """Record a slice, measure it and show it; a slice that a task has ended is left out."""
        setting = self._setting()
        path = self._folder / ("slice.tif" if setting.camera == "frame" else "slice.raw")
        try:
            started_s, moving = time.monotonic(), self._moving()
            facts = self._record(path, setting, moving=moving)
            if self._closing or (self._tasks and not facts.complete):
                return
            moving = moving or self._moving()
            part = LiveSlice(path, started_s, facts, dict(self._reading_deg()), moving)
            jpeg, figures = self._meter.measure(part, setting)
        finally:
            path.unlink(missing_ok=True)
        curve = self._follow_focus(figures, setting)
        rows = self._verdicts.steady(figure_rows(figures, setting, curve.best_px))
        self.latest = LivePicture(self.latest.number + 1, jpeg, figures, rows, curve.points())
        self.failure = None
        self._on_picture()

    def _record(self, path: Path, setting: LiveSetting, *, moving: bool) -> RecordingFacts | FrameFacts:
        if setting.camera == "frame":
            return frame_camera(self._camera).capture(path, 1)
        camera = event_camera(self._camera)
        take = camera.preview if isinstance(camera, PreviewCamera) else camera.record
        return take(path, slice_duration_s(setting, moving=moving))

    def _follow_focus(self, figures: LiveFigures, setting: LiveSetting) -> FocusCurve:
        """Add the edge width of a picture to the curve; light and pose begin the best and all verdicts anew."""
        curve, lit = self.curve, (setting.light_on, setting.level_percent)
        if figures.moving or lit != self._lit:
            self._lit = lit
            curve.begin_best()
            self._verdicts = SteadyVerdicts()
        if figures.edge_width_px is not None:
            curve.add(figures.time_s, figures.edge_width_px)
        return curve

    def _fail(self, failure: Failure) -> None:
        if not self._closing:
            self.failure = failure
            self._on_picture()
