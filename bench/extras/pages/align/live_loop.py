"""The live picture: one thread records short slices, another one measures the newest of them.

Slices lie in a private folder, in memory where there is room, until they are measured; a killed process leaves its
folder to the next session. Settings change between two slices, by the recording thread (`LiveLoop.on_camera`).
"""

from __future__ import annotations

import math
import os
import re
import shutil
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
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
from drivers.errors import DriverError

_ROOM_BYTES = 500_000_000
"""Least room in memory for slices: the link of an EVK4 brings 200 MB a second, and most slices are far shorter."""
_NAME = re.compile(r"starbench-align-(\d+)-\w+")
SHORT_S = 1 / 60
"""Length of most slices, s, rounded to whole flicker periods, at least one. A short slice makes a quick picture."""
LONGEST_SLICE_S = 4.0
"""Longest slice, s. With a slower flicker, a slice holds no whole period."""
_OF_LONGER = (
    "triggers",
    "triggers_expected",
    "sync_edges",
    "sync_fault",
    "trigger_hz",
    "event_hz",
    "jitter_us",
)
_LEARNT = 0.3
"""Weight of the newest duration in the expected ones."""
_RATE_OVER_S = 4.0  # Long enough for two digits of the rate, short enough to follow a change

SIGNAL_PERIODS = 4
"""Periods of a slice that shows the flicker itself: frequency by triggers and by events, and jitter. It holds three
whole periods at any phase of the light."""
SIGNAL_EVERY_S = 4.0
"""Time between two such slices, s."""
_AFTER_FAULT_S = 1.0  # Until the next try
MOVING_PERIODS = 0.6
"""Length of a slice while the stage turns, periods: it holds one edge of the light at least."""
_STALE_S = 0.4
"""Age of a slice from which it is recorded again while it waits to be measured, s."""
SHORTEST_S = 0.1
"""Shortest time from one slice to the next, s. A person sees no more in more pictures."""
_EARLY_S = 0.02  # A slice is there so much before it can be measured, so that the measurement does not wait

T = TypeVar("T")
Recorded = RecordingFacts | FrameFacts


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


def slice_periods(setting: LiveSetting) -> int:
    """Return how many flicker periods a short slice holds: at least 1; 0 if there is no flicker."""
    if not setting.light_on or not setting.frequency_hz:
        return 0
    return max(1, round(SHORT_S * setting.frequency_hz))


def with_signal_of(figures: LiveFigures, signal: LiveFigures) -> LiveFigures:
    """Return the figures of a short slice, completed by those of the last slice of `SIGNAL_PERIODS` or more."""
    longer = {name: getattr(signal.signal, name) for name in _OF_LONGER}
    return replace(figures, signal=replace(figures.signal, **longer))


def learnt_s(known_s: float, newest_s: float) -> float:
    """Return the expected duration, s, after the newest one; 0 says that none was known so far."""
    return newest_s if known_s == 0.0 else known_s + _LEARNT * (newest_s - known_s)


def slice_duration_s(setting: LiveSetting, periods: float) -> float:
    """Return the length of a slice of some flicker periods, s; 0 periods without flicker."""
    if periods == 0 or not setting.frequency_hz:
        return SHORT_S
    return min(periods / setting.frequency_hz, LONGEST_SLICE_S)


def rate_per_s(times_s: Iterable[float]) -> float:
    """Return how often something happened in a second, from its times in order; 0 if it happened less than twice."""
    now_s = time.monotonic()
    recent = [at for at in list(times_s) if now_s - at < _RATE_OVER_S]
    if len(recent) < 2:
        return 0.0
    return (len(recent) - 1) / max(1e-6, now_s - recent[0])


@dataclass(frozen=True)
class LivePicture:
    """The newest picture and its figures."""

    number: int = 0  # Counts the pictures, from 1; 0 before the first one
    jpeg: bytes = b""  # White print is bright
    figures: LiveFigures = field(default_factory=LiveFigures)
    rows: Sequence[FigureRow] = ()  # What the page shows of them
    made_s: float = 0.0  # Time at which the picture was ready, s since 1970
    record_ms: float = 0.0  # Duration of the recording
    measure_ms: float = 0.0  # Duration of the measurement


