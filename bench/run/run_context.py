"""What the parts of a run share: job, folder, journal, devices, interlocks and clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bench.base.clock import BenchClock
from bench.plan.job import Job
from bench.record.run_folder import RunFolder
from bench.record.run_log import RunLog
from bench.run.interlocks import (
    CameraTemperature,
    DeviceLost,
    DiskSpace,
    Door,
    EventRate,
    Interlock,
    Interlocks,
)
from bench.run.run_devices import RunDevices
from bench.solve.interim import Decide
from bench.solve.result import ResultWriter
from bench.stations.station_fields import InterlocksConfig


def interlocks_of(config: InterlocksConfig, folder: Path, devices: RunDevices) -> list[Interlock]:
    """Create the interlocks that the section ``interlocks`` of a station names. Their order is fixed."""
    interlocks: list[Interlock] = []
    if config.door is not None:
        interlocks.append(Door(config.door))
    if config.disk_space is not None:
        interlocks.append(DiskSpace(config.disk_space, folder))
    if config.camera_temperature is not None:
        interlocks.append(CameraTemperature(config.camera_temperature, devices.camera_c))
    if config.event_rate is not None:
        interlocks.append(EventRate(config.event_rate, devices.last_mev_s, devices.dark_mev_s))
    if config.device_lost is not None:
        interlocks.append(DeviceLost(config.device_lost, devices.reopen))
    return interlocks


@dataclass(frozen=True)
class RunContext:
    """One run, as its states and steps see it."""

    job: Job
    folder: RunFolder  # Locked by this process
    log: RunLog
    clock: BenchClock  # A requested stop ends the run safely
    devices: RunDevices
    interlocks: Interlocks
    results: ResultWriter
    decide: Decide  # Decides for the ``until`` steps
    say: Callable[[str], None]  # Shows a line to the operator
