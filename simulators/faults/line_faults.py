"""Faults of a serial line, between any two ends: replies lost, late, cut, garbled, doubled, and their like.

Knows bytes and messages, where a message is what a device gives at once; no protocol and no device. A
`FaultLine` stands in front of a simulated device, or of a real one behind a `SerialBridge`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import serial

from simulators.errors import SimulatorError
from simulators.faults.guarded_replies import missing_checksum, wrong_checksum, wrong_id
from simulators.ports.serial_device import Dialect


@dataclass(frozen=True)
class LineFault:
    """What is to go wrong with messages to come.

    Attributes
    ----------
    kind
        One of `REPLY_FAULTS` or `REQUEST_FAULTS`; ``stale``: the reply of before comes in place of this one; or
        ``any``: one of the reply faults that need no text, drawn for each message.
    count
        How many messages it befalls; None for all from then on.
    skip
        Messages to let pass before.
    chance
        Probability with which a message is befallen; those spared do not count.
    delay_s
        How late a late reply is.
    pattern, replacement
        Regular expression that ``replaced`` looks for in a message, and what it puts there.
    """

    kind: str
    count: int | None = 1
    skip: int = 0
    chance: float = 1.0
    delay_s: float = 0.5
    pattern: bytes = b""
    replacement: bytes = b""


#: What reaches the host of one message: pieces, each with its delay.
Pieces = list[tuple[float, bytes]]


def _garbled(_fault: LineFault, reply: bytes, rng: np.random.Generator) -> Pieces:
    """Flip one bit of one byte."""
    spoilt = bytearray(reply)
    spoilt[rng.integers(len(reply))] ^= 1 << int(rng.integers(8))
    return [(0.0, bytes(spoilt))]


def _nul(_fault: LineFault, reply: bytes, rng: np.random.Generator) -> Pieces:
    """Slip a NUL in, as a disturbed line does."""
    at = int(rng.integers(len(reply) + 1))
    return [(0.0, reply[:at] + b"\0" + reply[at:])]


def _truncated(_fault: LineFault, reply: bytes, rng: np.random.Generator) -> Pieces:
    """Cut the end off."""
    return [(0.0, reply[: int(rng.integers(len(reply)))])]


def _split(fault: LineFault, reply: bytes, _rng: np.random.Generator) -> Pieces:
    """Give the second half late."""
    half = len(reply) // 2
    return [(0.0, reply[:half]), (fault.delay_s, reply[half:])]


#: What a device of another kind says, whatever it is asked.
_STRANGE: Final = b"?READY\r\n"

#: What befalls a reply, by name.
REPLY_FAULTS: Final[Mapping[str, Callable[[LineFault, bytes, np.random.Generator], Pieces]]] = {
    "lost": lambda _fault, _reply, _rng: [],
    "late": lambda fault, reply, _rng: [(fault.delay_s, reply)],
    "truncated": _truncated,
    "garbled": _garbled,
    "nul": _nul,
    "doubled": lambda _fault, reply, _rng: [(0.0, reply + reply)],
    "split": _split,
    "replaced": lambda fault, reply, _rng: [(0.0, re.sub(fault.pattern, fault.replacement, reply))],
    "preceded": lambda fault, reply, _rng: [(0.0, fault.replacement + reply)],
    "wrong_checksum": lambda _fault, reply, _rng: [(0.0, wrong_checksum(reply))],
    "missing_checksum": lambda _fault, reply, _rng: [(0.0, missing_checksum(reply))],
    "wrong_id": lambda _fault, reply, _rng: [(0.0, wrong_id(reply))],
    "stranger": lambda _fault, _reply, _rng: [(0.0, _STRANGE)],
}

#: What befalls a request, by name.
REQUEST_FAULTS: Final = ("request_lost", "request_garbled", "echo")

#: Reply faults that ``any`` draws from: those that need no text.
_DRAWN: Final = ("lost", "late", "truncated", "garbled", "nul", "doubled", "split")


class FaultLine:
    """A line on which things go wrong, in front of a device.

    Parameters
    ----------
    device
        Who is at the other end.
    clock
        Time in seconds.
    rng
        Where chance comes from.
    """

    def __init__(self, device: Dialect, clock: Callable[[], float], rng: np.random.Generator) -> None:
        self._device = device
        self._clock = clock
        self._rng = rng
        self._faults: list[LineFault] = []
        self._last_reply = b""
        self._delayed: list[tuple[float, bytes]] = []
        self._scheduled: list[tuple[float, Callable[[], None]]] = []
        self._other_baud: int | None = None

    @property
    def baud(self) -> int:
        """Baud rate of the device."""
        return self._device.baud if self._other_baud is None else self._other_baud

    @property
    def faults(self) -> tuple[LineFault, ...]:
        """What is still to go wrong."""
        return tuple(self._faults)

    def inject(self, fault: LineFault) -> None:
        """Let something go wrong with messages to come.

        Raises
        ------
        SimulatorError
            When there is no such fault.
        """
        known = [*REPLY_FAULTS, *REQUEST_FAULTS, "stale", "any"]
        if fault.kind not in known:
            raise SimulatorError(f"No line fault {fault.kind!r}.", remedy=f"Known are: {', '.join(known)}.")
        self._faults.append(fault)

    def say(self, text: bytes) -> None:
        """Let the host hear something that nobody has asked for."""
        self._delayed.append((self._clock(), text))

    def listen_at(self, baud: int) -> None:
        """Have the device listen at another baud rate."""
        self._other_baud = baud

    def schedule(self, t_s: float, act: Callable[[], None]) -> None:
        """Have something done at a time, between two exchanges."""
        self._scheduled.append((t_s, act))

    def clear(self) -> None:
        """Let nothing more go wrong; what is late still comes."""
        self._faults.clear()
        self._scheduled.clear()
        self._other_baud = None

    def receive(self, data: bytes) -> bytes:
        """Take bytes of the host and give what reaches it at once."""
        self._run_scheduled()
        echoed = b""
        for fault in self._due(data, REQUEST_FAULTS):
            if fault.kind == "request_lost":
                return b""
            if fault.kind == "echo":
                echoed = data
            else:
                data = _garbled(fault, data, self._rng)[0][1]
        return echoed + self._apply_reply_faults(self._device.receive(data))

    def unsolicited(self) -> bytes:
        """Give what comes late, and what the device says of its own accord."""
        self._run_scheduled()
        now = self._clock()
        due = b"".join(piece for moment, piece in self._delayed if moment <= now)
        self._delayed = [(moment, piece) for moment, piece in self._delayed if moment > now]
        return due + self._apply_reply_faults(self._device.unsolicited())

    def _run_scheduled(self) -> None:
        """Do what is due by now."""
        now = self._clock()
        due = [act for t_s, act in self._scheduled if t_s <= now]
        self._scheduled = [(t_s, act) for t_s, act in self._scheduled if t_s > now]
        for act in due:
            act()

    def _apply_reply_faults(self, reply: bytes) -> bytes:
        pieces: Pieces = [(0.0, reply)]
        last, self._last_reply = self._last_reply, reply or self._last_reply
        for fault in self._due(reply, (*REPLY_FAULTS, "stale", "any")):
            if fault.kind == "stale":
                pieces = [(0.0, last)]
                continue
            kind = fault.kind if fault.kind != "any" else str(self._rng.choice(_DRAWN))
            pieces = [
                (delay + more, part)
                for delay, piece in pieces
                if piece
                for more, part in REPLY_FAULTS[kind](fault, piece, self._rng)
            ]
        now = self._clock()
        self._delayed += [(now + delay, piece) for delay, piece in pieces if delay > 0.0]
        return b"".join(piece for delay, piece in pieces if delay <= 0.0)

    def _due(self, message: bytes, kinds: tuple[str, ...]) -> list[LineFault]:
        """Faults of these kinds that befall a message, counted down."""
        due: list[LineFault] = []
        left: list[LineFault] = []
        for fault in self._faults:
            if not message or fault.kind not in kinds or self._rng.random() >= fault.chance:
                left.append(fault)
            elif fault.skip > 0:
                left.append(replace(fault, skip=fault.skip - 1))
            else:
                due.append(fault)
                if fault.count is None:
                    left.append(fault)
                elif fault.count > 1:
                    left.append(replace(fault, count=fault.count - 1))
        self._faults = left
        return due


class SerialBridge:
    """A real device behind a port, as the far end of a line.

    Parameters
    ----------
    port
        Its port, as pyserial names it.
    baud
        Its baud rate.

    Raises
    ------
    SimulatorError
        When the port cannot be opened.
    """

    def __init__(self, port: str, baud: int) -> None:
        try:
            self._port = serial.serial_for_url(port, baud, timeout=0)
        except serial.SerialException as error:
            raise SimulatorError(f"The port cannot be opened: {error}.", where=port) from error
        self._baud = baud

    @property
    def baud(self) -> int:
        """Baud rate of the device, and asked of the host."""
        return self._baud

    def receive(self, data: bytes) -> bytes:
        """Pass bytes on to the device; what it answers comes as it comes."""
        self._port.write(data)
        return b""

    def unsolicited(self) -> bytes:
        """Give what the device has said by now."""
        heard: bytes = self._port.read(4096)
        return heard

    def close(self) -> None:
        """Give the port back."""
        self._port.close()
