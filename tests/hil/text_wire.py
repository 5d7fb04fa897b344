"""A fake controller that answers lines of text, and an axis that it moves: for tests of a user's description."""

import re
from collections.abc import Callable
from pathlib import Path

from tests.hil.direct_stages import TurningPort, VirtualClock

SPEED = 20.0
"""Degrees a second of all these stages."""


def described(device: str) -> Path:
    """Return the description of a device, as a user has written it from the maker's manual."""
    return Path(__file__).parents[1] / "data" / "descriptions" / f"{device}.yaml"


class Motor:
    """An axis that moves at one speed; degrees."""

    def __init__(self, clock: VirtualClock, start_deg: float = 2.0) -> None:
        self.clock = clock
        self.from_deg = self.to_deg = start_deg
        self.began_s = 0.0

    def move(self, to_deg: float) -> None:
        self.from_deg, self.to_deg, self.began_s = self.position_deg, to_deg, self.clock.now_s

    def stop(self) -> None:
        self.move(self.position_deg)

    @property
    def position_deg(self) -> float:
        way_deg = self.to_deg - self.from_deg
        done_deg = min(abs(way_deg), SPEED * (self.clock.now_s - self.began_s))
        return self.from_deg + (done_deg if way_deg > 0 else -done_deg)

    @property
    def is_busy(self) -> bool:
        return self.position_deg != self.to_deg


class Wire(TurningPort):
    """A port to a fake controller: requests with an end, replies at once, and what comes later unasked."""

    name = "wire"

    def __init__(self, clock: VirtualClock, end: re.Pattern[bytes]) -> None:
        self.clock, self._end = clock, end
        self.buffer = self.ready = b""
        self.sent: list[str] = []
        self.answer: Callable[[str], str] = lambda _request: ""
        self.unasked: Callable[[], str] = lambda: ""
        self.known: dict[str, str] = {}
        """What the controller keeps, by the command that sets it."""

    def write(self, data: bytes) -> None:
        self.buffer += data
        while match := self._end.match(self.buffer):
            self.buffer = self.buffer[match.end() :]
            request = match[1].decode()
            self.sent.append(request)
            self.ready += self.answer(request).encode()

    def hear(self) -> None:
        self.ready += self.unasked().encode()


LINES = re.compile(rb"([^\r\n]*)[\r\n]+")
