"""Checks before anything moves: identity of the devices, camera settings, reported faults."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from bench.base.errors import PreflightFailed
from bench.plan.job import Job
from bench.stations.devices import Devices


def preflight(devices: Devices, job: Job) -> dict[str, Any]:
    """Identify the devices, set the camera, and collect every reason against a run.

    Nothing moves and the light stays off.

    Parameters
    ----------
    devices
        Open devices; their serial numbers were compared with the station file when they were opened.
    job
        The task of the run.

    Returns
    -------
    dict
        ``camera``, ``stage`` (a list) and ``light``: identities; ``camera_settings``: settings as read back.

    Raises
    ------
    PreflightFailed
        With every reason at once.
    drivers.errors.DriverError
        If a device does not answer, or is not the one that the station file names.
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
    return {
        "camera": {**asdict(camera), "lens": job.lens},
        "stage": [asdict(axis) for axis in stage],
        "light": asdict(light),
        "camera_settings": settings,
    }


def stage_faults(devices: Devices) -> list[str]:
    """Read the faults and warnings of the stage.

    Parameters
    ----------
    devices
        Open devices.

    Returns
    -------
    list of str
        One text per fault; empty if there are none.
    """
    return [f"stage: {fault}" for fault in devices.stage.faults()]


def require_no_faults(reasons: list[str]) -> None:
    """Raise an error if there is any reason against continuing.

    Parameters
    ----------
    reasons
        Reasons against continuing.

    Raises
    ------
    PreflightFailed
        With every reason, if there is at least one.
    """
    if reasons:
        raise PreflightFailed(
            f"The bench is not ready: {'; '.join(reasons)}.",
            remedy="Correct this, then continue with `starbench resume`.",
        )
