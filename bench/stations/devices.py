"""Opens the devices that a station file names, makes them safe together, and closes them.

A port such as ``sim:gimbal`` starts the simulated bench first; apart from that all devices are treated alike.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from types import MappingProxyType
from typing import Any, Final, Literal, cast

from bench.base.clock import Aborted, BenchClock
from bench.base.errors import SimulationError
from bench.record.history import NOT_ASKED, DeviceEnd, DeviceName, lost_ends, unsafe_devices
from bench.simulated import SimulatedBench
from bench.stations import station as station_file
from bench.stations.sections import EventCameraSection, FrameCameraSection, PortName
from bench.stations.station import Station
from bench.stations.station_fields import SIMULATED_PREFIX
from drivers.camera import EventCamera
from drivers.camera.frame_cameras import FolderFrameCamera, OpenCvFrameCamera
from drivers.camera.frames import FrameCamera
from drivers.camera.metavision import MetavisionEvk4
from drivers.camera.neuromorphic_evk4 import NeuromorphicEvk4
from drivers.camera.recorded import RecordedCamera
from drivers.camera.simulated_evk4 import SimulatedEvk4Camera
from drivers.errors import DriverError, StillOpening
from drivers.file_lock import DeviceHold
from drivers.light import Light
from drivers.stage import AxisLimits, Stage
from drivers.wire_log import WireLog

# Locks on the devices of a station by family and serial number, in addition to the locks on their ports.
#
# The same controller may be reachable through a second port (a network, a second cable, another name of the
# same port). The lock on a port does not cover that.


def serial_devices(station: Station) -> tuple[str, ...]:
    """Name, as ``Zaber 100101``, stage and light whose serial numbers the station file has, not simulated ones."""
    return tuple(dict.fromkeys((*station.stage.device_names, *station.light.device_names)))


@contextmanager
def hold_devices(devices: Iterable[str]) -> Iterator[None]:
    """Lock devices from `serial_devices` on this computer during the block; `PortBusy` if one is in use."""
    with ExitStack() as holds:
        for device in devices:
            holds.callback(DeviceHold(device).release)
        yield


Camera = EventCamera | FrameCamera

LEFT_DEVICES = "left_devices"
"""Attribute of the error of an opening that failed: how it left the devices that were open before."""


class Devices:
    """A stage, a light and a camera, open; if one cannot be opened, all are closed. Opening moves nothing."""

    # Devices that may still be opening, by name; empty here (see `bench.stations.devices`).
    late: Mapping[str, Any] = MappingProxyType({})
    stage: Stage
    light: Light
    camera: Camera

    def __init__(self, station: Station, *, seed: int, clock: BenchClock, wire_log: WireLog | None) -> None:
        self._clock = clock
        self._simulation: SimulatedBench | None = None
        with ExitStack() as opened, self._left_safe():
            if station.needs_simulated_bench:
                self._simulation = opened.enter_context(SimulatedBench(station.simulated_world, seed))
            opened.enter_context(hold_devices(serial_devices(station)))
            self.stage = open_stage(station, self._port, clock, wire_log)
            opened.callback(self.stage.close)
            self.light = open_light(station, self._port, clock, wire_log)
            opened.callback(self.light.close)
            self.camera = open_camera(station, self._port, clock)
            opened.callback(self.camera.close)
            self._opened = opened.pop_all()

    def truth(self) -> dict[str, Any] | None:
        """Read the true parameters of the simulated bench, for the final comparison only; None on a real bench."""
        return self._simulation.truth() if self._simulation is not None else None

    @property
    def simulation(self) -> SimulatedBench | None:
        """The simulated bench; None on a real one. Only a person's hands use it: no run and no estimate may."""
        return self._simulation

    def make_safe(self) -> list[str]:
        """Stop stage, light and camera, each even if another one fails; a sentence for each not confirmed."""
        return unsafe_devices(self.make_each_safe())

    def make_each_safe(self) -> list[DeviceEnd]:
        """Stop stage, light and camera, each even if another one fails; what each one answered, if it was open."""
        if self._simulation is not None and not self._simulation.alive:
            return lost_ends(
                "the simulated bench has ended unexpectedly; no simulated device is left to make safe"
            )
        actions: Mapping[DeviceName, tuple[str, Callable[[Any], str]]] = {
            "stage": ("the stage did not confirm its stop", stop_stage),
            "light": ("the light did not confirm that it is off", switch_off),
            "camera": ("the camera does not answer", _without_recording),
        }
        ends = []
        for name, (fault, action) in actions.items():
            device = getattr(self, name, None)
            if device is None:
                continue
            try:
                ends.append(DeviceEnd(name, "confirmed safe", action(device)))
            except DriverError as error:
                ends.append(DeviceEnd(name, "not confirmed", f"{fault}: {error}"))
        return ends

    @contextmanager
    def _left_safe(self) -> Iterator[None]:
        """Make the devices safe that are open already, if a further one cannot be opened; the error tells of them."""
        try:
            yield
        except BaseException as error:
            with self._clock.shielded():
                setattr(error, LEFT_DEVICES, self.make_each_safe())
            raise

    def close(self) -> None:
        """Close all devices. Nothing moves."""
        self._opened.close()

    def _port(self, name: str) -> str:
        """Return the system's name of a port; a port of the simulated bench is looked up there."""
        if not name.startswith(SIMULATED_PREFIX):
            return name
        assert self._simulation is not None
        endpoint = self._simulation.endpoints.get(name.removeprefix(SIMULATED_PREFIX))
        if endpoint is None:
            known = ", ".join(SIMULATED_PREFIX + e for e in self._simulation.endpoints)
            raise SimulationError(f"The simulated bench has no {name}.", remedy=f"It has {known}.")
        return endpoint


