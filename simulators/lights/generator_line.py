"""A function generator on a serial line: what every make does there, whatever its commands.

Knows that messages end in a line feed and are bounded, and what befalls the instrument from outside; the
commands are the makes', the instrument itself is `generator`'s.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Final

from simulators.lights.generator import Generator
from simulators.world.world import LightState

#: Longest message the input buffer takes.
_MAX_MESSAGE: Final = 2048


class GeneratorLine(ABC):
    """A generator as a dialect of a serial line; a make gives its commands.

    Parameters
    ----------
    clock
        Time in seconds.
    drive
        Called with what the light does from now on, whenever that changes.
    """

    def __init__(self, clock: Callable[[], float], drive: Callable[[LightState], None]) -> None:
        self._generator = Generator(clock, drive)
        self._buffer = b""

    @property
    @abstractmethod
    def baud(self) -> int:
        """Baud rate of its serial port."""

    @abstractmethod
    def exchange(self, serial: str) -> None:
        """Be another instrument of this model from now on, fresh from power-up."""

    @abstractmethod
    def _execute(self, message: str) -> list[str]:
        """Obey a message and give its answers, a line each."""

    def receive(self, data: bytes) -> bytes:
        """Take bytes as they arrive and give what they ask for."""
        *messages, self._buffer = (self._buffer + data).split(b"\n")
        self._buffer = self._buffer[-_MAX_MESSAGE:]
        answers = [
            answer for message in messages for answer in self._execute(message.decode("ascii", "replace"))
        ]
        return b"".join(f"{answer}\n".encode("ascii") for answer in answers)

    def unsolicited(self) -> bytes:
        """Say nothing unasked."""
        return b""

    def clip(self, most_v: float | None) -> None:
        """Hold levels to come within less than usual, or no more."""
        self._generator.clip(most_v)

    def trip(self) -> None:
        """Have the overload protection switch the output off."""
        self._generator.trip()
