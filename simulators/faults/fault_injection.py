"""Injection of ordered faults into a running bench.

The module decides which part of the bench an order affects. The parts implement the faults themselves: axes
(`axis_motion`), lines (`line_faults`), the lamp, the controllers and the cameras.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import cast

from simulators.cameras.evk4 import SimulatedEvk4
from simulators.cameras.frame_camera import SimulatedFrameCamera
from simulators.cameras.streaming import StreamFault
from simulators.errors import ConfigError
from simulators.faults.camera_hands import HAND_DEVICES, CameraHands
from simulators.faults.catalogue import LIGHT_FAULTS, FaultOrder, Parameter
from simulators.faults.line_faults import FaultLine, LineFault
from simulators.lights.driver import LightDriver
from simulators.lights.lamp import Lamp
from simulators.ports.serial_device import SerialDevice
from simulators.stages.axis_motion import AxisOfController, FaultKind, MotionFault, SingleController
from simulators.stages.zaber import ZaberController

AxisController = SingleController | ZaberController | AxisOfController
"""What controls one axis: alone, or beside others."""


@dataclass(frozen=True)
class BenchParts:
    """The parts of a bench that can have faults."""

    axes: Mapping[str, AxisController]
    ports: Mapping[str, SerialDevice]
    lines: Mapping[str, FaultLine]
    axis_ports: Mapping[str, str]
    light: LightDriver  # Driver of the light
    lamp: Lamp  # Lamp behind the driver
    camera: SimulatedEvk4  # Event camera
    clock: Callable[[], float]  # Returns the time in seconds
    frame_camera: SimulatedFrameCamera | None = None  # The frame camera; None if the bench has none
    hands: CameraHands | None = None  # Hands at the camera's mount and lens; None if they cannot be changed


def fault_action(order: FaultOrder, parts: BenchParts) -> Callable[[], None]:
    """Return the call that injects a fault."""
    if order.device in parts.ports:
        return _on_port(order, parts)
    if order.device == "camera":
        return _on_camera(order, parts.camera)
    if order.device == "frame-camera" and (frame_camera := parts.frame_camera) is not None:
        return lambda: frame_camera.inject_fault(order.fault)
    if order.device in HAND_DEVICES and parts.hands is not None:
        return parts.hands.action(order)
    if order.device in parts.axes:
        name = parts.axis_ports[order.device]
        controller, port, line = parts.axes[order.device], parts.ports[name], parts.lines[name]
        from_outside: dict[str, Callable[[], None]] = {
            "unplug": port.unplug,
            "press_stop": lambda: controller.emergency_stop(parts.clock()),
        }
        act = from_outside.get(order.fault)
        then = None if act is None else lambda t_s: line.schedule(t_s, act)
        return lambda: port.between_exchanges(lambda: _on_axis(order, controller, parts.clock(), then))
    known = [
        *parts.axes,
        *parts.ports,
        "camera",
        *(["frame-camera"] if parts.frame_camera is not None else []),
        *(HAND_DEVICES if parts.hands is not None else ()),
    ]
    raise ConfigError(
        f"This bench has no device {order.device!r}.",
        where="device",
        remedy=f"Use one of: {', '.join(known)}.",
    )


def _on_camera(order: FaultOrder, camera: SimulatedEvk4) -> Callable[[], None]:
    if order.fault == "unplug":
        return camera.unplug
    if order.fault == "fault":
        return lambda: camera.report_fault(str(order.parameters["message"]))
    if order.fault == "mend":
        return camera.stream_faults.clear
    if order.fault == "overflow":
        return partial(setattr, camera.stream_faults, "overflows", True)
    fault = StreamFault(order.fault, int(order.parameters["skip"]), int(order.parameters["count"]))
    return lambda: camera.stream_faults.inject(fault)


def _on_port(order: FaultOrder, parts: BenchParts) -> Callable[[], None]:
    port = parts.ports[order.device]
    if order.fault in LIGHT_FAULTS:
        act = _on_light(order, parts)
        return lambda: port.between_exchanges(act)
    act = line_fault_action(order, port, parts.lines[order.device])
    if order.fault == "mend" and order.device == "light":

        def mend_both() -> None:
            act()
            port.between_exchanges(parts.lamp.clear_faults)
            port.between_exchanges(lambda: parts.light.clip(None))

        return mend_both
    return act


def line_fault_action(order: FaultOrder, port: SerialDevice, line: FaultLine) -> Callable[[], None]:
    """Return the call that injects a fault of a line."""
    if order.fault in {"unplug", "replug"}:
        return port.unplug if order.fault == "unplug" else port.replug
    act = _on_line(order, line)
    return lambda: port.between_exchanges(act)


def _on_line(order: FaultOrder, line: FaultLine) -> Callable[[], None]:
    if order.fault == "mend":
        return line.clear
    if order.fault == "baud":
        rate = int(order.parameters["rate"])
        return lambda: line.listen_at(rate)
    if order.fault == "say":
        text = _bytes(order.parameters["text"], "text")
        return lambda: line.say(text)
    fault = _line_fault(order)
    return lambda: line.inject(fault)


def _on_light(order: FaultOrder, parts: BenchParts) -> Callable[[], None]:
    if order.fault == "trip":
        return parts.light.trip
    if order.fault == "exchange":
        return lambda: parts.light.exchange(str(order.parameters["serial"]))
    if order.fault == "clip":
        most_v = float(order.parameters["most_v"])
        return lambda: parts.light.clip(most_v)
    factor = float(order.parameters.get("factor", 1.0))
    if factor <= 0.0:
        raise ConfigError(
            f"The factor {factor} is not positive.", where="factor", remedy="Give a factor greater than 0."
        )
    return lambda: parts.lamp.inject_fault(order.fault, factor)


def _line_fault(order: FaultOrder) -> LineFault:
    p = order.parameters
    try:
        re.compile(str(p["pattern"]).encode())
    except re.error as error:
        raise ConfigError(
            f"{p['pattern']!r} is not a regular expression: {error}.", where="pattern"
        ) from error
    return LineFault(
        order.fault,
        count=int(p["count"]) or None,
        skip=int(p["skip"]),
        chance=float(p["chance"]),
        delay_s=float(p["delay_s"]),
        pattern=str(p["pattern"]).encode(),
        replacement=_bytes(p["replacement"], "replacement"),
    )


def _bytes(text: Parameter, where: str) -> bytes:
    r"""Encode a text in which line ends and the like are written as ``\n``."""
    try:
        return str(text).encode("latin-1").decode("unicode_escape").encode("latin-1")
    except ValueError as error:
        raise ConfigError(f"Cannot convert {text!r} to bytes: {error}.", where=where) from error


def _on_axis(
    order: FaultOrder, controller: AxisController, now: float, then: Callable[[float], None] | None
) -> None:
    axis, p = controller.axis, order.parameters
    if "skip" in p:
        axis.arm(
            MotionFault(
                cast("FaultKind", order.fault),
                share=float(p.get("share", 1.0)),
                creep_deg_s=float(p.get("creep_deg_s", 0.0)),
                skip=int(p["skip"]),
                then=then,
            )
        )
    elif order.fault == "stuck_busy":
        axis.stuck_busy = True
    elif order.fault == "idle_flicker":
        axis.report_false_idle(int(p["times"]))
    elif order.fault == "push":
        axis.push(float(p["deg"]) * axis.mechanics.counts_per_deg, now)
    elif order.fault == "reboot":
        controller.restart(now)
    elif order.fault == "exchange":
        controller.exchange(str(p["serial"]), now)
    elif order.fault == "mend":
        axis.arm(None)
        axis.report_false_idle(0)
        axis.stuck_busy = False
    else:
        controller.emergency_stop(now, released=order.fault == "release")
