"""One session of aligning: the open devices, the live picture, the controls, and the list of what happened, for a page.

Nothing moves and no light goes on unless a method was called that asks for it. `Session.stop` reaches the stage's
controllers from any thread. A stage set in motion by a page is stopped when that page is lost.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

from bench.base.errors import ControlRefused
from bench.base.failure import FORESEEN, Failure
from bench.extras.pages.align.live_figures import LiveSetting
from bench.extras.pages.align.live_loop import LivePicture
from bench.extras.pages.align.meter import Meter, MeterProcess
from bench.extras.pages.align.open_bench import (
    Bench,
    OpenDevices,
    close_bench,
    follow,
    open_bench,
    try_again,
)
from bench.extras.pages.align.owners import Owners
from bench.extras.pages.web.server_sent import Changes
from bench.record.device_end import DeviceEnd
from bench.stations.orphans import SeparateDevices
from bench.stations.station import Station
from drivers.errors import DriverError
from sequences.reader import Located

KEPT: Final = 50  # Entries of a session; older ones are dropped
SHOWN: Final = 20  # Of these on the page, the newest
_SAME_S: Final = 10.0
"""Time within which a further step replaces the entry of the one before, s."""
_WATCH_S = 0.05  # Below what a person notices as a delay
_LOOK_MOVING_S = 0.15  # Often enough to follow a move by eye
_LOOK_RESTING_S = 1.0  # Nothing changes by itself; somebody may turn the stage by hand
_LOOK_THOROUGHLY_S = 4.0  # Faults and limits take more queries
_LOOK_LIGHT_S = 2.0  # A generator's front panel may be touched; each query takes its line


class Happened:
    """The list of what happened; ``clock`` returns the time, s since 1970."""

    def __init__(self, on_change: Callable[[], None], clock: Callable[[], float] = time.time) -> None:
        self._on_change = on_change
        self._clock = clock
        self._lock = threading.Lock()
        self._entries: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._topic = ""
        self._count = 0

    def say(self, text: str, topic: str = "") -> None:
        """Add a sentence on a topic, in place of a recent one on the same; an empty topic is always a new entry."""
        now_s = self._clock()
        topic = topic or text
        with self._lock:
            last = self._entries[-1] if self._entries else None
            if last is not None and topic and topic == self._topic and now_s - last["time_s"] < _SAME_S:
                self._entries.pop()
            self._topic = topic
            self._count += 1
            self._entries.append({"number": self._count, "time_s": now_s, "text": text})
        self._on_change()

    def as_data(self) -> list[dict[str, Any]]:
        """Return the newest entries: number, time (s since 1970) and text of each, the newest last."""
        with self._lock:
            return list(self._entries)[-SHOWN:]


class Session:
    """One session of aligning; ``changes`` is told after each change of `state`, and after each new picture."""

    def __init__(
        self,
        station: Located[Station],
        *,
        seed: int = 1,
        opener: OpenDevices = SeparateDevices,
        make_meter: Callable[[], Meter] = MeterProcess,
    ) -> None:
        self.station = station
        self._seed = seed
        self._opener = opener
        self._make_meter = make_meter
        self.changes = Changes()
        self.owners = Owners(self.changes.tell)
        self._lock = threading.Lock()
        self._bench: Bench | None = None
        self._opening = False
        self._failure: Failure | None = None
        self._ended = threading.Event()
        self._happened = Happened(self.changes.tell)
        self._watchers: list[threading.Thread] = []

    # ------------------------------------------------------------------ opening and closing

    @property
    def is_open(self) -> bool:
        """Whether the devices are open."""
        return self._bench is not None

    @property
    def bench(self) -> Bench:
        """The open devices. Raises ControlRefused while they are not open."""
        if self._bench is None:
            failure = self._failure
            raise ControlRefused(
                failure.what if failure else "The devices are not open yet.",
                where=failure.where if failure else "",
                remedy="Press Try again." if failure else "Wait until they are open.",
            )
        return self._bench

    def open(self) -> Failure | None:
        """Open the devices, and begin to record; nothing moves. Returns why they cannot be opened."""
        with self._lock:
            if self._bench is not None or self._opening or self._ended.is_set():
                return self._failure
            self._opening, self._failure = True, None
        self.changes.tell()
        try:
            self._bench = bench = open_bench(
                self.station.value,
                self._seed,
                self._opener,
                self._make_meter,
                self._setting,
                self.changes.tell,
                self.say,
            )
            bench.loop.start()
        except FORESEEN as error:
            self._failure = Failure.of(error)
            self.say(f"The devices could not be opened. {self._failure.message}")
        finally:
            self._opening = False
            self.changes.tell()
        if self._bench is not None:
            follow(self._bench, self.say)
            self._watch()
        return self._failure

    def reopen(self) -> Failure | None:
        """Open again what is not open; if that is not all, close the devices safely and open all of them again."""
        bench = self._bench
        if bench is not None and bench.loop.failure is None and try_again(bench):
            self.changes.tell()
            return None
        self._close_bench()
        return self.open()

    def close(self) -> list[DeviceEnd]:
        """Leave the bench safe, once; return what stage, light and camera confirmed, each if it was open."""
        if self._ended.is_set():
            return []
        self._ended.set()
        confirmed = self._close_bench()
        for watcher in self._watchers:
            watcher.join(timeout=5.0)
        self.changes.tell()
        return confirmed

    def _close_bench(self) -> list[DeviceEnd]:
        with self._lock:
            bench, self._bench = self._bench, None
        return close_bench(bench) if bench is not None else []

    # ------------------------------------------------------------------ what it shows

    def picture(self) -> LivePicture:
        """Return the newest picture with its JPEG and times; number 0 if there is none."""
        bench = self._bench
        return bench.loop.latest if bench is not None else LivePicture()

    def state(self) -> dict[str, Any]:
        """Return everything besides the picture, as plain values for JSON."""
        bench, station = self._bench, self.station.value
        condition = (
            "open" if bench else "opening" if self._opening else "failed" if self._failure else "closed"
        )
        shown: dict[str, Any] = {
            "station": {
                "name": station.name,
                "file": self.station.file,
                "simulated": station.is_simulated,
                "laboratory": station.laboratory,
            },
            "devices": {
                "state": condition,
                "failure": self._failure.to_dict() if self._failure else None,
            },
            "controls": self.owners.as_data(),
            "messages": self._happened.as_data(),
            "stage": None,
            "light": None,
            "camera": None,
            "hands": None,
        }
        if bench is not None:
            failure = bench.loop.failure
            shown |= {
                "stage": bench.stage.as_data(),
                "light": bench.light.as_data(),
                "camera": {
                    **bench.camera.as_data(),
                    "failure": failure.to_dict() if failure else None,
                },
                "hands": {"seen": bench.hands.seen} if bench.hands.available else None,
            }
        return shown

    def say(self, text: str, topic: str = "") -> None:
        """Show a sentence on the pages. See `Happened.say`."""
        self._happened.say(text, topic)

    # ------------------------------------------------------------------ what a person asks for

    def stop(self, why: str = "on request") -> None:
        """Stop the stage now, because of ``why``. For any thread, at any time."""
        bench = self._bench
        if bench is None:
            return
        try:
            bench.stage.stop()
        except DriverError as error:
            self.say(f"CHECK THE BENCH: the stage did not confirm its stop. {Failure.of(error).message}")
            raise
        self.say(f"The stage was stopped, {why}.")

    def stop_for_lost(self, page: str) -> None:
        """Stop the stage if a page that was closed or lost has set it in motion."""
        bench = self._bench
        if bench is not None and bench.stage.moving and bench.stage.state.by == page:
            with suppress(DriverError):  # said by `stop`
                self.stop("because the page that moved it is gone")

    def light(self, **changes: Any) -> dict[str, Any]:
        """Change the light by the arguments of `LightControl.set`."""
        control = self.bench.light
        control.set(**changes)
        return control.as_data()

    # ------------------------------------------------------------------ watching

    def _setting(self) -> LiveSetting:
        """Return what is known of the bench for the next slice."""
        bench = self._bench
        reading = bench.light.reading if bench is not None else None
        settings = reading.settings if reading is not None else None
        flickers = settings is not None and settings.waveform != "steady"
        return LiveSetting.of_station(
            self.station.value,
            frequency_hz=settings.frequency_hz if settings is not None and flickers else None,
            light_on=reading.on if reading is not None else None,
            level_percent=reading.flicker.level_percent if reading is not None else None,
            waveform=settings.waveform if settings is not None else "square",
            homed=bench.stage.state.homed if bench is not None else None,
        )

    def _watch(self) -> None:
        """Start the threads that watch, unless they run."""
        if not self._watchers:
            for target in (self._guard_motion, self._read_devices):
                thread = threading.Thread(target=target, name="align-watch", daemon=True)
                self._watchers.append(thread)
                thread.start()

    def _guard_motion(self) -> None:
        """Stop a stage whose page is lost."""
        while not self._ended.wait(_WATCH_S):
            bench = self._bench
            if bench is None or not bench.stage.moving:
                continue
            by = bench.stage.state.by
            if by and self.owners.is_lost(by):
                self.stop_for_lost(by)

    def _read_devices(self) -> None:
        """Read stage and light from time to time. A device that does not answer is shown, and asked again."""
        last_s = dict.fromkeys(("stage", "thorough", "light"), 0.0)
        while not self._ended.wait(_WATCH_S):
            bench = self._bench
            if bench is None:
                continue
            now_s = time.monotonic()
            if now_s - last_s["stage"] > (_LOOK_MOVING_S if bench.stage.moving else _LOOK_RESTING_S):
                thoroughly = now_s - last_s["thorough"] > _LOOK_THOROUGHLY_S
                last_s["stage"] = now_s
                last_s["thorough"] = now_s if thoroughly else last_s["thorough"]
                bench.stage.look_safely(thoroughly=thoroughly)
            if now_s - last_s["light"] > _LOOK_LIGHT_S and not bench.stage.moving:
                last_s["light"] = now_s
                bench.light.look()