def left_devices(error: BaseException) -> list[DeviceEnd]:
    """Return how an opening that failed left the devices that were open before."""
    return list(getattr(error, LEFT_DEVICES, ()))


def stop_stage(stage: Stage) -> str:
    """Stop a stage, which must confirm."""
    stage.stop()
    try:
        angles = ", ".join(f"{axis} {angle:.3f}" for axis, angle in stage.position_deg().items())
    except DriverError:
        return "it confirmed the stop; its position could not be read afterwards"
    return f"it confirmed the stop and reads {angles} deg"


def switch_off(light: Light) -> str:
    """Switch a light off, which must confirm."""
    light.off()
    return "it was read back as off"


def _without_recording(camera: Camera) -> str:
    """Stop the camera and ask who it is: to stop it sends nothing, so it would not show that the camera is there."""
    camera.stop()
    who = camera.identify()
    serial = f" as serial number {who.serial}" if who.serial else ""
    return f"it answers{serial}, and no recording is in progress"


def open_stage(station: Station, port: PortName, clock: BenchClock, wire_log: WireLog | None) -> Stage:
    """Open the stage of a station. Nothing moves, and nothing is switched on."""
    return station.stage.open_device(port, clock=clock, wire_log=wire_log)


def open_light(station: Station, port: PortName, clock: BenchClock, wire_log: WireLog | None) -> Light:
    """Open the light of a station. Nothing moves, and nothing is switched on."""
    return station.light.open_device(port, clock=clock, wire_log=wire_log)


def open_camera(station: Station, port: PortName, clock: BenchClock) -> Camera:  # noqa: PLR0911 - one for each driver
    """Open the camera of a station. Nothing moves, and nothing is switched on."""
    match station.camera:
        case station_file.SimulatedEvk4Config() as config:
            return SimulatedEvk4Camera.open(
                port(config.address), serial=config.serial, clock=clock, utc_now=clock.utc_now
            )
        case station_file.MetavisionConfig() as config:
            return MetavisionEvk4.open(serial=config.serial, clock=clock)
        case station_file.NeuromorphicEvk4Config() as config:
            return NeuromorphicEvk4.open(serial=config.serial, clock=clock, utc_now=clock.utc_now)
        case station_file.RecordedCameraConfig() as config:
            return RecordedCamera.open(config.path, serial=config.serial, clock=clock)
        case station_file.OpenCvCameraConfig() as config:
            source = port(config.source_in_use())
            hidden = f"${config.source_env}" if config.source_env else ""
            return OpenCvFrameCamera.open(source, serial=config.serial, clock=clock, shown_as=hidden)
        case station_file.PictureFolderConfig() as config:
            return FolderFrameCamera.open(config.path, serial=config.serial, clock=clock)
        case EventCameraSection() | FrameCameraSection() as config:
            return config.open_device(port, clock=clock)


# Devices that a dead process has left: they are opened anew, stopped and switched off, and asked how they
# stand.
#
# Nothing else is moved or switched. Devices of a simulated bench have ended with the process.


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


_CLOSE_S: Final = 15.0
"""Longest wait for a device that is still being opened, s."""


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

    def __init__(self, station: Station, *, seed: int, clock: BenchClock, wire_log: WireLog | None) -> None:
        self._clock = clock
        self._simulation: SimulatedBench | None = None

        def late_device(name: str, devices: tuple[str, ...], open_device: Callable[..., Any]) -> LateDevice:
            def opener(stack: ExitStack) -> Any:
                stack.enter_context(hold_devices(devices))
                device = open_device(station, self._port, clock, wire_log)
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
