"""Devices that a dead process has left: they are opened anew, made safe, and asked how they stand.

Nothing else is moved or switched. Devices of a simulated bench have ended with the process.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from typing import Any, Final, Literal, cast

from bench.base.clock import Aborted, BenchClock
from bench.record.device_end import NOT_ASKED, DeviceEnd, DeviceName
from bench.simulated import SimulatedBench
from bench.stations.device_locks import hold_devices
from bench.stations.devices import Devices, open_camera, open_light, open_stage, stop_stage, switch_off
from bench.stations.station import Station
from bench.stations.station_fields import SIMULATED_PREFIX
from drivers.errors import DriverError, StillOpening
from drivers.light import Light
from drivers.stage import AxisLimits, Stage

_CLOSE_S: Final = 15.0
"""Longest wait for a device that is still being opened, s."""


def make_orphans_safe(station: Station, clock: BenchClock) -> list[DeviceEnd]:
    """Stop stage and light whose process died, each opened anew; return what they answered. Not simulated ones."""
    ends = []
    asked: tuple[tuple[DeviceName, tuple[str, ...], Callable[..., Any], Callable[[Any], str]], ...] = (
        ("stage", station.stage.ports, open_stage, stop_stage),
        ("light", station.light.ports, open_light, switch_off),
    )
    for name, ports, open_device, make_safe in asked:
        if any(port.startswith(SIMULATED_PREFIX) for port in ports):
            continue
        try:
            with closing(open_device(station, str, clock, None)) as device:
                ends.append(DeviceEnd(name, "confirmed safe", make_safe(device)))
        except DriverError as error:
            fault = f"the {name} of a dead process could not be made safe: {error}"
            ends.append(DeviceEnd(name, "not confirmed", fault))
    return [*ends, DeviceEnd("camera", "not confirmed", NOT_ASKED)] if ends else []


class LateDevice:
    """A ``stage`` or ``light`` that is opened on its own thread; the opener leaves on the stack how it is closed."""

    def __init__(self, name: str, opener: Callable[[ExitStack], Any]) -> None:
        self.name = name
        self._opener = opener
        self._lock = threading.Lock()
        self._device: Any = None
        self._error: DriverError | None = None
        self._stack = ExitStack()
        self._thread: threading.Thread | None = None
        self._closed = False
        self._on_end: Callable[[], None] = lambda: None

    @property
    def state(self) -> Literal["opening", "open", "failed"]:
        """Whether it is open."""
        return "open" if self._device is not None else "failed" if self._error is not None else "opening"

    def listen(self, on_end: Callable[[], None]) -> None:
        """Have a function called after each attempt to open it, by its thread; at once if one has ended already."""
        with self._lock:
            self._on_end = on_end
            ended = self.state != "opening"
        if ended:
            on_end()

    def start(self) -> None:
        """Begin to open it, unless it is open or being opened."""
        with self._lock:
            if self._closed or (self._thread is not None and self.state != "failed"):
                return
            self._error = None
            self._thread = threading.Thread(target=self._open, name=f"open-{self.name}", daemon=True)
            self._thread.start()

    def get(self) -> Any:
        """Return the open device. Raises StillOpening, or the DriverError why it could not be opened."""
        device, error = self._device, self._error
        if device is not None:
            return device
        if error is not None:
            raise error
        raise StillOpening(
            f"The {self.name} is still being opened.", where=self.name, remedy="Wait some seconds."
        )

    def close(self) -> None:
        """Close it; wait for an attempt to open it."""
        with self._lock:
            self._closed = True
            thread = self._thread
        if thread is not None:
            thread.join(timeout=_CLOSE_S)
        self._device = None
        self._error = self._error or DriverError("It is closed.", where=self.name)
        self._stack.close()

    def _open(self) -> None:
        with ExitStack() as opened:
            try:
                device = self._opener(opened)
            except DriverError as error:
                self._error = error
            except Aborted as error:
                self._error = DriverError(f"Opening was ended: {error}", where=self.name)
            else:
                self._stack = opened.pop_all()
                self._device = device
        with self._lock:
            on_end = self._on_end
        on_end()


class SeparateDevices(Devices):
    """A camera that is open, and a stage and a light that open meanwhile."""

    def __init__(self, station: Station, seed: int, clock: BenchClock) -> None:
        self._clock = clock
        self._station = station
        self._simulation: SimulatedBench | None = None

        def late_device(name: str, devices: tuple[str, ...], open_device: Callable[..., Any]) -> LateDevice:
            def opener(stack: ExitStack) -> Any:
                stack.enter_context(hold_devices(devices))
                device = open_device(station, self._port, clock, None)
                stack.callback(device.close)
                return device

            return LateDevice(name, opener)

        late = {
            "stage": late_device("stage", station.stage.device_names, open_stage),
            "light": late_device("light", station.light.device_names, open_light),
        }
        with ExitStack() as opened:
            if station.needs_simulated_bench:
                self._simulation = opened.enter_context(SimulatedBench(station.simulated_world, seed))
            self.camera = open_camera(station, self._port, clock)
            opened.callback(self.camera.close)
            for device in late.values():
                opened.callback(device.close)
                device.start()
            self._opened = opened.pop_all()
        self.late = late
        self.stage = cast("Stage", _LateStage(late["stage"], station))
        self.light = cast("Light", _Late(late["light"]))


class _Late:
    """Passes every call to a late device."""

    def __init__(self, late: LateDevice) -> None:
        self._late = late

    def __getattr__(self, name: str) -> Any:
        return getattr(self._late.get(), name)


class _LateStage(_Late):
    """A late stage, whose axes and limits are known from the station file before it is open."""

    def __init__(self, late: LateDevice, station: Station) -> None:
        super().__init__(late)
        self._station = station

    @property
    def axes(self) -> Sequence[str]:
        return tuple(self._station.axes)

    @property
    def limits(self) -> Mapping[str, AxisLimits]:
        return {name: axis.limits for name, axis in self._station.axes.items()}
