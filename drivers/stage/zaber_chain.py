"""Knows how to ask a chain of Zaber devices on one line: ids, retries, resynchronising, stopping all.

Knows no degrees and no axes' names; see ``drivers.stage.zaber``.
"""

from __future__ import annotations

import itertools
import re
import threading
from collections import deque
from collections.abc import Collection

from drivers.clock import Clock
from drivers.errors import DeviceRefused, ReplyGarbled
from drivers.link import Incoming, Link
from drivers.retry import repeat, resynchronise
from drivers.serial_port import Port
from drivers.stage import zaber_protocol
from drivers.stage.zaber_protocol import Reply, Unsolicited
from drivers.wire_log import WireLog

_REPLY_S = 1.0
"""A reply takes some ms; the rest is for a busy host."""
_MARKER_S = 0.5
_QUIET_S = 0.05
_LOUD_S = 1.0


class ZaberChain:
    """The devices on one line.

    Parameters
    ----------
    port
        The open port.
    devices
        Addresses of the devices that are ours.
    clock, wire_log
        See ``drivers.link.Link``.

    Attributes
    ----------
    unsolicited
        The latest alerts and information lines, oldest first.
    """

    def __init__(
        self, port: Port, devices: Collection[int], *, clock: Clock, wire_log: WireLog | None = None
    ) -> None:
        self.unsolicited: deque[Unsolicited] = deque(maxlen=100)
        self._devices = sorted(set(devices))
        self._ids = itertools.cycle(range(100))
        self._link = Link(
            port,
            clock=clock,
            resynchronise=self._resynchronise,
            unsolicited=self._take_unsolicited,
            wire_log=wire_log,
        )

    @property
    def name(self) -> str:
        """The port's name."""
        return self._link.name

    @property
    def lock(self) -> threading.RLock:
        """Held, nobody else can send."""
        return self._link.lock

    def command(self, device: int, axis: int, words: str) -> Reply:
        """Send one request, once: what makes something move is never sent twice.

        Raises DeviceRefused, ReplyTimeout, ReplyGarbled, PortLost.
        """
        reply = self._ask(device, axis, words)
        if not reply.accepted:
            reason = zaber_protocol.REFUSALS.get(reply.data, reply.data)
            raise DeviceRefused(
                f"device {device} refuses '{words}': {reason} ({reply.data}).",
                where=self.name,
                remedy="See the controller's manual for this command.",
            )
        return reply

    def query(self, device: int, axis: int, words: str) -> Reply:
        """Send a request that does no harm when it is sent again, up to three times in all.

        Raises as ``command``.
        """
        return repeat(lambda: self.command(device, axis, words))

    def number(self, device: int, axis: int, words: str) -> int:
        """Send a query whose answer is one whole number. Raises as ``command``."""
        data = self.query(device, axis, words).data
        return self.whole(data)

    def whole(self, data: str) -> int:
        """Understand data as one whole number. Raises ReplyGarbled."""
        if not re.fullmatch(r"-?\d{1,18}", data, re.ASCII):
            self._link.distrust()
            raise ReplyGarbled(
                f"{data!r} where a whole number belongs.", where=self.name, remedy="See the wire log."
            )
        return int(data)

    def flags(self, device: int, axis: int) -> tuple[str, ...]:
        """Return all warning flags of an axis. Raises as ``command``."""
        data = self.query(device, axis, "warnings").data
        try:
            return zaber_protocol.parse_flags(data, self.name)
        except ReplyGarbled:
            self._link.distrust()
            raise

    def setting(self, device: int, axis: int, name: str) -> int | None:
        """Return a setting that is a whole number; None when the device has no such setting."""
        try:
            return self.number(device, axis, f"get {name}")
        except DeviceRefused:
            return None

    def stop_all(self) -> None:
        """Send one stop to every device on the line, and see that each of ours heard it.

        Goes out at once, before any resynchronising. Raises ReplyTimeout, PortLost.
        """
        with self._link.lock:
            repeat(self._stop_once)

    def listen(self, seconds: float) -> None:
        """Wait that long for what comes. A wait that no clock interrupts: for stopping only."""
        with self._link.lock:
            self._link.fill(seconds)

    def close(self) -> None:
        """Give the port back."""
        self._link.close()

    def _stop_once(self) -> None:
        message_id = next(self._ids)
        deaf = set(self._devices)

        def receive(incoming: Incoming) -> None:
            while deaf:
                try:
                    reply = zaber_protocol.parse_reply(incoming.line(), self.name)
                except ReplyGarbled:
                    continue  # an answer to what was asked before, cut in two by the stop
                if reply.message_id == message_id and reply.accepted:
                    deaf.discard(reply.device)

        request = zaber_protocol.request(0, 0, message_id, "stop")
        self._link.exchange(request, receive, deadline_s=_REPLY_S, urgent=True)

    def _ask(
        self, device: int, axis: int, words: str, *, deadline_s: float = _REPLY_S, urgent: bool = False
    ) -> Reply:
        message_id = next(self._ids)

        def receive(incoming: Incoming) -> Reply:
            reply = zaber_protocol.parse_reply(incoming.line(), self.name)
            if (reply.device, reply.axis, reply.message_id) != (device, axis, message_id):
                raise ReplyGarbled(
                    f"the answer to another request came: {reply}.",
                    where=self.name,
                    remedy="See the wire log.",
                )
            return reply

        request = zaber_protocol.request(device, axis, message_id, words)
        return self._link.exchange(request, receive, deadline_s=deadline_s, urgent=urgent)

    def _resynchronise(self) -> None:
        """Wait for silence; then the answer to a fresh id proves that no older one is to come."""

        def exchange_marker() -> bool:
            self._ask(self._devices[0], 0, "", deadline_s=_MARKER_S, urgent=True)
            return True

        resynchronise(self._link, exchange_marker, quiet_s=_QUIET_S, limit_s=_LOUD_S, silence_after=False)

    def _take_unsolicited(self, line: bytes) -> bool:
        message = zaber_protocol.parse_unsolicited(line, self.name)
        if message is not None:
            self.unsolicited.append(message)
        return message is not None
