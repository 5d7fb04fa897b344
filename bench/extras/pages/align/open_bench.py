"""A station's devices in the hands of a person who aligns: opened with their controls, and left safe at the end.

Opening moves and switches nothing. Access to the camera goes through the loop that records, so settings change between
two slices only. Closing stops the stage, switches the light off and closes the camera, each even if another fails.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeVar

from bench.base.clock import BenchClock
from bench.base.errors import ControlRefused
from bench.base.failure import FORESEEN, Failure
from bench.extras.pages.align.controls import StageControl
from bench.extras.pages.align.figure_rows import FigureRow
from bench.extras.pages.align.live_figures import LiveSetting
from bench.extras.pages.align.live_loop import LiveLoop
from bench.extras.pages.align.meter import Meter
from bench.measure.camera_kinds import camera_kind, event_camera, frame_camera
from bench.record.device_end import DeviceEnd, DeviceName
from bench.simulated import SimulatedBench
from bench.stations.cameras import OpenCvCameraConfig
from bench.stations.devices import Camera, Devices
from bench.stations.sections import FrameCameraSection
from bench.stations.stages_and_lights import LightConfig
from bench.stations.station import Station
from drivers.camera import CameraIdentity, CameraSettings, StatesBiasRanges
from drivers.camera.frames import FrameSettings
from drivers.errors import DriverError
from drivers.light import Light, LightSettings
from sequences.schema import FlickerConfig
from sequences.script import Flicker

T = TypeVar("T")
ANSWER_S = 20.0
"""Longest wait for the camera between two slices, s."""


_IMX636: Mapping[str, tuple[int, int]] = {
    "bias_diff_on": (-150, 200),
    "bias_diff_off": (-150, 200),
    "bias_fo": (-150, 200),
    "bias_hpf": (0, 255),
    "bias_refr": (-50, 255),
}
"""Ranges of the biases where the camera's driver does not state them; the camera refuses what it cannot do."""
RANGES = {"duty_percent": (1.0, 99.0), "level_percent": (0.1, 100.0)}
"""Lowest and highest value of each number besides the frequency, whose range the station states."""

ACTIONS: Mapping[str, tuple[str, ...]] = {
    "lens turn": ("deg",),
    "lens ring": ("deg",),
    "lens aperture": ("f_number",),
    "mount turn": ("pan_deg", "tilt_deg", "roll_deg"),
}
"""What the hands can do, with the numbers that each needs."""

OpenDevices = Callable[[Station, BenchClock], Devices]


def open_devices(station: Station, clock: BenchClock) -> Devices:
    """Open the devices of a station; a simulated bench is the same one each time."""
    return Devices(station, seed=1, clock=clock, wire_log=None)


class CameraControl:
    """The camera's identity and settings."""

    def __init__(self, camera: Camera, station: Station, on_change: Callable[[], None]) -> None:
        self._camera = camera
        self._config = station.camera
        self._kind = camera_kind(station)
        self._on_change = on_change
        self._lock = threading.Lock()
        self._loop: LiveLoop | None = None
        self._ranges = camera.bias_ranges() if isinstance(camera, StatesBiasRanges) else _IMX636
        self.identity: CameraIdentity = camera.identify()
        """The camera, as it states itself."""
        self.settings, self.reasons = self._kind.prepare(camera)
        """Settings as read back, and every reason against a run."""
        self._of_station = dict(self.settings)  # With these the camera was opened, as a run opens it

    @property
    def is_event(self) -> bool:
        """Whether this is an event camera."""
        return not isinstance(self._config, FrameCameraSection)

    @property
    def values(self) -> Mapping[str, float | None]:
        """Biases, as offsets from the factory values, or exposure and gain, as read back; empty if there are none."""
        if self.is_event:
            biases = self.settings.get("biases", {})
            return {name: value for name, value in biases.items() if name in self._ranges}
        if isinstance(self._config, OpenCvCameraConfig):
            return {name: self.settings.get(name) for name in ("exposure", "gain")}
        return {}

    @property
    def changed(self) -> Mapping[str, float]:
        """Those of `values` that differ from what the station file states."""
        expected = self._expected
        return {n: v for n, v in self.values.items() if v is not None and expected.get(n) not in (None, v)}

    @property
    def _expected(self) -> Mapping[str, float | None]:
        return self._of_station.get("biases", {}) if self.is_event else self._of_station

    def use(self, loop: LiveLoop) -> None:
        """Change settings through this loop from now on."""
        self._loop = loop

    def set(self, name: str, value: float) -> Mapping[str, float | None]:
        """Change a bias, in the camera's own steps, or exposure or gain; read all back. Refused: nothing was sent."""
        names = self._ranges if self.is_event else self.values
        if name not in names:
            raise ControlRefused(
                f"This camera has no setting {name!r}. Nothing was sent.",
                where="camera",
                remedy=f"It has {', '.join(names)}." if names else "Set it at the camera itself.",
            )
        with self._lock:
            if self.is_event:
                self._set_bias(name, value)
            else:
                wanted = FrameSettings(**{**self.values, name: value})
                frame = self._between_slices(lambda: frame_camera(self._camera).apply(wanted))
                self.settings = {**self.settings, **asdict(frame)}
        self._on_change()
        return self.values

    def _set_bias(self, name: str, value: float) -> None:
        low, high = self._ranges[name]
        if not low <= value <= high or value != int(value):
            raise ControlRefused(
                f"{name} {value:g} is no whole number from {low} to {high}. Nothing was sent.",
                where="camera",
                remedy="Give a value in this range.",
            )
        # Other biases keep the value that was read back.
        biases = {bias: int(now) for bias, now in self.values.items() if now is not None} | {name: int(value)}
        roi = None if isinstance(self._config, FrameCameraSection) else self._config.roi
        settings = CameraSettings(biases, trigger_in=True, roi=roi)
        applied = self._between_slices(lambda: event_camera(self._camera).apply(settings))
        self.settings = {**self.settings, "biases": dict(applied.biases)}

    def _between_slices(self, apply: Callable[[], T]) -> T:
        assert self._loop is not None
        return self._loop.on_camera(apply).result(timeout=ANSWER_S)

    def row(self) -> FigureRow:
        """Return whether the camera is set as in a run, for the page."""
        found = [*self.reasons, *(f"{name} is changed" for name in self.changed)]
        expected = "as in the station file"
        return FigureRow("Camera", "; ".join(found) or expected, expected=expected, good=not found)

    def as_data(self) -> dict[str, Any]:
        """Return the camera as the page shows it."""
        return {
            "kind": "event" if self.is_event else "frame",
            "settings": [
                {
                    "name": name,
                    "value": value,
                    "range": list(self._ranges[name]) if self.is_event else None,
                    "expected": self._expected.get(name),
                    "changed": name in self.changed,
                }
                for name, value in self.values.items()
            ],
        }


