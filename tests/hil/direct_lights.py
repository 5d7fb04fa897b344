"""Simulated drivers of lights of every family without terminals, on a clock that only the driver's waits turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.light import Light
from drivers.light.gardasoft import GardasoftLight
from drivers.light.scpi import ScpiLight
from simulators.config import LightConfig
from simulators.lights import LightDriver, make_light
from simulators.line_faults import FaultLine
from simulators.world import LightState
from tests.hil.direct_stages import DirectLine, VirtualClock


@dataclass
class DirectLight:
    """A light, its line, its simulated driver, and what the lamp was driven to, in turn."""

    light: Light
    line: DirectLine
    driver: LightDriver
    states: list[LightState]


OPENED: dict[str, Callable[..., Light]] = {
    "keysight": lambda line, clock: ScpiLight(line, serial="SG0042", clock=clock),
    "rigol": lambda line, clock: ScpiLight(line, serial="SG0042", clock=clock, dialect="numbered"),
    "siglent": lambda line, clock: ScpiLight(line, serial="SG0042", clock=clock, dialect="siglent"),
    "gardasoft": lambda line, clock: GardasoftLight(line, clock=clock),
}


def direct_light(kind: str, clock: VirtualClock, rng: np.random.Generator) -> DirectLight:
    """Open a light of that kind on a line of faults without faults yet."""
    states: list[LightState] = []
    driver = make_light(LightConfig(kind), clock.monotonic, states.append)
    line = DirectLine(FaultLine(driver, clock.monotonic, rng), clock)
    return DirectLight(OPENED[kind](line, clock), line, driver, states)
