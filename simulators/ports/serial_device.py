"""A simulated device on a serial line: bytes in, bytes out, at the speed of the line.

Knows threads, pacing by baud rate, and that a wrong baud rate is garbage; knows nothing of any protocol. What
the device says is up to a `Dialect`, what carries the bytes to a `Port`.
"""

from __future__ import annotations

import queue
import select
import socket
import threading
from collections.abc import Callable
from concurrent.futures import Future
from types import TracebackType
from typing import Protocol, Self

#: Bits on the wire a byte: start, eight data, stop.
_BITS_PER_BYTE = 10

#: A USB adapter hands bytes on in packets; a reader sees a long reply in parts.
_PACKET_BYTES = 32

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


class Port(Protocol):
    """The device's end of a line. Nothing here waits."""

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    @property
    def address(self) -> str:
        """What a client opens."""
        ...

    def fileno(self) -> int:
        """Descriptor to wait on, -1 while unplugged."""
        ...

    def plug(self) -> None:
        """Have clients find it."""
        ...

    def unplug(self) -> None:
        """Take it away from them."""
        ...

    def read(self) -> bytes:
        """Whatever the client has sent."""
        ...

    def write(self, data: bytes) -> None:
        """Send to the client; what it leaves no room for is lost."""
        ...

    def client_baud(self) -> int | None:
        """Baud rate of the client; None where there is none to be known."""
        ...

    def close(self) -> None:
        """Take it away for good."""
        ...


class SerialDevice:
    """A device that answers on a port until it is closed.

    Parameters
    ----------
    port
        Its end of the line.
    dialect
        What it says.
    paced
        Whether bytes take the time they need at the baud rate.
    """

    def __init__(self, port: Port, dialect: Dialect, *, paced: bool = True) -> None:
        self._port = port
        self._dialect = dialect
        self._paced = paced
        self._closing = threading.Event()
        self._actions: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._waking, self._wake = socket.socketpair()
        self._thread = threading.Thread(target=self._serve, name=f"serial {port.name}", daemon=True)

    @property
    def address(self) -> str:
        """What a client opens."""
        return self._port.address

    def start(self) -> Self:
        """Begin to answer."""
        self._thread.start()
        return self

    def unplug(self) -> None:
        """Pull the cable; the device itself goes on."""
        self.between_exchanges(self._port.unplug)

    def replug(self) -> None:
        """Put the cable back in."""
        self.between_exchanges(self._port.plug)

    def close(self) -> None:
        """Stop answering, and remove the port."""
        self._closing.set()
        self._wake.send(b".")
        self._thread.join()
        self._port.close()
        self._waking.close()
        self._wake.close()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def between_exchanges(self, act: Callable[[], None]) -> None:
        """Have the serving thread do something between two exchanges, and wait until it has.

        What ``act`` raises is raised here. Asked for by that thread itself, it is done at once.
        """
        if threading.current_thread() is self._thread:
            act()
            return
        done: Future[None] = Future()

        def carry_out() -> None:
            try:
                act()
            except Exception as error:  # noqa: BLE001 - handed to whom it concerns
                done.set_exception(error)
            else:
                done.set_result(None)

        self._actions.put(carry_out)
        self._wake.send(b".")
        done.result()

    # ------------------------------------------------------------------ inside
    def _serve(self) -> None:
        while not self._closing.is_set():
            ends = [self._waking.fileno()] + ([self._port.fileno()] if self._port.fileno() >= 0 else [])
            ready, _, _ = select.select(ends, [], [], _POLL_S)
            if self._waking.fileno() in ready:
                self._waking.recv(64)
            while not self._actions.empty():
                self._actions.get()()
            if self._port.fileno() >= 0:
                self._exchange()

    def _exchange(self) -> None:
        received = self._port.read()
        understood = self._port.client_baud() in (self._dialect.baud, None)
        if received:
            self._wait_for_line(len(received))
        answer = self._dialect.receive(received) if received and understood else _garbage(received)
        answer += self._dialect.unsolicited() if understood else b""
        if self._port.fileno() < 0:  # pulled out meanwhile
            return
        for start in range(0, len(answer), _PACKET_BYTES):
            packet = answer[start : start + _PACKET_BYTES]
            self._wait_for_line(len(packet))
            self._port.write(packet)

    def _wait_for_line(self, count: int) -> None:
        if self._paced:
            self._closing.wait(count * _BITS_PER_BYTE / self._dialect.baud)


def _garbage(received: bytes) -> bytes:
    """Make what a line at the wrong speed carries: as many bytes, none of them right."""
    return bytes((0x80 | (byte * 29 + 7 * index)) & 0xFF for index, byte in enumerate(received))
