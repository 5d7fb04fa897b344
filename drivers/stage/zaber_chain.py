"""Talk to a chain of Zaber devices on one line: message ids, repeated queries, resynchronising, stopping all.

Degrees and the names of axes belong to ``drivers.stage.zaber``.
"""

from __future__ import annotations

import itertools
import re
from collections import deque
from collections.abc import Collection

from drivers.clock import Clock
from drivers.errors import DeviceRefused, ReplyGarbled
from drivers.link import Link, ReplyReader
from drivers.retry import repeat
from drivers.serial_port import Port
from drivers.stage import zaber_protocol
from drivers.stage.zaber_protocol import Reply, Unsolicited
from drivers.wire_log import WireLog

_REPLY_S = 1.0
"""Longest wait for a reply, in seconds. A reply takes some ms; the rest is for a busy computer."""
_MARKER_S = 0.5
_QUIET_S = 0.05
_LONGEST_DRAIN_S = 1.0


class ZaberChain(Link):
    """A chain of devices on one line. Opening sends nothing.

    devices: Addresses of the devices that this driver uses; others in the chain are stopped by ``stop_all``
      only.
    clock, wire_log: See ``drivers.link.Link``.
    unsolicited: The latest 100 alerts and information lines, oldest first.
    """

    def __init__(
        self, port: Port, devices: Collection[int], *, clock: Clock, wire_log: WireLog | None = None
    ) -> None:
        self.unsolicited: deque[Unsolicited] = deque(maxlen=100)
        self._devices = sorted(set(devices))
        self._ids = itertools.cycle(range(100))
        super().__init__(
            port,
            clock=clock,
            resynchronise=self._resynchronise,
            unsolicited=self._take_unsolicited,
            wire_log=wire_log,
        )

    def command(self, device: int, axis: int, words: str) -> Reply:
        """Send a command, once: a command that moves something must never be sent twice.

        device: Address of the device; 0 for all.
        axis: Number of the axis on the device; 0 for the device itself.
        words: The command with its parameters, such as ``move abs 50000``.
        Returns: The device's reply, which accepts the command.
        Raises ReplyTimeout, ReplyGarbled: No valid reply came.
        """
        reply = self._ask_once(device, axis, words)
        if not reply.accepted:
            reason = zaber_protocol.REFUSALS.get(reply.data, reply.data)
            raise DeviceRefused(
                f"device {device} refuses '{words}': {reason} ({reply.data}).",
                where=self.name,
                remedy="Look this command up in the controller's manual.",
            )
        return reply

    def query(self, device: int, axis: int, words: str) -> Reply:
        """Send a command that does no harm when it is sent twice; repeat it when no valid reply comes.

        device, axis, words: See ``command``.
        Returns: The device's reply, which accepts the command.
        Raises ReplyTimeout, ReplyGarbled: No valid reply came at the last attempt.
        """
        return repeat(lambda: self.command(device, axis, words))

    def query_integer(self, device: int, axis: int, words: str) -> int:
        """Send a query whose answer is one integer.

        device, axis, words: See ``command``.
        Raises ReplyTimeout, ReplyGarbled: No valid reply came at the last attempt, or the answer is no
          integer.
        """
        data = self.query(device, axis, words).data
        return self.parse_integer(data)

    def parse_integer(self, data: str) -> int:
        """Parse the data of a reply as one integer.

        data: Data of a reply.
        Raises ReplyGarbled: The data are no integer; the line is then out of step.
        """
        if not re.fullmatch(r"-?\d{1,18}", data, re.ASCII):
            self.mark_out_of_step()
            raise ReplyGarbled(
                f"{data!r} came instead of an integer.", where=self.name, remedy="Look into the wire log."
            )
        return int(data)

    def query_flags(self, device: int, axis: int) -> tuple[str, ...]:
        """Ask for all warning flags of an axis.

        device, axis: See ``command``.
        Raises ReplyTimeout, ReplyGarbled: No valid reply came at the last attempt, or the answer is no list
          of flags.
        """
        data = self.query(device, axis, "warnings").data
        try:
            return zaber_protocol.parse_flags(data, self.name)
        except ReplyGarbled:
            self.mark_out_of_step()
            raise

    def query_setting(self, device: int, axis: int, name: str) -> int | None:
        """Ask for a setting that is an integer.

        device, axis: See ``command``.
        name: Name of the setting, such as ``limit.max``.
        Returns: The value; None when the device refuses the query, because it has no such setting.
        """
        try:
            return self.query_integer(device, axis, f"get {name}")
        except DeviceRefused:
            return None

    def stop_all(self) -> None:
        """Send one stop to every device on the line, and check that each device of this driver has accepted it.

        The stop is sent at once, without resynchronising.

        Raises ReplyError: A device did not accept the stop at the last attempt.
        """
        with self.lock:
            repeat(self._stop_once)

    def _stop_once(self) -> None:
        message_id = next(self._ids)
        waiting_for = set(self._devices)

        def read_reply(reader: ReplyReader) -> None:
            while waiting_for:
                try:
                    reply = zaber_protocol.parse_reply(reader.read_line(), self.name)
                except ReplyGarbled:
                    continue  # the reply to an older request, which the stop has cut in two
                if reply.message_id == message_id and reply.accepted:
                    waiting_for.discard(reply.device)

        request = zaber_protocol.request(0, 0, message_id, "stop")
        self.exchange(request, read_reply, deadline_s=_REPLY_S, urgent=True)

    def _ask_once(
        self, device: int, axis: int, words: str, *, deadline_s: float = _REPLY_S, urgent: bool = False
    ) -> Reply:
        message_id = next(self._ids)

        def read_reply(reader: ReplyReader) -> Reply:
            reply = zaber_protocol.parse_reply(reader.read_line(), self.name)
            if (reply.device, reply.axis, reply.message_id) != (device, axis, message_id):
                raise ReplyGarbled(
                    f"the answer to another request came: {reply}.",
                    where=self.name,
                    remedy="Look into the wire log.",
                )
            return reply

        request = zaber_protocol.request(device, axis, message_id, words)
        return self.exchange(request, read_reply, deadline_s=deadline_s, urgent=urgent)

    def _resynchronise(self) -> None:
        """Wait for silence; then the reply to a new message id proves that no older reply is unread."""
        self.prove_in_step(
            lambda: self._ask_once(self._devices[0], 0, "", deadline_s=_MARKER_S, urgent=True),
            quiet_s=_QUIET_S,
            limit_s=_LONGEST_DRAIN_S,
            silence_after=False,
        )

    def _take_unsolicited(self, line: bytes) -> bool:
        message = zaber_protocol.parse_unsolicited(line, self.name)
        if message is not None:
            self.unsolicited.append(message)
        return message is not None
