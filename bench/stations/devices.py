"""Opens the devices that a station file names, makes them safe together, and closes them.

A port such as ``sim:gimbal`` starts the simulated bench first; apart from that all devices are treated alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

from bench.base.clock import BenchClock
from bench.base.errors import SimulationError
from bench.record.device_end import DeviceEnd, DeviceName, lost_ends, unsafe_devices
from bench.simulated import SimulatedBench
from bench.stations.device_locks import hold_devices, serial_devices
from bench.stations.station import Station
from bench.stations.station_fields import SIMULATED_PREFIX
from drivers.camera import EventCamera
from drivers.camera.frames import FrameCamera
from drivers.errors import DriverError
from drivers.light import Light
from drivers.stage import Stage
from drivers.wire_log import WireLog

Camera = EventCamera | FrameCamera

LEFT_DEVICES = "left_devices"
"""Attribute of the error of an opening that failed: how it left the devices that were open before."""


class Devices:
    """A stage, a light and a camera, open; if one cannot be opened, all are closed. Opening moves nothing."""

    stage: Stage
    light: Light
    camera: Camera

    def __init__(self, station: Station, *, seed: int, clock: BenchClock, wire_log: WireLog | None) -> None:
        self._clock = clock
        self._station = station
        self.simulation: SimulatedBench | None = None
        """The simulated bench; None on a real one. Only a person's hands use it: no run and no estimate may."""
        with ExitStack() as opened, self._left_safe():
            if station.needs_simulated_bench:
                self.simulation = opened.enter_context(SimulatedBench(station.simulated_world, seed))
            opened.enter_context(hold_devices(serial_devices(station)))
            self.stage = station.stage.open_device(self._port, clock=clock, wire_log=wire_log)
            opened.callback(self.stage.close)
            self.light = station.light.open_device(self._port, clock=clock, wire_log=wire_log)
            opened.callback(self.light.close)
            self.camera = station.camera.open_device(self._port, clock=clock)
            opened.callback(self.camera.close)
            self._opened = opened.pop_all()

    def truth(self) -> dict[str, Any] | None:
        """Read what is true of views of the simulated bench, for the final comparison only; None for other views."""
        if self.simulation is None or not self._station.sees_simulated_bench:
            return None
        return self.simulation.truth()

    def make_safe(self) -> list[str]:
        """Stop stage, light and camera, each even if another one fails; a sentence for each not confirmed."""
        return unsafe_devices(self.make_each_safe())

    def make_each_safe(self) -> list[DeviceEnd]:
        """Stop stage, light and camera, each even if another one fails; what each one answered, if it was open."""
        if self.simulation is not None and not self.simulation.alive:
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
            except Exception as error:  # noqa: BLE001 - whatever a driver does, the next device is made safe
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
        assert self.simulation is not None
        endpoint = self.simulation.endpoints.get(name.removeprefix(SIMULATED_PREFIX))
        if endpoint is None:
            known = ", ".join(SIMULATED_PREFIX + e for e in self.simulation.endpoints)
            raise SimulationError(f"The simulated bench has no {name}.", remedy=f"It has {known}.")
        return endpoint


def simulated_truth(station: Station, seed: int) -> dict[str, Any] | None:
    """Start a station's simulated bench to read what `Devices.truth` tells."""
    if not station.sees_simulated_bench:
        return None
    with SimulatedBench(station.simulated_world, seed) as bench:
        return bench.truth()


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
