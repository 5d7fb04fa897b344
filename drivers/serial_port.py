"""Open, lock, read and write a port through pyserial, and turn its failures into the port errors of ``drivers.errors``.

No other module uses pyserial. An unplugged port raises SerialException, a bare OSError or termios.error, depending on
the call; all three become PortLost.

Two locks are taken, because one is not enough. flock is advisory: a program that does not ask for it ignores it.
TIOCEXCL makes the kernel refuse every further open, except by root. Both vanish with the process that took them,
however it ended, so no stale lock is left behind.
"""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, ParamSpec, Protocol, Self, TypeVar

import serial

from drivers import file_lock
from drivers.clock import Clock
from drivers.errors import PortBusy, PortDenied, PortError, PortLost, PortNotFound
from drivers.port_address import PORT_REMEDY, refused_port
from drivers.silence import ONE_AT_A_TIME
from drivers.wire_log import WireLog

try:
    import fcntl
    import termios

    _TERMIOS_ERROR: type[Exception] = termios.error
    _LOCKS_PORTS = True
except ImportError:  # Windows opens every serial port exclusively by itself, and has no setting of hanging up
    _TERMIOS_ERROR, _LOCKS_PORTS = OSError, False

_LOST = (serial.SerialException, OSError, _TERMIOS_ERROR)
_NO_SERIAL_PORT = (ValueError, NotImplementedError)
"""Exceptions of pyserial for settings that a port, or a system, does not have."""
SYSTEM = os.name
_SLICE_S = 0.05
"""Longest single read of the port, in seconds. A new value for an open port would write its line settings again."""
_WRITE_S = 2.0  # A command of some bytes; longer, and the device holds the line
_STOOD_STILL_S = 1.0
"""A write that ends later than its time limit by more than this ended late because the computer stood still."""
_MOST_BYTES = 4096
"""Most bytes of one read, so that a device that sends without pause does not keep the reader forever."""

T = TypeVar("T")
P = ParamSpec("P")


def lock_exclusively(descriptor: int) -> None:
    """Lock an open port, or raise `BlockingIOError`. Locking the same descriptor again does no harm."""
    file_lock.lock(descriptor)
    # A device that is no terminal has no TIOCEXCL; the flock still holds.
    with contextlib.suppress(OSError):
        fcntl.ioctl(descriptor, termios.TIOCEXCL)


def unlock(descriptor: int) -> None:
    """Release the kernel's exclusive lock, which belongs to the terminal and not to the descriptor."""
    with contextlib.suppress(OSError):
        fcntl.ioctl(descriptor, termios.TIOCNXCL)


def disable_hang_up_on_close(descriptor: int) -> None:
    """Clear HUPCL: closing then leaves DTR as it is, so a board that resets on DTR does not reset."""
    attributes = termios.tcgetattr(descriptor)
    if attributes[2] & termios.HUPCL:
        attributes[2] &= ~termios.HUPCL
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)


class Port(Protocol):
    """A two-way stream of bytes to a device."""

    @property
    def name(self) -> str:
        """The name it was opened by."""

    def read(self, timeout_s: float) -> bytes:
        """Wait up to ``timeout_s`` for the first byte; return all that have arrived, empty if there are none."""

    def write(self, data: bytes) -> None:
        """Send bytes."""

    def close(self) -> None:
        """Close the port. A second call does nothing."""


