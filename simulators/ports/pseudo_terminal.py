"""A pseudo-terminal that a program opens as its serial port.

The terminal is in raw mode before clients see it. A symlink gives it a lasting name, because the number of the
pseudo-terminal changes with each replug. The module reads the baud rate that the client has set, and simulates a
pulled cable. It starts no thread and depends on no device.
"""

from __future__ import annotations

import os
import termios
import tty
from pathlib import Path

from simulators.errors import SimulatorError

#: Largest number of bytes in one read: the size of a terminal's buffer in Linux.
_CHUNK = 4096

#: Baud rates by termios constant, for the constants that this platform defines.
_BAUD_BY_CODE = {
    getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()
}


class PseudoTerminal:
    """The device's end of a serial line; ``link`` is a symlink to the client's end, as in ``/dev/serial/by-id``."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self.name = link.name
        self.address = str(link)
        """Path that a client opens."""
        self._master = -1
        self._slave = -1
        self.plug()

    def fileno(self) -> int:
        """Return the descriptor to wait on."""
        return self._master

    def plug(self) -> None:
        """Create the terminal and its symlink; replace a symlink that a dead process left behind."""
        self._master, self._slave = os.openpty()
        # Raw mode first: a cooked terminal would echo the client's first bytes as if the device had sent them.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        fresh = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        try:
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(os.ttyname(self._slave))
            fresh.replace(self.link)
        except OSError as error:
            self._close_both()
            raise SimulatorError(
                f"Cannot create the link of the port: {error.strerror}.",
                where=str(self.link),
                remedy="Choose a folder with write permission.",
            ) from error

    def unplug(self) -> None:
        """Remove the device: the symlink disappears, and the client's next read or write fails."""
        if self._master < 0:
            return
        if self.link.is_symlink() and self.link.readlink() == Path(os.ttyname(self._slave)):
            self.link.unlink()
        self._close_both()

    def read(self) -> bytes:
        """Return what the client has sent."""
        try:
            return os.read(self._master, _CHUNK)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send bytes to the client. What its buffer cannot hold is lost, as on a real line."""
        try:
            os.write(self._master, data)
        except BlockingIOError:
            return

    def client_baud(self) -> int | None:
        """Return the baud rate that the client has set; None for one without a termios constant."""
        return _BAUD_BY_CODE.get(termios.tcgetattr(self._master)[5])

    def close(self) -> None:
        """Remove the port for good."""
        self.unplug()

    def _close_both(self) -> None:
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = -1
