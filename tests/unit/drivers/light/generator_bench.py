"""A simulated generator of each make on a line, and the driver for it."""

from collections.abc import Mapping

from drivers.light.scpi import ScpiLight
from drivers.light.scpi_dialects import DIALECTS, DialectName
from simulators.lights.generators import GeneratorModel, ScpiGenerator
from simulators.lights.siglent import SiglentGenerator
from simulators.world.world import LightState
from tests.hil.direct_stages import VirtualClock, direct_line


class Bench:
    """A generator on a line, and the driver for it."""

    def __init__(self, dialect: DialectName = "keysight", **model) -> None:
        self.clock = VirtualClock()
        self.dialect = dialect
        self.states: list[LightState] = []
        given = self.clock.monotonic, self.states.append
        if dialect == "siglent":
            self.device = SiglentGenerator("SG0042", *given, **model)
        else:
            model = GeneratorModel(numbered_channels=dialect == "numbered", **model)
            self.device = ScpiGenerator(model, *given)
        self.line = direct_line(self.device, self.clock)

    def open(self, **changes) -> ScpiLight:
        return ScpiLight(self.line, clock=self.clock, **{"dialect": self.dialect, **changes})

    def sent(self) -> list[str]:
        return [data.decode().rstrip("\n") for data in self.line.sent]

    def commands(self) -> list[str]:
        return [text for text in self.sent() if "?" not in text]

    def settings_sent(self) -> list[str]:
        """Commands that it was sent, those aside that end what somebody may have left on."""
        modes = DIALECTS[self.dialect].modes()
        ended = {command for mode in modes for command in mode.commands}
        return [command for command in self.commands() if command not in ended]

    def lit(self) -> bool:
        return self.states[-1].output

    def answer(self, answers: Mapping[str, str]) -> None:
        """Let queries have other answers."""
        self.line.spoil = lambda reply: (
            f"{answers[asked]}\n".encode() if (asked := self.sent()[-1].rstrip("?")) in answers else reply
        )