class SerialPort:
    """An open serial port, locked for this program.

    Opening sends nothing and leaves the modem lines as the system sets them. The address is a device file, preferably
    below ``/dev/serial/by-id/``, a port name of the system, ``socket://host:port`` or ``rfc2217://host:port``; other
    URLs of pyserial are refused. A pseudo-terminal and ``socket://`` have no lines RTS and CTS and ignore ``rtscts``.
    """

    def __init__(self, address: str, settings: LineSettings) -> None:
        self.name = address
        self._settings = settings
        self._serial = _open(address, settings)
        self._lost = False

    def read(self, timeout_s: float) -> bytes:
        """See `Port.read`."""
        end = time.monotonic() + timeout_s
        while True:
            data = self._try(self._read_slice, end - time.monotonic() > 0)
            if data or time.monotonic() >= end:
                return data

    def write(self, data: bytes) -> None:
        """See `Port.write`. The bytes are handed to the system; those that the device does not take are not kept."""
        begun_s = time.monotonic()
        try:
            self._try(self._serial.write, data)
        except PortLost as error:
            if not isinstance(error.__cause__, serial.SerialTimeoutException):
                raise
            if time.monotonic() - begun_s > _WRITE_S + _STOOD_STILL_S and self._has_sent_all():
                self._lost = False
                return
            with contextlib.suppress(*_LOST):
                self._serial.reset_output_buffer()  # a command that is sent late would be a motion
            if not self._settings.rtscts:
                raise
            raise PortLost(
                f"the device takes no bytes: its line CTS was off for {_WRITE_S:g} s.",
                where=self.name,
                remedy="Check that it is switched on and that the cable has the lines RTS and CTS, or write"
                " rtscts: false in the station file.",
            ) from error

    def close(self) -> None:
        """See `Port.close`. This never raises: a port that is gone is closed already."""
        if not self._serial.is_open:
            return
        line = getattr(self._serial, "_socket", None)
        try:
            descriptor = _descriptor(self._serial)
            if descriptor is not None:
                unlock(descriptor)
            self._serial.close()
        except _LOST:
            self._lost = True
        if line is not None:  # pyserial does not close a socket whose other end has closed it
            line.close()

    def _has_sent_all(self) -> bool:
        """Return whether no byte waits in the system: pyserial looks at the time only after it has handed them over."""
        try:
            return not self._serial.out_waiting
        except _LOST:
            return False

    def _read_slice(self, may_wait: bool) -> bytes:
        data = b""
        try:
            if may_wait and not self._serial.in_waiting:
                data = bytes(self._serial.read(1))
            # For a socket, in_waiting is 1 however many bytes wait.
            while len(data) < _MOST_BYTES and (waiting := self._serial.in_waiting):
                data += self._serial.read(waiting)
        except _LOST:
            if not data:  # else the next read raises: what the other end said before it closed tells why
                raise
        return data

    def _try(self, action: Callable[P, T], *arguments: P.args, **named: P.kwargs) -> T:
        if self._lost or not self._serial.is_open:
            raise port_lost(self.name, "it was closed or lost before.")
        try:
            return action(*arguments, **named)
        except _LOST as error:
            self._lost = True
            raise port_lost(self.name, f"the system reports: {error}.") from error


def port_lost(name: str, why: str) -> PortLost:
    """Build the error of a port, or of a connection on a network, that was open and is gone."""
    more = ONE_AT_A_TIME if "://" in name else " Perhaps another program reads from it, too."
    remedy = f"Check that the device is powered and plugged in, then resume.{more}"
    return PortLost(f"the port is gone; {why}", where=name, remedy=remedy)


class ReopeningPort(SerialPort):
    """A port to a device whose requests may all be sent twice: it can be opened again when it is gone.

    Devices on a network close a connection that was idle for some seconds.
    """

    @property
    def is_network(self) -> bool:
        """Whether it is a connection on a network."""
        return "://" in self.name

    def reopen(self) -> None:
        """Close the port, and open it again, with the errors of opening."""
        self.close()
        self._serial = _open(self.name, self._settings)
        self._lost = False


class LineSettings(NamedTuple):
    """Settings of a serial line."""

    baudrate: int  # Bits per second
    rtscts: bool = False  # Whether the line has hardware flow control
    frame: str = "8N1"  # Data bits, parity (none, even, odd) and stop bits
    xonxoff: bool = False  # Whether the bytes XON and XOFF hold the sender


