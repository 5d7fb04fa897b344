"""A station's devices in the hands of a person who aligns: opened with their controls, and left safe at the end.

Opening moves and switches nothing. Closing stops the stage, switches the light off and closes the camera, each even if
another fails.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

from bench.base.clock import BenchClock
from bench.base.failure import Failure
from bench.extras.pages.align.camera_control import CameraControl
from bench.extras.pages.align.light_control import LightControl
from bench.extras.pages.align.live_figures import LiveSetting
from bench.extras.pages.align.live_loop import LiveLoop
from bench.extras.pages.align.meter import Meter
from bench.extras.pages.align.simulated_hands import SimulatedHands
from bench.extras.pages.align.stage_control import StageControl
from bench.measure.camera_kinds import camera_kind
from bench.record.device_end import DeviceEnd, DeviceName
from bench.stations.devices import Devices
from bench.stations.station import Station

OpenDevices = Callable[[Station, BenchClock], Devices]


def open_devices(station: Station, clock: BenchClock) -> Devices:
    """Open the devices of a station; a simulated bench is the same one each time."""
    return Devices(station, seed=1, clock=clock, wire_log=None)


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


def open_bench(
    station: Station,
    opener: OpenDevices,
    make_meter: Callable[[], Meter],
    setting: Callable[[], LiveSetting],
    on_change: Callable[[], None],
) -> Bench:
    """Open all devices, or none, and make their controls; the loop is not started yet."""
    clock = BenchClock()
    with ExitStack() as opened:
        meter = make_meter()  # first: its process starts while the devices open
        opened.callback(meter.close)
        devices = opener(station, clock)
        opened.callback(devices.close)
        light = LightControl(devices.light, station.light, camera_kind(station).light_for, on_change)
        light.look()
        camera = CameraControl(devices.camera, station, on_change)
        opened.pop_all()
    stage = StageControl(devices.stage, on_change)
    stage.look_safely(thoroughly=True)
    loop = LiveLoop(devices.camera, setting, stage.known_deg, on_change, meter, lambda: stage.moving)
    camera.use(loop)
    return Bench(devices, clock, stage, light, camera, loop, SimulatedHands(devices.simulation))


def close_bench(bench: Bench) -> list[DeviceEnd]:
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
        closed = DeviceEnd("camera", "not confirmed", "its recording has not ended.")
    elif lost is not None:
        closed = DeviceEnd("camera", "not confirmed", lost.message)
    return [*confirmed, closed]


def _confirm(device: DeviceName, action: Callable[[], None], answer: str) -> DeviceEnd:
    try:
        action()
    except Exception as error:  # noqa: BLE001 - whatever a driver does, the next device is made safe
        return DeviceEnd(device, "not confirmed", Failure.of(error).message)
    return DeviceEnd(device, "confirmed safe", answer)
