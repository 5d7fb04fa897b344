"""How an order for a fault is brought about on a running bench.

Knows which part of the bench each fault of the catalogue befalls; how a fault works is the parts' own:
`axis_motion`, `line_faults`, `lamp`, the controllers and the camera.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Protocol, cast

from simulators.cameras.stream_faults import StreamFault, StreamFaults
from simulators.errors import ConfigError
from simulators.faults.catalogue import LIGHT_FAULTS, FaultOrder, Parameter
from simulators.faults.line_faults import FaultLine, LineFault
from simulators.lights.lamp import Lamp
from simulators.ports.serial_device import SerialDevice
from simulators.stages.axis_motion import Axis
from simulators.stages.motion_faults import FaultKind, MotionFault


class AxisController(Protocol):
    """What a fault needs of a stage's controller, for one axis."""

    @property
    def axis(self) -> Axis:
        """The axis."""
        ...

    def restart(self, t_s: float) -> None:
        """Lose power, and have it again."""
        ...

    def emergency_stop(self, t_s: float, *, released: bool = False) -> None:
        """Press or release the emergency stop."""
        ...

    def exchange(self, serial: str, t_s: float) -> None:
        """Be another controller from now on, fresh from power-up."""
        ...


class Light(Protocol):
    """What a fault needs of the light's driver."""

    def clip(self, most_v: float | None) -> None:
        """Hold levels to come within less than usual, or no more."""
        ...

    def trip(self) -> None:
        """Have the protection switch the light off."""
        ...

    def exchange(self, serial: str) -> None:
        """Be another driver from now on, fresh from power-up."""
        ...


class Camera(Protocol):
    """What a fault needs of the camera."""

    @property
    def stream_faults(self) -> StreamFaults:
        """The way its frames take."""
        ...

    def unplug(self) -> None:
        """Break the connection."""
        ...

    def report_fault(self, message: str) -> None:
        """Tell the host of a fault."""
        ...


class FrameCamera(Protocol):
    """What a fault needs of the frame camera."""

    def inject_fault(self, fault: str) -> None:
        """Let it happen from now on."""
        ...


@dataclass(frozen=True)
class BenchParts:
    """The bench, as far as things can go wrong with it.

    Attributes
    ----------
    axes
        Controllers, by axis.
    ports
        Devices on serial lines, by name.
    lines
        The lines to them, by the same names.
    axis_ports
        Names of the ports at which they answer.
    light, lamp, camera
        The light's driver, what hangs on it, and the camera.
    clock
        Time in seconds.
    frame_camera
        The other camera, where there is one.
    """

    axes: Mapping[str, AxisController]
    ports: Mapping[str, SerialDevice]
    lines: Mapping[str, FaultLine]
    axis_ports: Mapping[str, str]
    light: Light
    lamp: Lamp
    camera: Camera
    clock: Callable[[], float]
    frame_camera: FrameCamera | None = None


def fault_action(one: FaultOrder, parts: BenchParts) -> Callable[[], None]:
    """Give the call that brings a fault about.

    Raises
    ------
    ConfigError
        When this bench has no such device, or a parameter makes no sense.
    """
    if one.device in parts.ports:
        return _on_port(one, parts)
    if one.device == "camera":
        return _on_camera(one, parts.camera)
    if one.device == "frame-camera" and (frame_camera := parts.frame_camera) is not None:
        return lambda: frame_camera.inject_fault(one.fault)
    if one.device in parts.axes:
        name = parts.axis_ports[one.device]
        controller, port, line = parts.axes[one.device], parts.ports[name], parts.lines[name]
        from_outside: dict[str, Callable[[], None]] = {
            "unplug": port.unplug,
            "press_stop": lambda: controller.emergency_stop(parts.clock()),
        }
        act = from_outside.get(one.fault)
        then = None if act is None else lambda t_s: line.schedule(t_s, act)
        return lambda: port.between_exchanges(lambda: _on_axis(one, controller, parts.clock(), then))
    raise ConfigError(f"This bench has no {one.device}.", where="device")


def _on_camera(one: FaultOrder, camera: Camera) -> Callable[[], None]:
    if one.fault == "unplug":
        return camera.unplug
    if one.fault == "fault":
        return lambda: camera.report_fault(str(one.parameters["message"]))
    if one.fault == "mend":
        return camera.stream_faults.clear
    if one.fault == "overflow":
        return partial(setattr, camera.stream_faults, "overflows", True)
    fault = StreamFault(one.fault, int(one.parameters["skip"]), int(one.parameters["count"]))
    return lambda: camera.stream_faults.inject(fault)