@dataclass(frozen=True)
class LightReading:
    """What is known of the light."""

    flicker: Flicker  # What was asked for last
    # Settings as the device reported them last; None before the first reading.
    settings: LightSettings | None = None
    on: bool | None = None  # Whether the output is on, as the device reported; None if unknown
    faults: tuple[str, ...] = ()
    failure: Failure | None = None  # Why the light does not answer or refuses; None if nothing is wrong


class LightControl:
    """A light in the hands of a person."""

    def __init__(
        self,
        light: Light,
        config: LightConfig,
        for_camera: Callable[[Flicker], Flicker],
        on_change: Callable[[], None],
    ) -> None:
        self._light = light
        self._config = config
        self._for_camera = for_camera
        self._on_change = on_change
        self._lock = threading.Lock()
        start = FlickerConfig()
        low, high = config.frequency_range_hz
        hz = min(max(start.frequency_hz, low), high)
        self.reading = LightReading(Flicker(start.waveform, hz, start.duty_percent, start.level_percent))
        """What is known of the light."""

    def set(self, *, on: bool | None = None, **given: Any) -> LightReading:
        """Change the light, and read back what it does. When refused, nothing was sent.

        ``on`` None leaves it as it is; ``given`` are attributes of a `Flicker`, the others stay.
        """
        self._check(given)
        with self._lock:
            flicker = replace(self.reading.flicker, **given)
            try:
                if on is False:
                    self._light.off()
                if given or on:
                    self._light.apply(self._config.settings(self._for_camera(flicker)))
                if on:
                    self._light.on()
                self.reading = self._read(flicker)
            except DriverError as error:
                self.reading = replace(self.reading, on=None, failure=Failure.of(error))
                raise
            finally:
                self._on_change()
            return self.reading

    def off(self) -> None:
        """Switch the light off, and check that it is off."""
        with self._lock:
            self._light.off()
            self.reading = replace(self.reading, on=False)
        self._on_change()

    def look(self) -> None:
        """Read whether the light is on, its settings and its faults. Never raises: a failure becomes the state."""
        with self._lock:
            before = self.reading
            try:
                self.reading = self._read(before.flicker)
            except DriverError as error:
                self.reading = replace(before, on=None, failure=Failure.of(error))
            changed = before != self.reading
        if changed:
            self._on_change()

    def row(self) -> FigureRow:
        """Return what the light does, for the page."""
        now = self.reading
        words = "; ".join(now.faults) or {None: "unknown", True: "on", False: "off"}[now.on]
        return FigureRow("Light", words, expected="on", good=words == "on")

    def as_data(self) -> dict[str, Any]:
        """Return the light as the page shows it."""
        now = self.reading
        settings = now.settings
        steady = self._for_camera(now.flicker).waveform == "steady"
        return {
            "on": now.on,
            "steady_only": steady,
            "frequency_hz": now.flicker.frequency_hz,
            "duty_percent": now.flicker.duty_percent,
            "level_percent": now.flicker.level_percent,
            "read_back": None if settings is None else asdict(settings),
            "frequency_range_hz": list(self._config.frequency_range_hz),
            "failure": now.failure.to_dict() if now.failure else None,
        }

    def _read(self, flicker: Flicker) -> LightReading:
        return LightReading(flicker, self._light.read(), self._light.is_on(), tuple(self._light.faults()))

    def _check(self, given: dict[str, Any]) -> None:
        """Check the ranges. Raises ControlRefused."""
        ranges = {**RANGES, "frequency_hz": self._config.frequency_range_hz}
        for name, (low, high) in ranges.items():
            value = given.get(name, low)
            if not low <= value <= high:
                raise ControlRefused(
                    f"{name} {value:g} is outside {low:g} to {high:g}. Nothing was sent.",
                    where="light",
                    remedy="Give a value in this range. The station file states the range of the frequency.",
                )


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
                content = json.loads(answer)
            except ValueError as error:
                raise ControlRefused(
                    "The simulated bench did not answer.", remedy="Press Try again."
                ) from error
            if "error" in content:
                what = f"The simulated bench refused: {content['error']}"
                raise ControlRefused(what, remedy="Give another value.")
            self.seen = content.get("now")
        return self.seen or {}


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
    meter = make_meter()  # first: its process starts while the devices open
    try:
        devices = opener(station, clock)
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
    except FORESEEN as error:
        return DeviceEnd(device, "not confirmed", Failure.of(error).message)
    return DeviceEnd(device, "confirmed safe", answer)