@dataclass(frozen=True)
class _Recorded:
    part: LiveSlice
    setting: LiveSetting
    record_ms: float
    shows_signal: bool


class LiveLoop:
    """Records and measures slices until it is closed; ``on_picture`` is called from any thread."""

    def __init__(
        self,
        camera: Camera,
        setting: Callable[[], LiveSetting],
        reading_deg: Callable[[], Mapping[str, float]],
        on_picture: Callable[[], None],
        meter: Meter,
        moving: Callable[[], bool] = lambda: False,
    ) -> None:
        self._camera = camera
        self._setting = setting
        self._reading_deg = reading_deg
        self._on_picture = on_picture
        self._moving = moving
        self._folder = make_slice_folder()
        self._meter = meter
        self._wake = threading.Condition()
        self._waiting: _Recorded | None = None
        self._tasks: deque[tuple[Callable[[], Any], Future[Any]]] = deque()
        self._began_s: float | None = None
        self._record_s, self._measure_s = 0.0, 0.0
        self._closing = False
        self._forget_asked = False
        self._signal_s = -math.inf
        self._signal = LiveFigures()
        self._light: tuple[bool | None, float | None] = (None, None)
        self._lit: tuple[bool | None, float | None] = (None, None)
        self._times_s: deque[float] = deque(maxlen=200)
        self._star_times_s: deque[tuple[float, float]] = deque(maxlen=200)
        self._curve = FocusCurve()
        self._verdicts = SteadyVerdicts()
        self.latest = LivePicture()
        """The newest picture."""
        self.failure: Failure | None = None
        """Why there is no new picture; None while pictures come."""
        self._threads = [
            threading.Thread(target=target, name=name, daemon=True)
            for target, name in ((self._record, "align-record"), (self._measure, "align-measure"))
        ]

    def start(self) -> None:
        """Begin to record."""
        for thread in self._threads:
            thread.start()

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
        """Forget the curve of the focus and the stars, before the next slice is measured."""
        self._forget_asked = True

    def focus_curve(self) -> list[tuple[float, float]]:
        """Return the curve of the focus: time of each slice in which it was measured, s, and edge width, px."""
        return self._curve.points()

    def images_per_s(self) -> float:
        """Return how many pictures came in a second, over the last seconds."""
        return rate_per_s(self._times_s)

    def stars_per_s(self) -> float:
        """Return how often stars were searched in a second, over the last seconds."""
        return rate_per_s([at for at, _ in self._star_times_s])

    def close(self) -> bool:
        """End the recording, and remove the temporary folder; True if the camera records no more."""
        with self._wake:
            self._closing = True
            self._wake.notify_all()
        self._camera.stop()
        self._meter.close()
        for thread in self._threads:
            if thread.is_alive():
                thread.join(timeout=6.0)
        for _, future in self._tasks:
            future.cancel()
        shutil.rmtree(self._folder, ignore_errors=True)
        return not self._threads[0].is_alive()

    # ------------------------------------------------------------------ recording

    def _record(self) -> None:
        number, last_s = 0, -math.inf
        while not self._closing:
            self._do_tasks()
            if not self._wait_until_due(last_s):
                continue
            number, last_s = number + 1, time.monotonic()
            try:
                made = self._record_one(number)
            except Aborted:
                return
            except DriverError as error:
                self._fail(Failure.of(error))
                with self._wake:
                    self._wake.wait_for(lambda: self._closing or self._tasks, _AFTER_FAULT_S)
                continue
            if made is None:
                continue
            self._record_s = learnt_s(self._record_s, made.record_ms / 1e3)
            with self._wake:
                old, self._waiting = self._waiting, made
                self._wake.notify_all()
            if old is not None:
                old.part.path.unlink(missing_ok=True)

    def _wait_until_due(self, last_s: float) -> bool:
        """Wait until a slice would be recorded just in time to be measured; False if there is a task."""
        with self._wake:
            while not (self._closing or self._tasks):
                now_s = time.monotonic()
                due_s = last_s + SHORTEST_S
                if self._waiting is not None:
                    due_s = max(due_s, self._waiting.part.time_s + _STALE_S)
                elif self._began_s is not None:
                    due_s = max(due_s, self._began_s + self._measure_s - self._record_s - _EARLY_S)
                if now_s >= due_s:
                    return True
                self._wake.wait(due_s - now_s)
        return False

    def _record_one(self, number: int) -> _Recorded | None:
        """Record a slice; None if it was ended early."""
        setting = self._setting()
        started_s = time.monotonic()
        wanted: float = slice_periods(setting)
        shows_signal = wanted >= SIGNAL_PERIODS or wanted == 0
        light, moving = (setting.light_on, setting.frequency_hz), self._moving()
        if moving and not shows_signal:
            wanted = MOVING_PERIODS
        elif not shows_signal and (light != self._light or started_s - self._signal_s >= SIGNAL_EVERY_S):
            wanted, shows_signal = SIGNAL_PERIODS, True
        self._light = light
        if shows_signal:
            self._signal_s = started_s
        facts: Recorded
        if setting.camera == "frame":
            path = self._folder / f"slice-{number}.tif"
            facts = frame_camera(self._camera).capture(path, 1)
        else:
            path = self._folder / f"slice-{number}.raw"
            try:
                camera = event_camera(self._camera)
                take = camera.preview if isinstance(camera, PreviewCamera) else camera.record
                facts = take(path, slice_duration_s(setting, wanted))
            except DriverError:
                path.unlink(missing_ok=True)
                raise
        if not facts.complete and self._tasks:
            path.unlink(missing_ok=True)
            return None
        moving = moving or self._moving()
        took_ms = (time.monotonic() - started_s) * 1e3
        part = LiveSlice(path, started_s, facts, dict(self._reading_deg()), moving)
        return _Recorded(part, setting, took_ms, shows_signal)

    def _do_tasks(self) -> None:
        while self._tasks:
            with self._wake:
                task, future = self._tasks.popleft()
            if not future.set_running_or_notify_cancel():
                continue
            settle(future, task)

    # ------------------------------------------------------------------ measuring

    def _measure(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._closing or self._waiting is not None)
                if self._closing:
                    return
                recorded, self._waiting = self._waiting, None
                self._began_s = began_s = time.monotonic()
                self._wake.notify_all()
            assert recorded is not None
            try:
                self._publish(recorded)
            except Exception as error:  # noqa: BLE001 - one bad slice must not end the live picture
                self._fail(Failure.of(error))
            finally:
                recorded.part.path.unlink(missing_ok=True)
                with self._wake:
                    self._measure_s = learnt_s(self._measure_s, time.monotonic() - began_s)
                    self._began_s = None
                    self._wake.notify_all()

    def _publish(self, recorded: _Recorded) -> None:
        started_s = time.monotonic()
        if self._forget_asked:
            self._forget_asked = False
            self._meter.forget()
            self._curve.forget()
        jpeg, figures = self._meter.measure(recorded.part, recorded.setting)
        if recorded.shows_signal:
            self._signal = figures
        else:
            figures = with_signal_of(figures, self._signal)
        self._follow_focus(figures, recorded.setting)
        now_s = time.monotonic()
        self.latest = LivePicture(
            self.latest.number + 1,
            jpeg,
            figures,
            self._verdicts.steady(figure_rows(figures, recorded.setting, self._curve.best_px)),
            time.time(),
            recorded.record_ms,
            (now_s - started_s) * 1e3,
        )
        self._times_s.append(now_s)
        searched_s = figures.stars_time_s
        if searched_s is not None and (not self._star_times_s or self._star_times_s[-1][1] != searched_s):
            self._star_times_s.append((now_s, searched_s))
        self.failure = None
        self._on_picture()

    def _follow_focus(self, figures: LiveFigures, setting: LiveSetting) -> None:
        """Add the edge width of a picture to the curve; light and pose begin the best anew."""
        lit = setting.light_on, setting.level_percent
        if figures.moving or lit != self._lit:
            self._lit = lit
            self._curve.begin_best()
        if figures.stars_time_s is not None and figures.focus.edge_width_px is not None:
            self._curve.add(figures.stars_time_s, figures.focus.edge_width_px)

    def _fail(self, failure: Failure) -> None:
        if self._closing:
            return
        self.failure = failure
        self._on_picture()
