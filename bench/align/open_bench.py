"""Opens a station's devices with their controls for aligning, and leaves them safe at the end.

Opening moves and switches nothing. Stage and light may open while the picture is shown. Closing stops the stage,
switches the light off and closes the camera, each even if another fails. The simulated bench has hands, as a person.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from bench.align.controls import StageControl
from bench.align.device_controls import CameraControl, LightControl
from bench.align.live_figures import LiveSetting
from bench.align.live_loop import LiveLoop
from bench.align.meter import Meter
from bench.base.clock import BenchClock
from bench.base.errors import FORESEEN, ControlRefused, Failure
from bench.simulated import SimulatedBench
from bench.stations.devices import Devices, SeparateDevices
from bench.stations.station import Station
from bench.views.camera_kinds import camera_kind
from drivers.errors import StillOpening

_ALL_OPEN = "All devices are open. Nothing was moved, and the light was not switched."


def follow(bench: Bench, say: Callable[[str], None]) -> None:
    """Say when stage and light are open too, or why they could not be opened; ``say`` is called by any thread."""
    if not bench.devices.late:
        say(_ALL_OPEN)
    for name, device in bench.devices.late.items():
        device.listen(partial(_ended, bench, say, name))


def try_again(bench: Bench) -> bool:
    """Begin to open again what could not be opened; False if there was nothing."""
    failed = [device for device in bench.devices.late.values() if device.state == "failed"]
    for device in failed:
        device.start()
    return bool(failed)


def failures_of(bench: Bench) -> list[Failure]:
    """Return why stage or light cannot be used now; empty if both answer, or are still being opened."""
    return [one for one in _failures(bench) if one.kind != StillOpening.__name__]


def _failures(bench: Bench) -> list[Failure]:
    return [one for one in (bench.stage.failure, bench.light.reading.failure) if one is not None]


def _ended(bench: Bench, say: Callable[[str], None], name: str) -> None:
    """Read a device that has just been opened, or say why it could not be."""
    if name == "light":
        bench.light.look()
        failure = bench.light.reading.failure
    else:
        bench.stage.look_safely(thoroughly=True)
        failure = bench.stage.failure
    late = bench.devices.late
    if late[name].state == "failed" and failure is not None:
        say(f"The {name} could not be opened. {failure.message}")
    elif all(one.state == "open" for one in late.values()):
        say(_ALL_OPEN)


ACTIONS: Mapping[str, tuple[str, ...]] = {
    "lens turn": ("deg",),
    "lens ring": ("deg",),
    "lens aperture": ("f_number",),
    "mount turn": ("pan_deg", "tilt_deg", "roll_deg"),
}
"""What the hands can do, with the numbers that each needs."""


class SimulatedHands:
    """Hands at the simulated camera; on a real bench, ``simulation`` is None."""

    def __init__(self, simulation: SimulatedBench | None) -> None:
        self._simulation = simulation
        self._lock = threading.Lock()
        self.seen: dict[str, Any] | None = None
        """What a person would see of lens and mount, after the last action; None before the first one."""

    @property
    def available(self) -> bool:
        """Whether the bench is a simulated one."""
        return self._simulation is not None

    def do(self, action: str, numbers: Mapping[str, float]) -> dict[str, Any]:
        """Do something with the hands; refused on a real bench, and for an unknown action."""
        if self._simulation is None:
            raise ControlRefused(
                "This bench is real: nothing can be turned from here.", remedy="Use your hands."
            )
        needed = ACTIONS.get(action)
        if needed is None or not set(numbers) <= set(needed) or not all(map(math.isfinite, numbers.values())):
            known = ", ".join(ACTIONS)
            raise ControlRefused(
                f"The hands cannot do {action!r} with {dict(numbers)}.", remedy=f"They can: {known}."
            )
        words = [action, *(f"{name}={value:g}" for name, value in numbers.items())]
        with self._lock:
            answer = self._simulation.order(" ".join(words))
            try:
                found = json.loads(answer)
            except ValueError as error:
                raise ControlRefused(
                    "The simulated bench did not answer.", remedy="Press Try again."
                ) from error
            if not isinstance(found, dict) or "error" in found:
                what = found.get("error") if isinstance(found, dict) else answer
                raise ControlRefused(f"The simulated bench refused: {what}", remedy="Give another value.")
            self.seen = found.get("now")
        return self.seen or {}


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
    """Open all devices, or none, and make their controls; the loop is not started yet."""
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
