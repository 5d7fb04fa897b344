"""Knows how a port is opened, locked and read through pyserial, and what each of its failures means.

The only module that touches pyserial. Every way a port can fail is turned into one of the port errors of
``drivers.errors``; an unplugged port shows itself as SerialException, as a bare OSError or as
termios.error depending on the call, and all three become PortLost.
"""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable
from typing import Any, ParamSpec, Protocol, TypeVar

import serial

from drivers import port_lock
from drivers.errors import PortBusy, PortDenied, PortError, PortLost, PortNotFound

try:
    from termios import error as _termios_error
except ImportError:  # Windows
    _termios_error = OSError  # type: ignore[misc, assignment]

_LOST = (serial.SerialException, OSError, _termios_error)
_NO_SERIAL_PORT = (ValueError, NotImplementedError)
"""What pyserial raises for settings that a port, or a system, does not have."""
_SYSTEM = os.name
_SLICE_S = 0.05
"""One blocking read; setting another on an open port would write its line settings again."""
_WRITE_S = 2.0
_MOST_BYTES = 4096
"""Of one read: a device that talks without pause is noticed by whoever reads."""

T = TypeVar("T")
P = ParamSpec("P")


class Port(Protocol):
    """A two-way stream of bytes to a device."""

    @property
    def name(self) -> str:
        """The name it was opened by."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """Whatever has arrived, waiting at most that long for the first byte; empty when none came."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of it."""
        ...

    def close(self) -> None:
        """Give the port back; closing twice does no harm."""
        ...


class SerialPort:
    """An open serial port, locked for this program.

    Opening sends nothing, and leaves the modem lines as the system sets them.

    Parameters
    ----------
    address
        A device file, best one of ``/dev/serial/by-id/``, a port name as the system has it, or a pyserial
        URL such as ``socket://host:port`` or ``rfc2217://host:port``.
    baudrate
        Bits per second.
    stopbits
        1 or 2; always 8 data bits without parity.

    Raises
    ------
    PortNotFound, PortBusy, PortDenied
        With what the operator can do about it.
    """

    def __init__(self, address: str, *, baudrate: int, stopbits: int = 1) -> None:
        self._name = address
        self._serial = _open(address, baudrate, stopbits)
        self._lost = False

    @property
    def name(self) -> str:
        """The name it was opened by."""
        return self._name

    def read(self, timeout_s: float) -> bytes:
        """Whatever has arrived, waiting at most ``timeout_s`` for the first byte.

        Raises PortLost.
        """
        end = time.monotonic() + timeout_s
        while True:
            data = self._try(self._read_slice, end - time.monotonic() > 0)
            if data or time.monotonic() >= end:
                return data

    def write(self, data: bytes) -> None:
        """Hand all bytes to the system. Raises PortLost."""
        self._try(self._serial.write, data)

    def close(self) -> None:
        """Unlock and close; never raises, since a port that is gone is closed already."""
        if not self._serial.is_open:
            return
        line = getattr(self._serial, "_socket", None)
        try:
            descriptor = _descriptor(self._serial)
            if descriptor is not None:
                port_lock.let_others_in(descriptor)
            self._serial.close()
        except _LOST:
            self._lost = True
        if line is not None:  # pyserial leaves one open whose other end hung up
            line.close()

    def _read_slice(self, may_wait: bool) -> bytes:
        data = b""
        if may_wait and not self._serial.in_waiting:
            data = bytes(self._serial.read(1))
        # A socket tells only whether something waits, not how much: 1.
        while len(data) < _MOST_BYTES and (waiting := self._serial.in_waiting):
            data += self._serial.read(waiting)
        return data

    def _try(self, action: Callable[P, T], *arguments: P.args, **named: P.kwargs) -> T:
        if self._lost or not self._serial.is_open:
            raise self._gone("it was closed or lost before.")
        try:
            return action(*arguments, **named)
        except _LOST as error:
            self._lost = True
            raise self._gone(f"the system says: {error}.") from error

    def _gone(self, why: str) -> PortLost:
        return PortLost(
            f"the port is gone; {why}",
            where=self._name,
            remedy="See that the device is powered and plugged in, then resume.",
        )


def _open(address: str, baudrate: int, stopbits: int) -> Any:
    try:
        port: Any = serial.serial_for_url(
            address,
            baudrate=baudrate,
            stopbits=stopbits,
            timeout=_SLICE_S,
            write_timeout=None if "://" in address else _WRITE_S,  # device servers know none
            exclusive=True,  # flock, before pyserial touches a line setting
            # With it pyserial leaves DTR alone, and turns no flow control on; on Windows it is flow control,
            # and nothing is sent to a device that does not raise DSR.
            dsrdtr=_SYSTEM == "posix",
            do_not_open=True,
        )
    except _NO_SERIAL_PORT as error:
        raise PortNotFound(
            f"this is no port: {error}.", where=address, remedy="Give a device file or socket://host:port."
        ) from error
    try:
        port.open()
        descriptor = _descriptor(port)
        if descriptor is not None:
            port_lock.keep_to_ourselves(descriptor)
            port_lock.keep_lines_up_after_closing(descriptor)
    except (*_LOST, *_NO_SERIAL_PORT) as error:
        port.close()
        raise _why_not_opened(address, error) from error
    return port


def _descriptor(port: Any) -> int | None:
    """Return the file descriptor of a local port; None where there is none (sockets, Windows)."""
    return getattr(port, "fd", None)


def _why_not_opened(address: str, error: BaseException) -> PortError:
    code = getattr(error, "errno", None)
    if code in {errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK}:
        return PortBusy(
            "another program holds the port.", where=address, remedy="Close it, then start again."
        )
    if code in {errno.EACCES, errno.EPERM}:
        return PortDenied(
            "no permission to open the port.",
            where=address,
            remedy="Add the user to the port's group (often dialout) and log in again.",
        )
    if code in {errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.ENOTDIR}:
        return PortNotFound(
            "there is no such port.",
            where=address,
            remedy="See that the device is plugged in, and that the station file names its port.",
        )
    return PortNotFound(
        f"it cannot be opened as a serial port: {error}.",
        where=address,
        remedy="See that the station file names the device's port, and a baud rate that it can do.",
    )
