r"""Simulated controllers chained on one line, which speak the Zaber ASCII protocol: frames, addresses, ids, checksums.

    /device axis id words:LRC\n         a request; device 0 addresses all, id and checksum are optional
    @dd axis id OK|RJ BUSY|IDLE WW data:LRC\r\n     a reply, with the id of its request
    !dd axis BUSY|IDLE WW:LRC\r\n                   an alert, sent unasked at the end of a motion

The checksum (LRC) is the two's complement of the sum of all bytes between the first character and the colon.
A request with a wrong checksum is not answered. `zaber_controller` executes the commands.

Reference: Zaber's ASCII Protocol Manual, firmware 7.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

from simulators.stages.zaber_controller import CommandRejected, ZaberController

#: Longest request, bytes; longer ones are dropped.
_MAX_REQUEST = 80

_END_OF_LINE = re.compile(rb"[\r\n]+")


class Request(NamedTuple):
    """A parsed request."""

    # device, axis: Address; 0 stands for all.
    device: int
    axis: int
    message_id: str | None  # Two digits; None if the request has no id
    words: list[str]


def checksum(body: str) -> str:
    """Return the longitudinal redundancy check (LRC) of a message.

    body: Message without its first character, ASCII.

    Examples
    --------
    >>> checksum("1 1 03 home")
    '32'
    """
    return f"{-sum(body.encode('ascii')) & 0xFF:02X}"


def parse_request(line: bytes) -> Request | None:
    """Parse a line.

    line: Line without its end.
    Returns: None if a controller does not answer the line: noise, or a wrong checksum.

    Examples
    --------
    >>> parse_request(b"/1 1 05 move abs 50000:B7")
    Request(device=1, axis=1, message_id='05', words=['move', 'abs', '50000'])
    >>> parse_request(b"/1 1 05 move abs 50001:B7") is None
    True
    """
    _, slash, rest = line.rpartition(b"/")
    if not slash or len(line) > _MAX_REQUEST or not rest.isascii():
        return None
    body, colon, given = rest.decode("ascii").partition(":")
    if colon and given.strip().upper() != checksum(body):
        return None
    words = body.split()
    numbers = 0
    while numbers < 3 and numbers < len(words) and words[numbers].isdigit():
        numbers += 1
    device, axis = ([int(word) for word in words[: min(numbers, 2)]] + [0, 0])[:2]
    message_id = f"{int(words[2]) % 100:02d}" if numbers == 3 else None
    return Request(device, axis, message_id, words[numbers:])


class ZaberChain:
    """Controllers on one line, as a dialect of it.

    controllers: Controllers in the order of their addresses, from 1.
    clock: Returns the time in seconds.
    """

    def __init__(self, controllers: Sequence[ZaberController], clock: Callable[[], float]) -> None:
        self.controllers = tuple(controllers)
        self._clock = clock
        self._buffer = b""

    @property
    def baud(self) -> int:
        """Default baud rate of the family."""
        return 115_200

    def receive(self, data: bytes) -> bytes:
        """See `Dialect.receive`."""
        *lines, self._buffer = _END_OF_LINE.split(self._buffer + data)
        self._buffer = self._buffer[-2 * _MAX_REQUEST :]
        return b"".join(self._answers(line) for line in lines)

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. These are alerts at the end of motions."""
        now = self._clock()
        return b"".join(
            _frame("!", f"{address:02d} 1 {controller.status(now)} {_flag(controller, now)}", controller)
            for address, controller in enumerate(self.controllers, start=1)
            if controller.awake(now) and controller.came_to_rest(now)
        )

    def _answers(self, line: bytes) -> bytes:
        request = parse_request(line)
        if request is None:
            return b""
        return b"".join(
            self._answer(address, controller, request)
            for address, controller in enumerate(self.controllers, start=1)
            if request.device in {0, address} and controller.awake(self._clock())
        )

    def _answer(self, address: int, controller: ZaberController, request: Request) -> bytes:
        now = self._clock()
        try:
            verdict, data = "OK", controller.execute(request.axis, request.words, now)
        except CommandRejected as refusal:
            verdict, data = "RJ", refusal.reason
        message_id = f"{request.message_id} " if request.message_id else ""
        status = f"{verdict} {controller.status(now)} {_flag(controller, now)}"
        return _frame("@", f"{address:02d} {request.axis} {message_id}{status} {data}", controller)


def _flag(controller: ZaberController, now: float) -> str:
    """Return the highest warning flag, or "--"."""
    return (controller.warnings(now) or ["--"])[0]


def _frame(kind: str, body: str, controller: ZaberController) -> bytes:
    end = f":{checksum(body)}" if controller.checksums else ""
    return f"{kind}{body}{end}\r\n".encode("ascii")
