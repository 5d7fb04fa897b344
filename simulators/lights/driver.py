"""What all simulated drivers of a light share: messages on a serial line, and a light whose phase goes on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from simulators.errors import ConfigError
from simulators.world.world import LightState


class LightDriver(ABC):
    """A driver of the bench's light, as a dialect of a serial line; ``drive`` is called with each new state.

    ``ends`` end a message, ``ignored`` are dropped; ``longest`` is the length of the input buffer, bytes.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        drive: Callable[[LightState], None],
        *,
        baud: int = 115_200,
        ends: bytes = b"\n",
        ignored: bytes = b"",
        longest: int,
    ) -> None:
        self._clock = clock
        self._drive = drive
        self.baud = baud
        self._ends, self._ignored, self._longest = ends, ignored, longest
        self._buffer = b""
        self._light = LightState(origin_s=clock())

    @abstractmethod
    def _answer(self, message: bytes) -> bytes:
        """Carry out a message, which comes without its end, and return all that answers it."""

    #: What another program can leave behind, as `leave` takes it.
    LEFT: tuple[str, ...] = ()

    def leave(self, what: str) -> None:
        """Set what another program left behind, one of `LEFT`."""
        raise ConfigError(
            f"{what!r} cannot be left behind in this light.",
            where="light.left_behind",
            remedy=f"Known are: {', '.join(self.LEFT) or 'none'}.",
        )

    @abstractmethod
    def clip(self, most_v: float | None) -> None:
        """Limit levels from now on, V; None: the normal limit. For a light without volts `FULL_DRIVE_V` is 100 %."""

    @abstractmethod
    def trip(self) -> None:
        """Let a protection switch the light off."""

    @abstractmethod
    def exchange(self, serial: str) -> None:
        """Replace the driver by another one of its kind, fresh from power-up."""

    def receive(self, data: bytes) -> bytes:
        """See `Dialect.receive`."""
        *messages, rest = (self._buffer + data.translate(None, self._ignored)).split(self._ends)
        self._buffer = rest[-self._longest :]
        return b"".join(self._answer(message) for message in messages)

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. Most drivers say nothing unasked."""
        return b""

    def _show(self, frequency_hz: float, **state: Any) -> None:
        """Publish the state of the light; its phase goes on as in a synthesiser."""
        now = self._clock()
        origin_s = now - self._light.phase_at(now) / frequency_hz
        self._light = LightState(frequency_hz=frequency_hz, origin_s=origin_s, **state)
        self._drive(self._light)
