"""Simulated drivers of lights of every family without terminals, on a clock that only the driver's waits turn."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.stations.station_text import find_description
from bench.stations.text_descriptions import LightProtocol
from drivers.light import Light
from drivers.light.gardasoft import GardasoftLight
from drivers.light.scpi import ScpiLight
from drivers.light.text import TextLight
from sequences.reader import read_document
from simulators.assembly import make_light
from simulators.config import LightConfig
from simulators.faults.line_faults import FaultLine
from simulators.lights.driver import LightDriver
from simulators.lights.lamp import Lamp
from simulators.world.world import LightState
from tests.hil.direct_stages import DirectLine, VirtualClock, order_fault


@dataclass
class DirectLight:
    """A light, its line, its simulated driver, and what the lamp was driven to, in turn."""

    kind: str
    light: Light
    line: DirectLine
    driver: LightDriver
    lamp: Lamp
    states: list[LightState]

    def order(self, text: str) -> None:
        """Let something go wrong, as it is ordered on a bench."""
        order_fault("light", self.line, f"light {text}", {}, self.driver, self.lamp)


class LightAlone:
    """A simulated driver without ours, on a clock that the test advances, with all states that it gave the lamp."""

    def __init__(self, make: Callable[..., Any], line_end: str) -> None:
        self.now_s, self._line_end = 100.0, line_end
        self.states: list[LightState] = []
        self.device = make(lambda: self.now_s, self.states.append)

    def say(self, *messages: str) -> str:
        """Send messages and return all answers."""
        lines = (f"{message}{self._line_end}".encode() for message in messages)
        return "".join(self.device.receive(line).decode() for line in lines)

    @property
    def light(self) -> LightState:
        return self.states[-1]


MICROCONTROLLER = read_document(
    find_description("microcontroller_light", None), LightProtocol
).value.for_driver()

OPENED: dict[str, Callable[..., Light]] = {
    "keysight": lambda line, clock: ScpiLight(line, serial="SG0042", clock=clock),
    "rigol": lambda line, clock: ScpiLight(line, serial="SG0042", clock=clock, dialect="numbered"),
    "siglent": lambda line, clock: ScpiLight(line, serial="SG0042", clock=clock, dialect="siglent"),
    "gardasoft": lambda line, clock: GardasoftLight(line, clock=clock),
    "microcontroller": lambda line, clock: TextLight(line, MICROCONTROLLER, serial="SG0042", clock=clock),
}


def direct_light(kind: str, clock: VirtualClock, rng: np.random.Generator) -> DirectLight:
    """Open a light of that kind on a line of faults without faults yet."""
    states: list[LightState] = []
    lamp = Lamp(states.append)
    driver = make_light(LightConfig(kind), clock.monotonic, lamp.drive)
    line = DirectLine(FaultLine(driver, clock.monotonic, rng), clock)
    return DirectLight(kind, OPENED[kind](line, clock), line, driver, lamp, states)
