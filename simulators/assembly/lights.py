"""The simulated lights' drivers that a bench can have, by kind, built from their configuration.

Knows which device a kind stands for; nothing of how one speaks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from simulators.config import LightConfig
from simulators.lights.gardasoft import GardasoftRt
from simulators.lights.scpi_generator import GeneratorModel, ScpiGenerator
from simulators.lights.siglent_generator import SiglentGenerator
from simulators.ports.serial_device import Dialect
from simulators.world.world import LightState


class LightDriver(Dialect, Protocol):
    """A light's driver: it answers on a port, and its protection may switch the light off."""

    def clip(self, most_v: float | None) -> None:
        """Hold levels to come within less than usual, or no more."""
        ...

    def trip(self) -> None:
        """Have the protection switch the light off."""
        ...

    def exchange(self, serial: str) -> None:
        """Be another driver from now on, fresh from power-up."""
        ...


def make_light(
    config: LightConfig, clock: Callable[[], float], drive: Callable[[LightState], None]
) -> LightDriver:
    """Build the driver of a light.

    Parameters
    ----------
    config
        Its kind and what it says it is.
    clock
        Time in seconds.
    drive
        Called with what the light does from now on, whenever that changes.
    """
    if config.kind == "gardasoft":
        return GardasoftRt(clock, drive)
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
