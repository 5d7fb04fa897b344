"""Faults by name: what can go wrong on the simulated bench, and how it is brought about while it runs.

Knows the catalogue of faults, how an order for one is written, and which part of the bench it befalls. How a
fault works is the parts' own: `axis_motion`, `line_faults`, `lamp`, and the camera.

An order is a mapping with ``device`` (an axis: pan, tilt, roll; a port: gimbal, light; camera), ``fault``,
perhaps ``after_s``, and the fault's parameters; or the same as text: ``pan stall share=0.3``.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol, cast

from simulators.axis_motion import Axis, FaultKind, MotionFault
from simulators.errors import ConfigError
from simulators.lamp import LAMP_FAULTS, Lamp
from simulators.line_faults import REPLY_FAULTS, REQUEST_FAULTS, FaultLine, LineFault
from simulators.serial_device import SerialDevice

Parameter = float | int | str


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


class Light(Protocol):
    """What a fault needs of the light's driver."""

    def trip(self) -> None:
        """Have the protection switch the light off."""
        ...


class Camera(Protocol):
    """What a fault needs of the camera."""

    def unplug(self) -> None:
        """Break the connection."""
        ...

    def fault(self, message: str) -> None:
        """Tell the host of a fault."""
        ...


@dataclass(frozen=True)
class Parts:
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
    """

    axes: Mapping[str, AxisController]
    ports: Mapping[str, SerialDevice]
    lines: Mapping[str, FaultLine]
    axis_ports: Mapping[str, str]
    light: Light
    lamp: Lamp
    camera: Camera
    clock: Callable[[], float]


@dataclass(frozen=True)
class Fault:
    """An entry of the catalogue: what happens, and its parameters with their defaults."""

    what: str
    parameters: Mapping[str, Parameter]


def _motion(what: str, **parameters: Parameter) -> Fault:
    return Fault(what, {**parameters, "skip": 0})


AXIS_FAULTS: Final[Mapping[str, Fault]] = {
    "stall": _motion("the motor is held fast during the next motion", share=0.5),
    "limit": _motion("a limit switch closes during the next motion", share=0.5),
    "restart": _motion("the controller reboots during the next motion", share=0.5),
    "stop_short": _motion("the next motion ends early, as if it had arrived", share=0.5),
    "slip": _motion("the motor stands still while the counter goes on", share=0.5),
    "creep": _motion("the motor drifts once it has arrived, unknown to the counter", creep_deg_s=0.01),
    "stuck_busy": Fault("the controller says busy for ever", {}),
    "idle_flicker": Fault("the controller says idle while it moves", {"times": 1}),
    "push": Fault("the shaft is turned from outside, unknown to the counter", {"deg": 0.1}),
    "reboot": Fault("the controller loses power for a moment, now", {}),
    "emergency_stop": Fault("somebody presses the emergency stop", {}),
    "release": Fault("somebody releases the emergency stop", {}),
    "mend": Fault("nothing more goes wrong with this axis", {}),
}

_LINE_PARAMETERS: Final[Mapping[str, Parameter]] = {
    "count": 1,
    "skip": 0,
    "chance": 1.0,
    "delay_s": 0.5,
    "pattern": "",
    "replacement": "",
}

LINE_FAULTS: Final[Mapping[str, Fault]] = {
    **{name: Fault("befalls replies of this port", _LINE_PARAMETERS) for name in (*REPLY_FAULTS, "any")},
    **{name: Fault("befalls requests to this port", _LINE_PARAMETERS) for name in REQUEST_FAULTS},
    "unplug": Fault("the cable is pulled", {}),
    "replug": Fault("the cable is put back", {}),
    "mend": Fault("nothing more goes wrong with this port", {}),
}

#: What the factor of a lamp's fault is unless it is said; those without one are not here.
_LAMP_FACTORS: Final = {
    "dim": 0.5,
    "wrong_frequency": 0.5,
    "wrong_duty": 0.5,
    "sync_missing": 2.0,
    "sync_extra": 2.0,
    "sync_jitter": 0.1,
}

_LAMP_CATALOGUE: Final[Mapping[str, Fault]] = {
    name: Fault(what, {"factor": _LAMP_FACTORS[name]} if name in _LAMP_FACTORS else {})
    for name, what in LAMP_FAULTS.items()
}

LIGHT_FAULTS: Final[Mapping[str, Fault]] = {
    **_LAMP_CATALOGUE,
    "trip": Fault("the protection of the light's driver switches it off", {}),
}

CAMERA_FAULTS: Final[Mapping[str, Fault]] = {
    "unplug": Fault("the camera goes away; it may be connected again", {}),
    "fault": Fault("the camera tells of a fault", {"message": "sensor fault"}),
}


@dataclass(frozen=True)
class Order:
    """One fault that is to happen, checked against the catalogue."""

    device: str
    fault: str
    parameters: Mapping[str, Parameter]
    after_s: float = 0.0


def catalogue(device: str) -> Mapping[str, Fault]:
    """List what can go wrong with a device.

    Raises
    ------
    ConfigError
        When there is no such device.
    """
    by_device: dict[str, Mapping[str, Fault]] = {
        **dict.fromkeys(("pan", "tilt", "roll"), AXIS_FAULTS),
        **dict.fromkeys(("gimbal", "gimbal-pan", "gimbal-tilt", "gimbal-roll"), LINE_FAULTS),
        "light": {**LIGHT_FAULTS, **LINE_FAULTS},
        "camera": CAMERA_FAULTS,
    }
    if device not in by_device:
        raise ConfigError(
            f"No device {device!r}.", where="device", remedy=f"Known are: {', '.join(by_device)}."
        )
    return by_device[device]


def order_from_text(text: str) -> Order:
    """Read an order as it is typed.

    Raises
    ------
    ConfigError
        When it is no order, or names what is not there.

    Examples
    --------
    >>> order_from_text("pan stall share=0.3").parameters
    {'share': 0.3, 'skip': 0}
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ConfigError(f"The order cannot be read: {error}.", where=text.strip()) from error
    if len(words) < 2 or any("=" not in word for word in words[2:]):
        raise ConfigError(
            "An order is a device, a fault and its parameters.",
            where=text.strip(),
            remedy="As in: pan stall share=0.3",
        )
    given = dict(word.split("=", 1) for word in words[2:])
    return order({"device": words[0], "fault": words[1], **given})


