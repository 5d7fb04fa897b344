"""Catalogue of the faults that the simulated bench can inject, and orders for them.

An order is a mapping with ``device`` (an axis: pan, tilt, roll; a port: gimbal, light; camera, frame-camera, mount,
lens or board), ``fault``, optionally ``after_s``, and parameters of the fault. The same order as text:
``pan stall share=0.3``. Orders come on a process's standard input, one a line; each is answered by one line of JSON.
This module checks orders against the catalogue; `fault_injection` carries them out.
"""

from __future__ import annotations

import json
import math
import os
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from simulators.cameras.streaming import FRAME_CAMERA_FAULTS, STREAM_FAULTS
from simulators.errors import ConfigError, SimulatorError
from simulators.faults.line_faults import REPLY_FAULTS, REQUEST_FAULTS
from simulators.lights.lamp import LAMP_FAULTS

Parameter = float | int | str
_LINE_PARAMETERS: Final[Mapping[str, Parameter]] = {
    "count": 1,
    "skip": 0,
    "chance": 1.0,
    "delay_s": 0.5,
    "pattern": "",
    "replacement": "",
}


@dataclass(frozen=True)
class Fault:
    """An entry of the catalogue."""

    what: str
    parameters: Mapping[str, Parameter]  # Parameters of the fault, with their default values


def _motion(what: str, **parameters: Parameter) -> Fault:
    return Fault(what, {**parameters, "skip": 0})


AXIS_FAULTS: Final[Mapping[str, Fault]] = {
    "stall": _motion("the motor is blocked during the next motion", share=0.5),
    "limit": _motion("a limit switch closes during the next motion", share=0.5),
    "twist": _motion("a lockstep pair of axes loses its alignment during the next motion", share=0.5),
    "restart": _motion("the controller reboots during the next motion", share=0.5),
    "stop_short": _motion("the next motion ends early, as if it had arrived", share=0.5),
    "no_progress": _motion("the next motion ends early; the controller keeps reporting busy", share=0.5),
    "slip": _motion("the motor stands still while the counter continues", share=0.5),
    "creep": _motion("the motor drifts after it has arrived; the counter does not follow", creep_deg_s=0.01),
    "unplug": _motion("the cable is pulled during the next motion", share=0.5),
    "press_stop": _motion("the emergency stop is pressed during the next motion", share=0.5),
    "stuck_busy": Fault("the controller keeps reporting busy", {}),
    "idle_flicker": Fault("the controller reports idle while the axis moves", {"times": 1}),
    "push": Fault("the shaft is turned from outside; the counter does not notice", {"deg": 0.1}),
    "reboot": Fault("the controller loses power for a moment, now", {}),
    "exchange": Fault(
        "a controller with another serial number replaces this controller", {"serial": "999999"}
    ),
    "emergency_stop": Fault("the emergency stop is pressed", {}),
    "release": Fault("the emergency stop is released", {}),
    "mend": Fault("clears all faults of this axis", {}),
}


LINE_FAULTS: Final[Mapping[str, Fault]] = {
    **{
        name: Fault("affects replies from this port", _LINE_PARAMETERS)
        for name in (*REPLY_FAULTS, "stale", "any")
    },
    **{name: Fault("affects requests to this port", _LINE_PARAMETERS) for name in REQUEST_FAULTS},
    "baud": Fault("the device listens at another baud rate", {"rate": 9600}),
    "say": Fault("the host receives an unsolicited text", {"text": "!"}),
    "unplug": Fault("the cable is pulled", {}),
    "replug": Fault("the cable is put back", {}),
    "mend": Fault("clears all faults of this port", {}),
}

LIGHT_FAULTS: Final[Mapping[str, Fault]] = {
    **{
        name: Fault(what, {} if factor is None else {"factor": factor})
        for name, (what, factor) in LAMP_FAULTS.items()
    },
    "clip": Fault("the light's driver limits levels to most_v", {"most_v": 2.0}),
    "trip": Fault("the protection of the light's driver switches the light off", {}),
    "exchange": Fault("a driver with another serial number replaces this driver", {"serial": "XX9999"}),
}

CAMERA_FAULTS: Final[Mapping[str, Fault]] = {
    "unplug": Fault("the camera disconnects; the host may connect again", {}),
    "fault": Fault("the camera reports a fault", {"message": "sensor fault"}),
    **{name: Fault(what, {"skip": 0, "count": 1}) for name, what in STREAM_FAULTS.items()},
    "overflow": Fault("the sensor's event rate controller drops events, from the next recording on", {}),
    "mend": Fault("clears all faults of the camera's stream", {}),
}

_FRAME_CAMERA: Final[Mapping[str, Fault]] = {
    name: Fault(what, {}) for name, what in FRAME_CAMERA_FAULTS.items()
}


MOUNT_FAULTS: Final[Mapping[str, Fault]] = {
    "shift": Fault("somebody moves the camera across the beam", {"x_mm": 0.0, "y_mm": 0.0}),
    "turn": Fault(
        "somebody turns the camera in its mount, from how it stands",
        {"pan_deg": 0.0, "tilt_deg": 0.0, "roll_deg": 0.0},
    ),
    "mend": Fault("moves the camera back to where it stood at the start", {}),
}

