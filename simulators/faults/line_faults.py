"""Faults of a serial line between any two ends: replies lost, late, truncated, garbled, doubled, and others.

A message is what a device sends at once. A `FaultLine` stands in front of a simulated device, or, with a
`SerialBridge`, in front of a real one. Checksums and message ids are spoilt in replies of the Zaber ASCII protocol and
in answers of the XIMC protocol; all other replies pass unchanged.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import serial

from simulators.errors import SimulatorError
from simulators.ports.serial_device import Dialect
from simulators.stages.ximc import crc16

#: A reply line of the Zaber protocol: addresses, id, the rest, checksum.
_ZABER_REPLY: Final = re.compile(rb"@(\d\d \d )(\d\d)( [^:\r\n]*):[0-9A-F]{2}\r\n")

#: An answer of the XIMC protocol that carries data: four letters, data, CRC of two bytes.
_XIMC_ANSWER: Final = re.compile(rb"([a-z0-9]{4})(.+)..", re.DOTALL)
#: What the host receives of one message: pieces, each with its delay in seconds.
Pieces = list[tuple[float, bytes]]

#: Answer of a device of another kind to any request.
_STRANGE: Final = b"?READY\r\n"

#: Faults of a request, by name.
REQUEST_FAULTS: Final = ("request_lost", "request_garbled", "echo")

#: Reply faults from which ``any`` draws: those that need no text.
_DRAWN: Final = ("lost", "late", "truncated", "garbled", "nul", "doubled", "split")


def wrong_checksum(reply: bytes) -> bytes:
    r"""Replace the checksum by a wrong one.

    >>> wrong_checksum(b"@01 0 00 OK IDLE WR 0:BE\r\n")
    b'@01 0 00 OK IDLE WR 0:41\r\n'
    """
    if _ZABER_REPLY.search(reply):
        return _ZABER_REPLY.sub(
            lambda m: m[0][:-4] + b"%02X" % (int(m[0][-4:-2], 16) ^ 0xFF) + m[0][-2:], reply
        )
    if _has_valid_crc(reply):
        return reply[:-2] + bytes(byte ^ 0xFF for byte in reply[-2:])
    return reply


def missing_checksum(reply: bytes) -> bytes:
    r"""Remove the checksum.

    >>> missing_checksum(b"@01 0 00 OK IDLE WR 0:BE\r\n")
    b'@01 0 00 OK IDLE WR 0\r\n'
    """
    if _ZABER_REPLY.search(reply):
        return _ZABER_REPLY.sub(lambda m: m[0][:-5] + m[0][-2:], reply)
    return reply[:-2] if _has_valid_crc(reply) else reply


def wrong_id(reply: bytes) -> bytes:
    r"""Replace the message id by the next one, with a correct checksum; XIMC has no ids.

    >>> wrong_id(b"@01 0 00 OK IDLE WR 0:BE\r\n")
    b'@01 0 01 OK IDLE WR 0:BD\r\n'
    """

    def another(match: re.Match[bytes]) -> bytes:
        body = b"%s%02d%s" % (match[1], (int(match[2]) + 1) % 100, match[3])
        return b"@%s:%02X\r\n" % (body, -sum(body) & 0xFF)  # bytes, not text: they may be garbled already

    return _ZABER_REPLY.sub(another, reply)


def _has_valid_crc(reply: bytes) -> bool:
    """Return whether the last two bytes of an answer are the CRC of its data."""
    match = _XIMC_ANSWER.fullmatch(reply)
    return match is not None and crc16(match[2]).to_bytes(2, "little") == reply[-2:]


@dataclass(frozen=True)
class LineFault:
    """A fault of messages to come."""

    # One of `REPLY_FAULTS` or `REQUEST_FAULTS`; ``stale``: the previous reply arrives in place of this one;
    # or ``any``: one of the reply faults without text, drawn for each message.
    kind: str
    count: int | None = 1  # Number of messages to spoil; None for all from then on
    skip: int = 0  # Number of messages that pass unchanged first
    # Probability with which a message is affected; messages that are not affected do not count.
    chance: float = 1.0
    delay_s: float = 0.5  # Delay of a late reply, s
    pattern: bytes = b""  # Regular expression that ``replaced`` searches in a message
    replacement: bytes = b""  # What ``replaced`` writes in its place


def _garbled(_fault: LineFault, reply: bytes, rng: np.random.Generator) -> Pieces:
    """Flip one bit of one byte."""
    garbled = bytearray(reply)
    garbled[rng.integers(len(reply))] ^= 1 << int(rng.integers(8))
    return [(0.0, bytes(garbled))]


def _nul(_fault: LineFault, reply: bytes, rng: np.random.Generator) -> Pieces:
    """Insert a NUL, as a disturbed line does."""
    at = int(rng.integers(len(reply) + 1))
    return [(0.0, reply[:at] + b"\0" + reply[at:])]


def _truncated(_fault: LineFault, reply: bytes, rng: np.random.Generator) -> Pieces:
    """Cut off the end."""
    return [(0.0, reply[: int(rng.integers(len(reply)))])]


def _split(fault: LineFault, reply: bytes, _rng: np.random.Generator) -> Pieces:
    """Delay the second half."""
    half = len(reply) // 2
    return [(0.0, reply[:half]), (fault.delay_s, reply[half:])]


#: Faults of a reply, by name.
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


class FaultLine:
    """A line with injected faults, in front of a device."""

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
        """Faults that are still due."""
        return tuple(self._faults)

    def inject(self, fault: LineFault) -> None:
        """Add a fault for messages to come."""
        known = [*REPLY_FAULTS, *REQUEST_FAULTS, "stale", "any"]
        if fault.kind not in known:
            raise SimulatorError(
                f"Unknown line fault {fault.kind!r}.", remedy=f"Use one of: {', '.join(known)}."
            )
        self._faults.append(fault)

    def say(self, text: bytes) -> None:
        """Send the host an unsolicited text."""
        self._delayed.append((self._clock(), text))

    def listen_at(self, baud: int) -> None:
        """Let the device listen at another baud rate."""
        self._other_baud = baud

    def schedule(self, t_s: float, act: Callable[[], None]) -> None:
        """Schedule an action; it runs between two exchanges."""
        self._scheduled.append((t_s, act))

    def clear(self) -> None:
        """Remove all faults and scheduled actions; late replies still arrive."""
        self._faults.clear()
        self._scheduled.clear()
        self._other_baud = None

    def receive(self, data: bytes) -> bytes:
        """See `Dialect.receive`."""
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
        """See `Dialect.unsolicited`. Late replies are among the messages."""
        self._run_scheduled()
        now = self._clock()
        due = b"".join(piece for moment, piece in self._delayed if moment <= now)
        self._delayed = [(moment, piece) for moment, piece in self._delayed if moment > now]
        return due + self._apply_reply_faults(self._device.unsolicited())

    def _run_scheduled(self) -> None:
        """Run the actions that are due."""
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
        """Return the faults of these kinds that affect a message, and count them down."""
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
    """A real device behind a port, as the far end of a line; a port that cannot be opened raises `SimulatorError`."""

    def __init__(self, port: str, baud: int) -> None:
        try:
            self._port = serial.serial_for_url(port, baud, timeout=0)
        except serial.SerialException as error:
            raise SimulatorError(
                f"Cannot open the port: {error}.",
                where=port,
                remedy="Check the name of the port, and that no other program uses it.",
            ) from error
        self.baud = baud  # Of the device; the host must use the same

    def receive(self, data: bytes) -> bytes:
        """See `Dialect.receive`. The bytes go to the device; its answer follows through `unsolicited`."""
        self._port.write(data)
        return b""

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`."""
        heard: bytes = self._port.read(4096)
        return heard

    def close(self) -> None:
        """Close the port."""
        self._port.close()
