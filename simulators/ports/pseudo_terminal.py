"""A pseudo-terminal that a program opens as its serial port.

Knows ptys: raw mode before anyone sees it, a symlink with a lasting name (the number behind it changes with
every replug), the baud rate the client has set, and unplugging. Knows no device and no thread.
"""

from __future__ import annotations

import os
import termios
import tty
from pathlib import Path

from simulators.errors import SimulatorError

#: Bytes taken in one read.
_CHUNK = 4096

#: Baud rates by their termios constants, as far as this platform names them.
_BAUD_BY_CODE = {
    getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()
}


class PseudoTerminal:
    """The device's end of a serial line.

    Parameters
    ----------
    link
        Where the client's end is published as a symlink, as in ``/dev/serial/by-id``.

    Raises
    ------
    SimulatorError
        When the link cannot be made.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self._master = -1
        self._slave = -1
        self.plug()

    @property
    def name(self) -> str:
        """Name of its link."""
        return self.link.name

    @property
    def address(self) -> str:
        """What a client opens."""
        return str(self.link)

    def fileno(self) -> int:
        """Descriptor to wait on, -1 while unplugged."""
        return self._master

    def plug(self) -> None:
        """Make the terminal and publish it; a link left over by a dead process is replaced."""
        self._master, self._slave = os.openpty()
        # Raw first: a cooked terminal would echo the client's first bytes back as if we had sent them.
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
                f"The port cannot be published: {error.strerror}.",
                where=str(self.link),
                remedy="Choose a folder that can be written to.",
            ) from error

    def unplug(self) -> None:
        """Take the device off: the client's next read or write fails, and the name is gone."""
        if self._master < 0:
            return
        if self.link.is_symlink() and self.link.readlink() == Path(os.ttyname(self._slave)):
            self.link.unlink()
        self._close_both()

    def read(self) -> bytes:
        """Whatever the client has sent, without waiting."""
        try:
            return os.read(self._master, _CHUNK)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send; what a client that does not read leaves no room for is lost, as on a wire."""
        try:
            os.write(self._master, data)
        except BlockingIOError:
            return

    def client_baud(self) -> int | None:
        """Baud rate the client has set; None for one without a termios name."""
        return _BAUD_BY_CODE.get(termios.tcgetattr(self._master)[5])

    def close(self) -> None:
        """Unplug for good."""
        self.unplug()

    def _close_both(self) -> None:
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = -1