LENS_FAULTS: Final[Mapping[str, Fault]] = {
    "focus": Fault("somebody focuses the lens at a distance", {"distance_m": math.inf}),
    "ring": Fault("somebody turns the focus ring to an angle", {"deg": 0.0}),
    "turn": Fault("somebody turns the focus ring by an angle, at most to its stop", {"deg": 5.0}),
    "aperture": Fault("somebody sets the aperture", {"f_number": 2.8}),
    "mend": Fault("focus and aperture are again those of the start", {}),
}


@dataclass(frozen=True)
class FaultOrder:
    """An order for one fault, checked against the catalogue."""

    device: str
    fault: str
    parameters: Mapping[str, Parameter]
    after_s: float = 0.0  # Delay before the fault happens, s


def faults_of(device: str) -> Mapping[str, Fault]:
    """Return the faults of a device, e.g. ``pan`` or ``light``."""
    by_device: dict[str, Mapping[str, Fault]] = {
        **dict.fromkeys(("pan", "tilt", "roll"), AXIS_FAULTS),
        **dict.fromkeys(("gimbal", "gimbal-pan", "gimbal-tilt", "gimbal-roll"), LINE_FAULTS),
        "light": {**LIGHT_FAULTS, **LINE_FAULTS},
        "camera": CAMERA_FAULTS,
        "frame-camera": _FRAME_CAMERA,
        "mount": MOUNT_FAULTS,
        "lens": LENS_FAULTS,
    }
    if device not in by_device:
        raise ConfigError(
            f"Unknown device {device!r}.", where="device", remedy=f"Use one of: {', '.join(by_device)}."
        )
    return by_device[device]


def fault_order_from_text(text: str) -> FaultOrder:
    """Read an order from text.

    >>> fault_order_from_text("pan stall share=0.3").parameters
    {'share': 0.3, 'skip': 0}
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ConfigError(
            f"Cannot read the order: {error}.", where=text.strip(), remedy="Close each quotation mark."
        ) from error
    if len(words) < 2 or any("=" not in word for word in words[2:]):
        raise ConfigError(
            "The order is not complete, or a parameter is not of the form name=value.",
            where=text.strip(),
            remedy="Give a device, a fault and its parameters, as in: pan stall share=0.3",
        )
    given = dict(word.split("=", 1) for word in words[2:])
    return fault_order({"device": words[0], "fault": words[1], **given})


def fault_order(given: Mapping[str, Any]) -> FaultOrder:
    """Check an order, given as a mapping whose values may be text; `ConfigError` names the key in ``where``."""
    for key in ("device", "fault"):
        if not isinstance(given.get(key), str):
            raise ConfigError(
                "The key is missing, or its value is not text.",
                where=key,
                remedy=f"Give the name of the {key}.",
            )
    device, fault = given["device"], given["fault"]
    known = faults_of(device)
    if fault not in known:
        raise ConfigError(
            f"Unknown fault {fault!r} of {device}.",
            where="fault",
            remedy=f"Use one of: {', '.join(known)}.",
        )
    defaults = {"after_s": 0.0, **known[fault].parameters}
    values = dict(defaults)
    for key, value in given.items():
        if key in {"device", "fault"}:
            continue
        if key not in defaults:
            raise ConfigError("Unknown key.", where=key, remedy=f"Use one of: {', '.join(defaults)}.")
        values[key] = _like(defaults[key], value, key)
    after_s = float(values.pop("after_s"))
    return FaultOrder(device, fault, values, after_s)


def _like(default: Parameter, value: object, where: str) -> Parameter:
    """Convert a value, which may be text, to the type of its default."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise ConfigError(f"Expected a number or text, got {value!r}.", where=where)
    try:
        return type(default)(value)
    except (ValueError, OverflowError):
        raise ConfigError(f"Expected a number, got {value!r}.", where=where) from None


def print_answer(content: Mapping[str, Any]) -> None:
    """Write one line of JSON to standard output, and flush it."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def told_to_stop() -> threading.Event:
    """Return what is set when the process is told to stop. Call this before orders are read.

    The process may run on in the background of a terminal, which otherwise stops it when it reads.
    """
    ending = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda _number, _frame: ending.set())
    if hasattr(signal, "SIGTTIN"):
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    return ending


def take_orders(carry_out: Callable[[str], Mapping[str, Any]], ended: Callable[[], None]) -> None:
    """Read orders until the input ends; the answer is what ``carry_out`` returns, or the error that it raises."""
    waiting = b""
    while heard := _read():
        *lines, waiting = (waiting + heard).split(b"\n")
        for line in lines:
            text = line.decode("utf-8", "replace").strip()
            if not text:
                continue
            try:
                print_answer({"ok": True, **carry_out(text)})
            except (SimulatorError, ValueError) as error:
                print_answer({"ok": False, "error": str(error)})
    ended()


def _read() -> bytes:
    """Read from standard input; return nothing if it cannot be read."""
    try:
        # Not sys.stdin: this thread would hold its lock while the interpreter shuts down.
        return os.read(0, 4096)
    except OSError:
        return b""
