"""Read and write fields of EPICS motor records by Channel Access, with errors as Starbench's drivers have them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from caproto import CaprotoError, CaprotoTimeoutError
from caproto.threading.client import Context, ThreadingClientException

from drivers.errors import PortLost, PortNotFound, ReplyTimeout

FIELDS = (
    *("VAL", "RBV", "DMOV", "HOMF", "HOMR", "STOP", "VELO", "ACCL", "LLM", "HLM", "EGU", "DESC", "MSTA"),
)
ANSWER_S = 2.0
"""Longest wait for a record, s."""
NETWORK = "Check that the IOC runs, and that EPICS_CA_ADDR_LIST names its computer."


class MotorRecords:
    """Some motor records. This is the line that ``WatchedStage`` wants: ``lock``, ``listen`` and ``close``."""

    def __init__(self, records: Sequence[str]) -> None:
        self.lock = threading.RLock()
        self._context = Context(timeout=ANSWER_S)
        names = [f"{record}.{field}" for record in records for field in FIELDS]
        self._channels = dict(zip(names, self._context.get_pvs(*names), strict=True))
        for name, channel in self._channels.items():
            try:
                channel.wait_for_connection(timeout=ANSWER_S)
            except CaprotoTimeoutError as error:
                self.close()
                raise PortNotFound(f"no IOC has {name}.", where=name, remedy=NETWORK) from error

    def read(self, record: str, field: str) -> float:
        """Return a number."""
        return float(self._try(f"{record}.{field}", lambda channel: channel.read()).data[0])

    def read_text(self, record: str, field: str) -> str:
        """Return a text."""
        data = self._try(f"{record}.{field}", lambda channel: channel.read()).data
        text = data[0] if isinstance(data[0], bytes) else bytes(data)
        return text.split(b"\0")[0].decode("latin-1")

    def write(self, record: str, field: str, value: float) -> None:
        """Write a number, and wait until the IOC has taken it."""
        self._try(f"{record}.{field}", lambda channel: channel.write([value], notify=True, wait=True))

    def listen(self, duration_s: float) -> None:
        """Wait; no clock of a run interrupts it."""
        time.sleep(duration_s)

    def close(self) -> None:
        """Disconnect. A second call does nothing."""
        self._context.disconnect()

    def _try(self, name: str, act: Callable[[Any], Any]) -> Any:
        try:
            return act(self._channels[name])
        except (CaprotoTimeoutError, TimeoutError) as error:
            raise ReplyTimeout(f"no answer within {ANSWER_S:g} s.", where=name, remedy=NETWORK) from error
        except (CaprotoError, ThreadingClientException, OSError) as error:
            raise PortLost(f"the connection is gone: {error}.", where=name, remedy=NETWORK) from error
