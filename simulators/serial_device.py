"""A simulated device on a serial line: bytes in, bytes out, at the speed of the line.

Knows threads, pacing by baud rate, and that a wrong baud rate is garbage; knows nothing of any protocol. What
the device says is up to a `Dialect`.
"""

from __future__ import annotations

import os
import queue
import select
import threading
from collections.abc import Callable
from concurrent.futures import Future
from types import TracebackType
from typing import Protocol, Self

from simulators.pseudo_terminal import PseudoTerminal

#: Bits on the wire a byte: start, eight data, stop.
_BITS = 10

#: A USB adapter hands bytes on in packets; a reader sees a long reply in parts.
_PACKET = 32

#: How often a device with something to say of its own accord is asked.
_POLL_S = 0.02


class Dialect(Protocol):
    """What a device says. Called from one thread only."""

    @property
    def baud(self) -> int:
        """Baud rate it listens at."""
        ...

    def receive(self, data: bytes) -> bytes:
        """Take bytes as they arrive, in pieces of any size, and give what it answers."""
        ...

    def unsolicited(self) -> bytes:
        """Give what it says of its own accord by now."""
        ...


class SerialDevice:
    """A device that answers on a pseudo-terminal until it is closed.

    Parameters
    ----------
    terminal
        Its end of the line.
    dialect
        What it says.
    paced
        Whether bytes take the time they need at the baud rate.
    """

    def __init__(self, terminal: PseudoTerminal, dialect: Dialect, *, paced: bool = True) -> None:
        self._terminal = terminal
        self._dialect = dialect
        self._paced = paced
        self._ending = threading.Event()
        self._orders: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._waking, self._wake = os.pipe()
        self._thread = threading.Thread(target=self._serve, name=f"serial {terminal.link.name}", daemon=True)

    @property
    def address(self) -> str:
        """What a client opens."""
        return self._terminal.address

    def start(self) -> Self:
        """Begin to answer."""
        self._thread.start()
        return self

    def unplug(self) -> None:
        """Pull the cable; the device itself goes on."""
        self.between_exchanges(self._terminal.unplug)

    def replug(self) -> None:
        """Put the cable back in."""
        self.between_exchanges(self._terminal.plug)

    def close(self) -> None:
        """Stop answering, and remove the port."""
        self._ending.set()
        os.write(self._wake, b".")
        self._thread.join()
        self._terminal.close()
        os.close(self._waking)
        os.close(self._wake)

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def between_exchanges(self, act: Callable[[], None]) -> None:
        """Have the serving thread do something between two exchanges, and wait until it has.

        What ``act`` raises is raised here.
        """
        done: Future[None] = Future()

        def carry_out() -> None:
            try:
                act()
            except Exception as error:  # noqa: BLE001 - handed to whom it concerns
                done.set_exception(error)
            else:
                done.set_result(None)

        self._orders.put(carry_out)
        os.write(self._wake, b".")
        done.result()

    # ------------------------------------------------------------------ inside
    def _serve(self) -> None:
        while not self._ending.is_set():
            ends = [self._waking] + ([self._terminal.fileno()] if self._terminal.fileno() >= 0 else [])
            ready, _, _ = select.select(ends, [], [], _POLL_S)
            if self._waking in ready:
                os.read(self._waking, 64)
            while not self._orders.empty():
                self._orders.get()()
            if self._terminal.fileno() >= 0:
                self._exchange()

    def _exchange(self) -> None:
        heard = self._terminal.read()
        understood = self._terminal.client_baud() in (self._dialect.baud, None)
        if heard:
            self._take_time(len(heard))
        answer = self._dialect.receive(heard) if heard and understood else _garbage(heard)
        answer += self._dialect.unsolicited() if understood else b""
        for start in range(0, len(answer), _PACKET):
            packet = answer[start : start + _PACKET]
            self._take_time(len(packet))
            self._terminal.write(packet)

    def _take_time(self, count: int) -> None:
        if self._paced:
            self._ending.wait(count * _BITS / self._dialect.baud)


def _garbage(heard: bytes) -> bytes:
    """Make what a line at the wrong speed carries: as many bytes, none of them right."""
    return bytes((0x80 | (byte * 29 + 7 * index)) & 0xFF for index, byte in enumerate(heard))
