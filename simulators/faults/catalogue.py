"""Faults by name: what can go wrong on the simulated bench, and how an order for it is written.

Knows the faults_of and checks orders against it; `fault_injection` carries them out.

An order is a mapping with ``device`` (an axis: pan, tilt, roll; a port: gimbal, light; camera, frame-camera),
``fault``, perhaps ``after_s``, and the fault's parameters; or the same as text: ``pan stall share=0.3``.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from simulators.cameras.frame_camera import FRAME_CAMERA_FAULTS
from simulators.cameras.stream_faults import STREAM_FAULTS
from simulators.errors import ConfigError
from simulators.faults.line_faults import REPLY_FAULTS, REQUEST_FAULTS
from simulators.lights.lamp import LAMP_FAULTS

Parameter = float | int | str


@dataclass(frozen=True)
class Fault:
    """An entry of the faults_of: what happens, and its parameters with their defaults."""

    what: str
    parameters: Mapping[str, Parameter]


def _motion(what: str, **parameters: Parameter) -> Fault:
    return Fault(what, {**parameters, "skip": 0})


AXIS_FAULTS: Final[Mapping[str, Fault]] = {
    "stall": _motion("the motor is held fast during the next motion", share=0.5),
    "limit": _motion("a limit switch closes during the next motion", share=0.5),
    "twist": _motion("a pair of axes comes apart during the next motion", share=0.5),
    "restart": _motion("the controller reboots during the next motion", share=0.5),
    "stop_short": _motion("the next motion ends early, as if it had arrived", share=0.5),
    "no_progress": _motion("the next motion ends early, and the controller says busy for ever", share=0.5),
    "slip": _motion("the motor stands still while the counter goes on", share=0.5),
    "creep": _motion("the motor drifts once it has arrived, unknown to the counter", creep_deg_s=0.01),
    "unplug": _motion("the cable is pulled during the next motion", share=0.5),
    "press_stop": _motion("somebody presses the emergency stop during the next motion", share=0.5),
    "stuck_busy": Fault("the controller says busy for ever", {}),
    "idle_flicker": Fault("the controller says idle while it moves", {"times": 1}),
    "push": Fault("the shaft is turned from outside, unknown to the counter", {"deg": 0.1}),
    "reboot": Fault("the controller loses power for a moment, now", {}),
    "exchange": Fault(
        "somebody puts a controller of another serial number in its place", {"serial": "999999"}
    ),
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
    **{
        name: Fault("befalls replies of this port", _LINE_PARAMETERS)
        for name in (*REPLY_FAULTS, "stale", "any")
    },
    **{name: Fault("befalls requests to this port", _LINE_PARAMETERS) for name in REQUEST_FAULTS},
    "baud": Fault("the device listens at another baud rate", {"rate": 9600}),
    "say": Fault("the host hears something that nobody has asked for", {"text": "!"}),
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
    "clip": Fault("the light's driver holds levels to come within less than usual", {"most_v": 2.0}),
    "trip": Fault("the protection of the light's driver switches it off", {}),
    "exchange": Fault("somebody puts a driver of another serial number in its place", {"serial": "XX9999"}),
}

CAMERA_FAULTS: Final[Mapping[str, Fault]] = {
    "unplug": Fault("the camera goes away; it may be connected again", {}),
    "fault": Fault("the camera tells of a fault", {"message": "sensor fault"}),
    **{name: Fault(what, {"skip": 0, "count": 1}) for name, what in STREAM_FAULTS.items()},
    "overflow": Fault(
        "more events than the sensor's rate controller lets through, from the next recording on", {}
    ),
    "mend": Fault("nothing more goes wrong with the camera's stream", {}),
}

_FRAME_CAMERA: Final[Mapping[str, Fault]] = {
    name: Fault(what, {}) for name, what in FRAME_CAMERA_FAULTS.items()
}


@dataclass(frozen=True)
class FaultOrder:
    """One fault that is to happen, checked against the faults_of."""

    device: str
    fault: str
    parameters: Mapping[str, Parameter]
    after_s: float = 0.0


def faults_of(device: str) -> Mapping[str, Fault]:
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
        "frame-camera": _FRAME_CAMERA,
    }
    if device not in by_device:
        raise ConfigError(
            f"No device {device!r}.", where="device", remedy=f"Known are: {', '.join(by_device)}."
        )
    return by_device[device]


def fault_order_from_text(text: str) -> FaultOrder:
    """Read an order as it is typed.

    Raises
    ------
    ConfigError
        When it is no order, or names what is not there.

    Examples
    --------
    >>> fault_order_from_text("pan stall share=0.3").parameters
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
    return fault_order({"device": words[0], "fault": words[1], **given})


def fault_order(given: Mapping[str, Any]) -> FaultOrder:
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
    known = faults_of(device)
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
    return FaultOrder(device, fault, values, after_s)


def _like(default: Parameter, value: object, where: str) -> Parameter:
    """Read a value, which may be text, as one of its default's kind."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise ConfigError(f"A number or text is expected, not {value!r}.", where=where)
    try:
        return type(default)(value)
    except (ValueError, OverflowError):
        raise ConfigError(f"A number is expected, not {value!r}.", where=where) from None