def _open(address: str, settings: LineSettings) -> Any:
    if (refused := refused_port(address)) is not None:
        raise PortNotFound(refused, where=address, remedy=PORT_REMEDY)
    try:
        port: Any = serial.serial_for_url(
            address,
            baudrate=settings.baudrate,
            bytesize=int(settings.frame[0]),
            parity=settings.frame[1],
            stopbits=int(settings.frame[2]),
            rtscts=settings.rtscts,
            xonxoff=settings.xonxoff,
            timeout=_SLICE_S,
            write_timeout=None if "://" in address else _WRITE_S,  # device servers have no such timeout
            exclusive=True,  # flock, before pyserial touches a line setting
            # On POSIX this makes pyserial leave DTR alone, and turns no flow control on. On Windows it is flow control:
            # nothing would be sent to a device that does not raise DSR.
            dsrdtr=SYSTEM == "posix",
            do_not_open=True,
        )
    except _NO_SERIAL_PORT as error:
        raise PortNotFound(
            f"this is not a port: {error}.",
            where=address,
            remedy="Name a device file or socket://host:port in the station file.",
        ) from error
    try:
        port.open()
        descriptor = _descriptor(port)
        if descriptor is not None:
            lock_exclusively(descriptor)
            disable_hang_up_on_close(descriptor)
    except (*_LOST, *_NO_SERIAL_PORT) as error:
        port.close()
        raise _why_not_opened(address, error) from error
    return port


def _descriptor(port: Any) -> int | None:
    """Return the file descriptor of a local port; None where there is none to lock (sockets, Windows)."""
    return getattr(port, "fd", None) if _LOCKS_PORTS else None


def _holder_of(address: str) -> str:
    """Return who holds a local port, as the end of a sentence; empty if it is not known."""
    with contextlib.suppress(OSError, ValueError):
        holder = file_lock.holder_text(Path(address).stat().st_ino)
        return f": {holder}" if holder else ""
    return ""


def _why_not_opened(address: str, error: BaseException) -> PortError:
    code = getattr(error, "errno", None)
    if code in {errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK}:
        return PortBusy(
            f"another program holds the port{_holder_of(address)}.",
            where=address,
            remedy="Close that program, then start again. ModemManager leaves a new port after half a minute.",
        )
    if code in {errno.EACCES, errno.EPERM}:
        return PortDenied(
            "no permission to open the port.",
            where=address,
            remedy="Add the user to the group of the port (often dialout) and log in again.",
        )
    if code in {errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.ENOTDIR}:
        return PortNotFound(
            "there is no such port.",
            where=address,
            remedy="Check that the device is plugged in and that the station file names its port. On Linux,"
            " brltty may have taken an adapter with a CH340, CP210x or FTDI chip: remove it, then plug the device in.",
        )
    if getattr(error.__context__, "args", ())[:1] == (errno.ENOTTY,):  # pyserial's own error has no number
        return PortNotFound(
            "this file is no serial port.",
            where=address,
            remedy="Check that the station file names the device's port, such as /dev/serial/by-id/...",
        )
    return PortNotFound(
        f"it cannot be opened as a serial port: {error}.",
        where=address,
        remedy="Check that the station file names the device's port and a baud rate that the port supports.",
    )


@contextmanager
def closed_on_error(*ports: Port) -> Iterator[None]:
    """Close ports when the block fails."""
    try:
        yield
    except BaseException:
        for port in ports:
            port.close()
        raise


class OnOnePort:
    """A device on one port. Open it with ``open``; its constructor takes a port that is open already."""

    SETTINGS: ClassVar[LineSettings]

    @classmethod
    def open(
        cls,
        port: str,
        *arguments: Any,
        line: Mapping[str, Any] | None = None,
        clock: Clock,
        wire_log: WireLog | None = None,
        **more: Any,
    ) -> Self:
        """Open the port and the device on it. `SerialPort` raises the errors of opening.

        ``line`` has the `LineSettings` that are not the device's own; the other arguments are those of the constructor.
        """
        construct: Any = cls
        opened = cls._opened(port, cls._line_settings(*arguments)._replace(**(line or {})))
        device: Self = construct(opened, *arguments, clock=clock, wire_log=wire_log, **more)
        return device

    @classmethod
    def _opened(cls, address: str, settings: LineSettings) -> Port:
        return SerialPort(address, settings)

    @classmethod
    def _line_settings(cls, *_arguments: Any) -> LineSettings:
        return cls.SETTINGS
