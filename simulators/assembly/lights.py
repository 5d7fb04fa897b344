"""Builds the simulated driver of the light from its configuration.

This module knows which device each kind of light stands for; the devices' protocols are in `simulators.lights`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from simulators.config import LightConfig
from simulators.faults.fault_injection import Light
from simulators.lights.gardasoft import GardasoftRt
from simulators.lights.microcontroller import MicrocontrollerLight
from simulators.lights.scpi_generator import GeneratorModel, ScpiGenerator
from simulators.lights.siglent_generator import SiglentGenerator
from simulators.ports.serial_device import Dialect
from simulators.world.world import LightState


class LightDriver(Dialect, Light, Protocol):
    """A light's driver: it answers on a port, and faults can be injected into it."""


def make_light(
    config: LightConfig, clock: Callable[[], float], drive: Callable[[LightState], None]
) -> LightDriver:
    """Build the driver of a light.

    clock: Returns the time in seconds.
    """
    if config.kind == "gardasoft":
        return GardasoftRt(clock, drive)
    if config.kind == "microcontroller":
        return MicrocontrollerLight(config.serial, clock, drive)
    if config.kind == "siglent":
        return SiglentGenerator(config.serial, clock, drive)
    if config.kind == "rigol":
        model = GeneratorModel(
            config.serial,
            "Rigol Technologies",
            "DG4062",
            "00.01.12",
            config.error_queue,
            numbered_channels=True,
        )
    else:
        model = GeneratorModel(config.serial, error_queue=config.error_queue)
    return ScpiGenerator(model, clock, drive)