def order(given: Mapping[str, Any]) -> Order:
    """Check an order.

    Raises
    ------
    ConfigError
        Naming the key that is missing, unknown, or whose value cannot be.
    """
    for key in ("device", "fault"):
        if not isinstance(given.get(key), str):
            raise ConfigError("It is missing, or no text.", where=key)
    device, fault = given["device"], given["fault"]
    known = catalogue(device)
    if fault not in known:
        raise ConfigError(
            f"No fault {fault!r} of {device}.", where="fault", remedy=f"Known are: {', '.join(known)}."
        )
    defaults = {"after_s": 0.0, **known[fault].parameters}
    values = dict(defaults)
    for key, value in given.items():
        if key in {"device", "fault"}:
            continue
        if key not in defaults:
            raise ConfigError("Unknown key.", where=key, remedy=f"Known are: {', '.join(defaults)}.")
        values[key] = _like(defaults[key], value, key)
    after_s = float(values.pop("after_s"))
    return Order(device, fault, values, after_s)


def _like(default: Parameter, value: object, where: str) -> Parameter:
    """Read a value, which may be text, as one of its default's kind."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise ConfigError(f"A number or text is expected, not {value!r}.", where=where)
    try:
        return type(default)(value)
    except (ValueError, OverflowError):
        raise ConfigError(f"A number is expected, not {value!r}.", where=where) from None


def prepare(one: Order, parts: Parts) -> Callable[[], None]:
    """Give the call that brings a fault about.

    Raises
    ------
    ConfigError
        When this bench has no such device, or a parameter makes no sense.
    """
    if one.device in parts.ports:
        return _on_port(one, parts)
    if one.device == "camera":
        message = str(one.parameters.get("message", ""))
        return parts.camera.unplug if one.fault == "unplug" else lambda: parts.camera.fault(message)
    if one.device in parts.axes:
        controller, port = parts.axes[one.device], parts.ports[parts.axis_ports[one.device]]
        return lambda: port.between_exchanges(lambda: _on_axis(one, controller, parts.clock()))
    raise ConfigError(f"This bench has no {one.device}.", where="device")


def _on_port(one: Order, parts: Parts) -> Callable[[], None]:
    port, line, lamp = parts.ports[one.device], parts.lines[one.device], parts.lamp
    if one.fault == "unplug":
        return port.unplug
    if one.fault == "replug":
        return port.replug

    def mend() -> None:
        line.clear()
        if one.device == "light":
            lamp.mend()

    if one.fault == "mend":
        return lambda: port.between_exchanges(mend)
    if one.fault == "trip":
        return lambda: port.between_exchanges(parts.light.trip)
    if one.fault in LAMP_FAULTS:
        factor = float(one.parameters.get("factor", 1.0))
        if factor <= 0.0:
            raise ConfigError(f"{factor} is not positive.", where="factor")
        return lambda: port.between_exchanges(lambda: lamp.go_wrong(one.fault, factor))
    fault = _line_fault(one)
    return lambda: port.between_exchanges(lambda: line.inject(fault))


def _line_fault(one: Order) -> LineFault:
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
        replacement=_bytes(p["replacement"]),
    )


def _bytes(text: Parameter) -> bytes:
    r"""Read a text in which line ends and the like are written as ``\n``."""
    try:
        return str(text).encode("latin-1").decode("unicode_escape").encode("latin-1")
    except ValueError as error:
        raise ConfigError(f"{text!r} cannot be read as bytes: {error}.", where="replacement") from error


def _on_axis(one: Order, controller: AxisController, now: float) -> None:
    axis, p = controller.axis, one.parameters
    if "skip" in p:
        axis.arm(
            MotionFault(
                cast("FaultKind", one.fault),
                share=float(p.get("share", 1.0)),
                creep_deg_s=float(p.get("creep_deg_s", 0.0)),
                skip=int(p["skip"]),
            )
        )
    elif one.fault == "stuck_busy":
        axis.stuck_busy = True
    elif one.fault == "idle_flicker":
        axis.say_idle(int(p["times"]))
    elif one.fault == "push":
        axis.push(float(p["deg"]) * axis.mechanics.counts_per_deg, now)
    elif one.fault == "reboot":
        controller.restart(now)
    elif one.fault == "mend":
        axis.arm(None)
        axis.say_idle(0)
        axis.stuck_busy = False
    else:
        controller.emergency_stop(now, released=one.fault == "release")
