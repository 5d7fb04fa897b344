"""One session of aligning: the open devices, the live picture, and the page that holds the controls.

Nothing moves and no light goes on unless a method was called that asks for it. `Session.stop` reaches the stage's
controllers from any thread. A stage that moves is stopped when the page with the controls is lost.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from bench.base.errors import ControlRefused
from bench.base.failure import FORESEEN, Failure
from bench.extras.pages.align.figure_rows import FigureRow
from bench.extras.pages.align.holder import Holder
from bench.extras.pages.align.live_figures import LiveSetting
from bench.extras.pages.align.live_loop import LivePicture
from bench.extras.pages.align.meter import Meter, MeterProcess
from bench.extras.pages.align.open_bench import Bench, OpenDevices, close_bench, open_bench, open_devices
from bench.extras.pages.align.station_lines import station_lines
from bench.extras.pages.web.server_sent import Changes
from bench.record.device_end import DeviceEnd
from bench.stations.station import Station
from drivers.errors import DriverError
from sequences.reader import Located

_WATCH_S = 0.05  # Below what a person notices as a delay
_LOOK_MOVING_S = 0.15  # Often enough to follow a move by eye
_LOOK_RESTING_S = 1.0  # Nothing changes by itself; somebody may turn the stage by hand
_LOOK_THOROUGHLY_S = 4.0  # Faults and limits take more queries
OLD_S = 10.0  # Age of a picture that shows nothing any more: the longest slice, measured on a busy computer
_LOOK_LIGHT_S = 2.0  # A generator's front panel may be touched; each query takes its line


class Session:
    """One session of aligning; ``changes`` is told after each change of `state`, and after each new picture."""

    def __init__(
        self,
        station: Located[Station],
        *,
        opener: OpenDevices = open_devices,
        make_meter: Callable[[], Meter] = MeterProcess,
    ) -> None:
        self.station = station
        self._opener = opener
        self._make_meter = make_meter
        self.changes = Changes()
        self.holder = Holder()
        self._lock = threading.Lock()
        self._bench: Bench | None = None
        self._opening = False
        self._failure: Failure | None = None
        self._ended = threading.Event()
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
                self.station.value, self._opener, self._make_meter, self._setting, self.changes.tell
            )
            bench.loop.start()
        except FORESEEN as error:
            self._failure = Failure.of(error)
        finally:
            self._opening = False
            self.changes.tell()
        if self._bench is not None:
            self._watch()
        return self._failure

    def reopen(self) -> Failure | None:
        """Close the devices safely, and open all of them again."""
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
        failed = self._failure.to_dict() if self._failure else None
        condition = "open" if bench else "opening" if self._opening else "failed" if failed else "closed"
        shown: dict[str, Any] = {
            "station": {"name": station.name, "file": self.station.file, "simulated": station.is_simulated},
            "devices": {"state": condition, "failure": failed},
            "holder": self.holder.page,
        }
        if bench is not None:
            failure = bench.loop.failure
            rows = self._rows(bench)
            shown |= {
                "stage": bench.stage.as_data(),
                "light": bench.light.as_data(),
                "camera": {**bench.camera.as_data(), "failure": failure.to_dict() if failure else None},
                "hands": {"seen": bench.hands.seen} if bench.hands.available else None,
                "rows": {row.name: row._asdict() for row in rows},
                "not_ready": [row.name for row in (*rows, *bench.loop.latest.rows) if row.good is False],
                "station_lines": station_lines(
                    station,
                    position_deg={} if bench.stage.moving else bench.stage.known_deg(),
                    camera=bench.camera.changed,
                    level_percent=bench.light.reading.flicker.level_percent,
                ),
            }
        return shown

    def _rows(self, bench: Bench) -> list[FigureRow]:
        """Return what the devices do, each judged; without a new picture, the camera is not ready."""
        camera, latest = bench.camera.row(), bench.loop.latest
        if bench.loop.failure is not None or time.monotonic() - latest.figures.time_s > OLD_S:
            camera = camera._replace(value="no new picture", good=False)
        return [bench.stage.row(), bench.light.row(), camera]

    # ------------------------------------------------------------------ what a person asks for

    def stop(self) -> None:
        """Stop the stage now. For any thread, at any time."""
        if self._bench is not None:
            self._bench.stage.stop()

    def stop_motion(self) -> None:
        """Stop the stage if it moves: nobody looks after it any more."""
        bench = self._bench
        if bench is not None and bench.stage.moving:
            with suppress(DriverError):  # the stage's state says it
                bench.stage.stop()

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
        )

    def _watch(self) -> None:
        """Start the threads that watch, unless they run."""
        if not self._watchers:
            for target in (self._guard_motion, self._read_devices):
                thread = threading.Thread(target=target, name="align-watch", daemon=True)
                self._watchers.append(thread)
                thread.start()

    def _guard_motion(self) -> None:
        """Stop the stage if the page with the controls is lost."""
        while not self._ended.wait(_WATCH_S):
            if self.holder.is_lost:
                self.stop_motion()

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
                self.changes.tell()  # what is shown grows old by itself too
            if now_s - last_s["light"] > _LOOK_LIGHT_S and not bench.stage.moving:
                last_s["light"] = now_s
                bench.light.look()
                self.changes.tell()
