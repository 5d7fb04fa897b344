"""A function generator on a serial line: the part that all makes share.

Messages end in a line feed and have a limited length. Subclasses execute the commands of a make; `generator` holds
the instrument itself.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Final

from simulators.lights.generator import Generator
from simulators.world.world import LightState

#: Size of the input buffer, bytes.
_MAX_MESSAGE: Final = 2048


class GeneratorLine(ABC):
    """Base class of the generators: a dialect of a serial line.

    clock: Returns the time in seconds.
    """

    def __init__(self, clock: Callable[[], float], drive: Callable[[LightState], None]) -> None:
        self._generator = Generator(clock, drive)
        self._buffer = b""

    @property
    @abstractmethod
    def baud(self) -> int:
        """Baud rate of the serial port."""

    @abstractmethod
    def exchange(self, serial: str) -> None:
        """Replace the instrument by another one of this model, fresh from power-up."""

    @abstractmethod
    def _execute(self, message: str) -> list[str]:
        """Execute a message and return its answers, one a line."""

    def receive(self, data: bytes) -> bytes:
        """See `Dialect.receive`."""
        *messages, self._buffer = (self._buffer + data).split(b"\n")
        self._buffer = self._buffer[-_MAX_MESSAGE:]
        answers = [
            answer for message in messages for answer in self._execute(message.decode("ascii", "replace"))
        ]
        return b"".join(f"{answer}\n".encode("ascii") for answer in answers)

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. A generator sends nothing unasked."""
        return b""

    def clip(self, most_v: float | None) -> None:
        """See `Generator.clip`."""
        self._generator.clip(most_v)

    def trip(self) -> None:
        """See `Generator.trip`."""
        self._generator.trip()
