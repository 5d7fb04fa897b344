"""A serial device server: a device's line on a TCP port of this computer, which pyserial opens as ``socket://``.

It serves computers without pseudo-terminals. One client at a time is connected, and the line has no baud rate. The
module starts no thread and depends on no device.
"""

from __future__ import annotations

import socket

_CHUNK = 4096


class TcpPort:
    """The device's end of a line over TCP."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self._port = 0
        self.plug()

    @property
    def address(self) -> str:
        """URL that a client opens."""
        return f"socket://127.0.0.1:{self._port}"

    def fileno(self) -> int:
        """See `Port.fileno`. It is the client's descriptor, or the listener's while no client is connected."""
        if self._client is not None:
            return self._client.fileno()
        return self._listener.fileno() if self._listener is not None else -1

    def plug(self) -> None:
        """Listen for clients; a replug listens on the same TCP port as before."""
        self._listener = socket.create_server(("127.0.0.1", self._port))
        self._listener.setblocking(False)
        self._port = self._listener.getsockname()[1]

    def unplug(self) -> None:
        """Close the connection and stop listening."""
        for one in (self._client, self._listener):
            if one is not None:
                one.close()
        self._client = self._listener = None

    def read(self) -> bytes:
        """See `Port.read`. It also accepts a waiting client."""
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
        """See `Port.write`. Without a client the bytes are lost, as on a real line."""
        if self._client is None:
            return
        try:
            self._client.send(data)
        except BlockingIOError:
            return
        except ConnectionError:
            self._hang_up()

    def client_baud(self) -> int | None:
        """See `Port.client_baud`. A TCP connection has no baud rate: always None."""
        return None

    def close(self) -> None:
        """See `Port.close`."""
        self.unplug()

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client = None