def _on_port(one: FaultOrder, parts: BenchParts) -> Callable[[], None]:
    port = parts.ports[one.device]
    if one.fault in LIGHT_FAULTS:
        act = _on_light(one, parts)
        return lambda: port.between_exchanges(act)
    act = line_fault_action(one, port, parts.lines[one.device])
    if one.fault == "mend" and one.device == "light":

        def mend_both() -> None:
            act()
            port.between_exchanges(parts.lamp.clear_faults)
            port.between_exchanges(lambda: parts.light.clip(None))

        return mend_both
    return act


def line_fault_action(one: FaultOrder, port: SerialDevice, line: FaultLine) -> Callable[[], None]:
    """Give the call that brings a fault of a line about.

    Raises
    ------
    ConfigError
        When a parameter makes no sense.
    """
    if one.fault in {"unplug", "replug"}:
        return port.unplug if one.fault == "unplug" else port.replug
    act = _on_line(one, line)
    return lambda: port.between_exchanges(act)


def _on_line(one: FaultOrder, line: FaultLine) -> Callable[[], None]:
    if one.fault == "mend":
        return line.clear
    if one.fault == "baud":
        rate = int(one.parameters["rate"])
        return lambda: line.listen_at(rate)
    if one.fault == "say":
        text = _bytes(one.parameters["text"], "text")
        return lambda: line.say(text)
    fault = _line_fault(one)
    return lambda: line.inject(fault)


def _on_light(one: FaultOrder, parts: BenchParts) -> Callable[[], None]:
    if one.fault == "trip":
        return parts.light.trip
    if one.fault == "exchange":
        return lambda: parts.light.exchange(str(one.parameters["serial"]))
    if one.fault == "clip":
        most_v = float(one.parameters["most_v"])
        return lambda: parts.light.clip(most_v)
    factor = float(one.parameters.get("factor", 1.0))
    if factor <= 0.0:
        raise ConfigError(f"{factor} is not positive.", where="factor")
    return lambda: parts.lamp.inject_fault(one.fault, factor)


def _line_fault(one: FaultOrder) -> LineFault:
    p = one.parameters
    try:
        re.compile(str(p["pattern"]).encode())
    except re.error as error:
        raise ConfigError(f"{p['pattern']!r} is no pattern: {error}.", where="pattern") from error
    return LineFault(
        one.fault,
        count=int(p["count"]) or None,
        skip=int(p["skip"]),
        chance=float(p["chance"]),
        delay_s=float(p["delay_s"]),
        pattern=str(p["pattern"]).encode(),
        replacement=_bytes(p["replacement"], "replacement"),
    )


def _bytes(text: Parameter, where: str) -> bytes:
    r"""Read a text in which line ends and the like are written as ``\n``."""
    try:
        return str(text).encode("latin-1").decode("unicode_escape").encode("latin-1")
    except ValueError as error:
        raise ConfigError(f"{text!r} cannot be read as bytes: {error}.", where=where) from error


def _on_axis(
    one: FaultOrder, controller: AxisController, now: float, then: Callable[[float], None] | None
) -> None:
    axis, p = controller.axis, one.parameters
    if "skip" in p:
        axis.arm(
            MotionFault(
                cast("FaultKind", one.fault),
                share=float(p.get("share", 1.0)),
                creep_deg_s=float(p.get("creep_deg_s", 0.0)),
                skip=int(p["skip"]),
                then=then,
            )
        )
    elif one.fault == "stuck_busy":
        axis.stuck_busy = True
    elif one.fault == "idle_flicker":
        axis.report_false_idle(int(p["times"]))
    elif one.fault == "push":
        axis.push(float(p["deg"]) * axis.mechanics.counts_per_deg, now)
    elif one.fault == "reboot":
        controller.restart(now)
    elif one.fault == "exchange":
        controller.exchange(str(p["serial"]), now)
    elif one.fault == "mend":
        axis.arm(None)
        axis.report_false_idle(0)
        axis.stuck_busy = False
    else:
        controller.emergency_stop(now, released=one.fault == "release")
