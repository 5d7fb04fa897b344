"""Open an instrument with USB-TMC, VXI-11 or GPIB through PyVISA, as a port that carries bytes.

Such instruments have messages in place of a stream: they are read only after a query, because a read without one is an
error of its own in them. PyVISA is the extra ``visa``; it is imported when a port with an address ``visa:...`` is
opened.

Sources: USB Implementers Forum, "USB Test and Measurement Class Specification"; VXIbus Consortium, "VXI-11".
"""

from __future__ import annotations

import contextlib
import importlib.util
import re
from collections.abc import Callable
from typing import Any, Final

from drivers.errors import PortNotFound
from drivers.file_lock import DeviceHold
from drivers.serial_port import port_lost

VISA_PREFIX: Final = "visa:"
_INSTALL: Final = 'Install it: pip install "starbench[visa]".'
_SOCKET = re.compile(r"visa:\s*TCPIP\d*::([^:]+)::(\d+)::SOCKET", re.IGNORECASE)
_OPEN_MS: Final = 5000  # An instrument on USB or LAN that has just been switched on
_WRITE_MS: Final = 2000  # A command of some bytes; longer, and the instrument hangs


def socket_url(address: str) -> str | None:
    """Return the URL of the same plain socket; None for an instrument with messages.

    >>> socket_url("visa:TCPIP0::10.0.0.7::5025::SOCKET")
    'socket://10.0.0.7:5025'
    """
    match = _SOCKET.fullmatch(address.strip())
    return f"socket://{match[1]}:{match[2]}" if match else None


class VisaPort:
    """An open instrument, locked for this program; ``address`` such as ``visa:USB0::0x1AB1::0x0642::DG1Z::INSTR``."""

    is_network: Final = True

    def __init__(self, address: str) -> None:
        self.name = address
        self._hold = DeviceHold(address)
        self._asked = False
        """Whether a query was sent whose answer has not come."""
        self._resource: Any = None
        try:
            self.reopen()
        except BaseException:
            self._hold.release()
            raise

    def reopen(self) -> None:
        """Open it, again if need be. Nothing is sent."""
        self._close_resource()
        self._resource = _open(self.name)
        self._asked = False

    def read(self, timeout_s: float) -> bytes:
        """See `Port.read`. Without a query, nothing can come."""
        if not self._asked or timeout_s <= 0:
            return b""
        data: bytes = self._try(self._read, max(1, round(1e3 * timeout_s)))
        if data:
            self._asked = False
            data = data if data.endswith(b"\n") else data + b"\n"
        return data

    def write(self, data: bytes) -> None:
        """See `Port.write`: one message."""
        if self._asked:  # an answer that never came: the instrument forgets it, where it can
            with contextlib.suppress(Exception):
                self._resource.clear()
        self._asked = b"?" in data
        self._try(self._write, data)

    def close(self) -> None:
        """See `Port.close`."""
        self._close_resource()
        self._hold.release()

    # ------------------------------------------------------------ inside

    def _close_resource(self) -> None:
        resource, self._resource = self._resource, None
        if resource is not None:
            with contextlib.suppress(Exception):  # what is gone is closed already
                resource.close()

    def _read(self, timeout_ms: int) -> bytes:
        from pyvisa.constants import StatusCode
        from pyvisa.errors import VisaIOError

        self._resource.timeout = timeout_ms
        try:
            return bytes(self._resource.read_raw())
        except VisaIOError as error:
            if error.error_code == StatusCode.error_timeout:
                return b""
            raise

    def _write(self, data: bytes) -> None:
        self._resource.timeout = _WRITE_MS
        self._resource.write_raw(data)

    def _try(self, action: Callable[[Any], Any], argument: object) -> Any:
        if self._resource is not None:
            try:
                return action(argument)
            except Exception as error:  # PyVISA passes on the errors of many libraries
                self._close_resource()
                raise port_lost(self.name, f"PyVISA reports: {error}.") from error
        raise port_lost(self.name, "it was closed or lost before.")


def _open(address: str) -> Any:
    if importlib.util.find_spec("pyvisa") is None:
        raise PortNotFound(
            "an address of VISA needs PyVISA, which is not installed.", where=address, remedy=_INSTALL
        )
    import pyvisa

    resource = address.removeprefix(VISA_PREFIX).strip()
    try:
        return pyvisa.ResourceManager().open_resource(resource, open_timeout=_OPEN_MS)
    except Exception as error:  # PyVISA passes on the errors of many libraries
        remedy = (
            "Check that it is switched on and plugged in, that this user may use it (a udev rule), and its address."
            " pyvisa-info tells what is missing, and pyvisa-shell lists the addresses."
        )
        raise PortNotFound(
            "PyVISA does not find the instrument, or cannot open it.", where=address, remedy=remedy
        ) from error
