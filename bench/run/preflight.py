"""Checks before anything moves: identity of the devices, camera settings, reported faults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

from bench.base.errors import PreflightFailed
from bench.plan.job import Job
from bench.stations.devices import Devices
from drivers.camera import CameraIdentity
from drivers.camera.usb_permission import LEAST_MBIT_S
from drivers.light import Light, StatesSyncPolarity

OPTIONAL: Final = ("firmware_built", "link_mbit_s")
"""Parts of a camera's identity that are left out where the camera does not state them."""
NOT_STATED: Final = "not stated by the device"


def preflight(devices: Devices, job: Job) -> dict[str, Any]:
    """Identify the devices, set the camera, and collect every reason against a run.

    Nothing moves and the light stays off.

    devices: Open devices; their serial numbers were compared with the station file when they were opened.
    Returns: ``camera``, ``stage`` (a list) and ``light``: identities; ``camera_settings``: settings as read
      back; ``connections``, of an event camera: see `connections`.
    Raises PreflightFailed: With every reason at once.
    Raises drivers.errors.DriverError: If a device does not answer, or is not the one that the station file
      names.
    """
    stage, light = devices.stage.identify(), devices.light.identify()
    camera = devices.camera.identify()
    devices.light.off()
    settings, camera_reasons = job.camera_kind.prepare(devices.camera)
    # An axis that is not homed warns about that; the stage's faults are then read after homing.
    reasons = stage_faults(devices) if devices.stage.is_homed() else []
    reasons += [f"light: {fault}" for fault in devices.light.faults()]
    reasons += camera_reasons
    if reasons:
        raise PreflightFailed(
            f"The bench is not ready: {'; '.join(reasons)}.",
            remedy="Correct this and run again; nothing has moved.",
        )
    stated = {name: value for name, value in asdict(camera).items() if name not in OPTIONAL or value}
    found = {
        "camera": {**stated, "lens": job.lens},
        "stage": [asdict(axis) for axis in stage],
        "light": asdict(light),
        "camera_settings": settings,
    }
    if job.camera_kind.name == "event":
        found["connections"] = connections(camera, settings, devices.light)
    return found


def connections(camera: CameraIdentity, settings: Mapping[str, Any], light: Light) -> dict[str, str]:
    """Return what camera and light answer about the cables between them and to the computer.

    light: The open light. A generator's sync polarity is made normal.
    Returns: In words: ``camera_link``, ``camera_firmware``, ``trigger_input``, ``sync_polarity``,
      ``sync_level``. What a device does not state is said to be so; the wiring test (`bench.run.wiring`)
      measures it.
    """
    link = camera.link_mbit_s
    built = f", built {camera.firmware_built}" if camera.firmware_built else ""
    return {
        "camera_link": f"{link} Mbit/s ({'USB 3' if link >= LEAST_MBIT_S else 'USB 2'})"
        if link
        else NOT_STATED,
        "camera_firmware": f"{camera.firmware}{built}" if camera.firmware else NOT_STATED,
        "trigger_input": "on" if settings.get("trigger_in") else "off",
        "sync_polarity": light.sync_polarity() if isinstance(light, StatesSyncPolarity) else NOT_STATED,
        "sync_level": NOT_STATED,
    }


def stage_faults(devices: Devices) -> list[str]:
    """Read the faults and warnings of the stage.

    Returns: One text per fault; empty if there are none.
    """
    return [f"stage: {fault}" for fault in devices.stage.faults()]


def require_no_faults(reasons: list[str]) -> None:
    """Raise an error if there is any reason against continuing.

    Raises PreflightFailed: With every reason, if there is at least one.
    """
    if reasons:
        raise PreflightFailed(
            f"The bench is not ready: {'; '.join(reasons)}.",
            remedy="Correct this first.",
        )
