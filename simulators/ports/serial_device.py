"""A simulated device on a serial line: it reads bytes from a port and writes the answers at the speed of the line.

A `Dialect` decides what the device answers, a port carries the bytes. This module provides the thread, the pacing by
baud rate, the garbage that a wrong baud rate causes, and a line on a TCP port of this computer, which pyserial opens as
``socket://``: it serves computers without pseudo-terminals. It depends on no protocol.
"""

from __future__ import annotations

import queue
import select
import socket
import threading
from collections.abc import Callable
from concurrent.futures import Future
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self

if TYPE_CHECKING:  # some platforms have no pseudo-terminals
    from simulators.ports.pseudo_terminal import PseudoTerminal

#: Bits on the wire for one byte (8N1): one start bit, eight data bits, one stop bit.
_BITS_PER_BYTE = 10

#: Size of a packet, bytes. A USB adapter delivers bytes in packets, so a client receives a long reply in parts.
_PACKET_BYTES = 32

#: Interval at which the device is asked for unsolicited messages, s.
_POLL_S = 0.02
_CHUNK = 4096  # Bytes of one read, as of a terminal


class Dialect(Protocol):
    """Protocol of a simulated device. All methods are called from one thread."""

    @property
    def baud(self) -> int:
        """Baud rate at which the device listens."""

    def receive(self, data: bytes) -> bytes:
        """Take bytes as they arrive and return the answers."""

    def unsolicited(self) -> bytes:
        """Return messages that the device sends without a request, and late answers."""


class SerialDevice:
    """A device that answers on its end of a line until it is closed; paced: bytes take their time at the baud rate."""

    def __init__(self, port: PseudoTerminal | TcpPort, dialect: Dialect, *, paced: bool = True) -> None:
        self._port = port
        self.address = port.address
        """Address that a client opens."""
        self._dialect = dialect
        self._paced = paced
        self._closing = threading.Event()
        self._actions: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._waking, self._wake = socket.socketpair()
        self._thread = threading.Thread(target=self._serve, name=f"serial {port.name}", daemon=True)

    def start(self) -> Self:
        """Start the thread that answers."""
        self._thread.start()
        return self

    def unplug(self) -> None:
        """Pull the cable; the device itself stays powered."""
        self.between_exchanges(self._port.unplug)

    def replug(self) -> None:
        """Put the cable back in."""
        self.between_exchanges(self._port.plug)

    def close(self) -> None:
        """Stop answering and remove the port."""
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
        """Run a function in the serving thread, between two exchanges, and wait for it; there itself at once."""
        if threading.current_thread() is self._thread:
            act()
            return
        done: Future[None] = Future()

        def carry_out() -> None:
            try:
                act()
            except Exception as error:  # noqa: BLE001 - raised again in the calling thread
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
        if self._port.fileno() < 0:  # unplugged while the device answered
            return
        for start in range(0, len(answer), _PACKET_BYTES):
            packet = answer[start : start + _PACKET_BYTES]
            self._wait_for_line(len(packet))
            self._port.write(packet)

    def _wait_for_line(self, count: int) -> None:
        if self._paced:
            self._closing.wait(count * _BITS_PER_BYTE / self._dialect.baud)


def _garbage(received: bytes) -> bytes:
    """Return what a line at the wrong baud rate carries: as many bytes, none of them right."""
    return bytes((0x80 | (byte * 29 + 7 * index)) & 0xFF for index, byte in enumerate(received))


class TcpPort:
    """The device's end of a line over TCP; a connection that is idle for ``idle_s`` is closed (0: never)."""

    def __init__(self, name: str, *, idle_s: float = 0.0, clock: Callable[[], float] = lambda: 0.0) -> None:
        self.name = name
        self._idle_s, self._clock, self._heard_s = idle_s, clock, 0.0
        self._listener: socket.socket | None = None
        self.client: socket.socket | None = None
        self._port = 0
        self.plug()

    @property
    def address(self) -> str:
        """URL that a client opens."""
        return f"socket://127.0.0.1:{self._port}"

    def fileno(self) -> int:
        """Return the descriptor to wait on: the client's descriptor, or the listener's while no client is connected."""
        if self.client is not None:
            return self.client.fileno()
        return self._listener.fileno() if self._listener is not None else -1

    def plug(self) -> None:
        """Listen for clients; a replug listens on the same TCP port as before."""
        self._listener = socket.create_server(("127.0.0.1", self._port))
        self._listener.setblocking(False)
        self._port = self._listener.getsockname()[1]

    def unplug(self) -> None:
        """Close the connection and stop listening."""
        for connection in (self.client, self._listener):
            if connection is not None:
                connection.close()
        self.client = self._listener = None

    def read(self) -> bytes:
        """Return what the client has sent; accept a waiting client."""
        try:
            if self.client is None:
                if self._listener is not None:
                    self.client, _ = self._listener.accept()
                    self.client.setblocking(False)
                    self._heard_s = self._clock()
                return b""
            data = self.client.recv(_CHUNK)
            self._heard_s = self._clock()
        except BlockingIOError:
            if self._idle_s and self.client is not None and self._clock() - self._heard_s > self._idle_s:
                self._hang_up()
            return b""
        except ConnectionError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def write(self, data: bytes) -> None:
        """Send bytes; without a client, or where it leaves no room, they are lost, as on a real line."""
        if self.client is None:
            return
        try:
            self.client.send(data)
        except BlockingIOError:
            return
        except ConnectionError:
            self._hang_up()

    def client_baud(self) -> int | None:
        """Return None: a TCP connection has no baud rate."""
        return None

    def close(self) -> None:
        """Remove the port for good."""
        self.unplug()

    def _hang_up(self) -> None:
        if self.client is not None:
            self.client.close()
        self.client = None
