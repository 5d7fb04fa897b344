"""A serial device server: a device's line on a TCP port of this machine, as pyserial's ``socket://`` opens it.

For machines without pseudo-terminals. Knows one client at a time; there is no baud rate on such a line. Knows no
device and no thread.
"""

from __future__ import annotations

import socket

_CHUNK = 4096


class TcpPort:
    """The device's end of a line that runs over TCP.

    Parameters
    ----------
    name
        What it is called in messages.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self._port = 0
        self.plug()

    @property
    def address(self) -> str:
        """What a client opens."""
        return f"socket://127.0.0.1:{self._port}"

    def fileno(self) -> int:
        """Descriptor to wait on: the client's, or the listener's while there is none; -1 while unplugged."""
        if self._client is not None:
            return self._client.fileno()
        return self._listener.fileno() if self._listener is not None else -1

    def plug(self) -> None:
        """Listen, on the port of before if there was one."""
        self._listener = socket.create_server(("127.0.0.1", self._port))
        self._listener.setblocking(False)
        self._port = self._listener.getsockname()[1]

    def unplug(self) -> None:
        """Hang up and stop listening."""
        for one in (self._client, self._listener):
            if one is not None:
                one.close()
        self._client = self._listener = None

    def read(self) -> bytes:
        """Whatever the client has sent, without waiting; takes up a client that is there."""
        try:
            if self._client is None:
                if self._listener is not None:
                    self._client, _ = self._listener.accept()
                    self._client.setblocking(False)
                return b""
            data = self._client.recv(_CHUNK)
        except BlockingIOError:
            return b""
        except ConnectionError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def write(self, data: bytes) -> None:
        """Send; without a client, or to one that does not read, it is lost, as on a wire."""
        if self._client is None:
            return
        try:
            self._client.send(data)
        except BlockingIOError:
            return
        except ConnectionError:
            self._hang_up()

    def client_baud(self) -> int | None:
        """Not known on such a line."""
        return None

    def close(self) -> None:
        """Stop for good."""
        self.unplug()

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None
