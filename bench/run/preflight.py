"""What must hold before anything moves: who answers, what they are set to, what faults they report."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from bench.base.errors import PreflightFailed
from bench.plan.job import Job
from bench.stations.devices import Devices


def preflight(devices: Devices, job: Job) -> dict[str, Any]:
    """Identify the devices, set the camera, and collect everything that stands against a run.

    Nothing moves and the light stays off.

    Parameters
    ----------
    devices
        Open devices; their serial numbers were compared with the station file's at opening.
    job
        What is to be run.

    Returns
    -------
    dict
        ``camera``, ``stage`` (a list) and ``light``: who they say they are; ``camera_settings`` as read back.

    Raises
    ------
    PreflightFailed
        With every reason at once.
    drivers.errors.DriverError
        When a device does not answer, or is another one than named.
    """
    stage, light = devices.stage.identify(), devices.light.identify()
    camera = devices.camera.identify()
    devices.light.off()
    settings, camera_reasons = job.camera_kind.prepare(devices.camera)
    # An axis without its reference warns of just that until it is homed; what is left is looked at afterwards.
    reasons = stage_faults(devices) if devices.stage.is_homed() else []
    reasons += [f"light: {fault}" for fault in devices.light.faults()]
    reasons += camera_reasons
    if reasons:
        raise PreflightFailed(
            f"The bench is not ready: {'; '.join(reasons)}.",
            remedy="Mend this and run again; nothing has moved.",
        )
    return {
        "camera": {**asdict(camera), "lens": job.lens},
        "stage": [asdict(axis) for axis in stage],
        "light": asdict(light),
        "camera_settings": settings,
    }


def stage_faults(devices: Devices) -> list[str]:
    """Ask the stage for its faults and warnings."""
    return [f"stage: {fault}" for fault in devices.stage.faults()]


def require_no_faults(reasons: list[str]) -> None:
    """Raise PreflightFailed with every reason, if there is one."""
    if reasons:
        raise PreflightFailed(
            f"The bench is not ready: {'; '.join(reasons)}.",
            remedy="Mend this, then go on with `starbench resume`.",
        )
