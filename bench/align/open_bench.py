"""Opens a station's devices with their controls for aligning, and leaves them safe at the end.

Opening moves nothing and switches nothing on. Closing stops the stage, switches the light off and closes the camera.
Each of these is done even if another one fails, and says what the device confirmed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bench.align.camera_control import CameraControl
from bench.align.controls import StageControl
from bench.align.light_control import LightControl
from bench.align.live_figures import LiveSetting
from bench.align.live_loop import LiveLoop
from bench.align.meter import Meter
from bench.align.simulated_hands import SimulatedHands
from bench.base.clock import BenchClock
from bench.base.failure import FORESEEN, Failure
from bench.stations.devices import Devices
from bench.stations.separate_devices import SeparateDevices
from bench.stations.station import Station
from bench.views.station_camera_kind import camera_kind

OpenDevices = Callable[[Station, int, BenchClock], Devices]


@dataclass(frozen=True)
class Confirmation:
    """What a device confirmed at the end."""

    device: str  # ``stage``, ``light`` or ``camera``
    safe: bool  # Whether it confirmed
    text: str  # What it confirmed, or why not, as a sentence


@dataclass(frozen=True)
class Bench:
    """The open devices of a session with their controls."""

    devices: Devices
    clock: BenchClock
    stage: StageControl
    light: LightControl
    camera: CameraControl
    loop: LiveLoop
    hands: SimulatedHands  # Hands at the camera of a simulated bench


def open_devices(station: Station, seed: int, clock: BenchClock) -> Devices:
    """Open a station's camera; stage and light open meanwhile. Nothing moves."""
    return SeparateDevices(station, seed=seed, clock=clock, wire_log=None)


def open_bench(
    station: Station,
    seed: int,
    opener: OpenDevices,
    make_meter: Callable[[], Meter],
    setting: Callable[[], LiveSetting],
    on_change: Callable[[], None],
    say: Callable[[str], None],
) -> Bench:
    """Open the devices and make their controls. The loop is not started yet.

    on_change: Called after each change, by any thread.
    Raises DriverError, SimulationError: If a device cannot be opened; the others are then closed.
    """
    clock = BenchClock()
    meter = make_meter()  # first: its process starts while the devices open
    try:
        devices = opener(station, seed, clock)
    except BaseException:
        meter.close()
        raise
    try:
        light = LightControl(devices.light, station.light, camera_kind(station).light_for, on_change)
        light.look()
        camera = CameraControl(devices.camera, station, on_change)
    except BaseException:
        devices.close()
        meter.close()
        raise
    stage = StageControl(devices.stage, on_change, say)
    stage.look_safely(thoroughly=True)
    loop = LiveLoop(devices.camera, setting, stage.known_deg, on_change, meter, lambda: stage.moving)
    camera.use(loop)
    return Bench(devices, clock, stage, light, camera, loop, SimulatedHands(devices.simulation))


def close_bench(bench: Bench) -> list[Confirmation]:
    """Stop the stage, switch the light off, end the recording, and close all devices."""
    confirmed = [
        _confirm("stage", bench.stage.stop, "stopped; every axis stands."),
        _confirm("light", bench.light.off, "off, as it reports itself."),
    ]
    bench.clock.request_stop("align ends")
    lost = bench.loop.failure
    ended = bench.loop.close()
    with bench.clock.shielded():
        bench.stage.close()
        closed = _confirm("camera", bench.devices.close, "closed; it does not record.")
    if not ended:
        closed = Confirmation("camera", safe=False, text="NOT CONFIRMED. Its recording has not ended.")
    elif lost is not None:
        closed = Confirmation("camera", safe=False, text=f"NOT CONFIRMED. {lost.message}")
    return [*confirmed, closed]


def _confirm(device: str, action: Callable[[], None], text: str) -> Confirmation:
    try:
        action()
    except FORESEEN as error:
        return Confirmation(device, safe=False, text=f"NOT CONFIRMED. {Failure.of(error).message}")
    return Confirmation(device, safe=True, text=text)
