"""Talk to one Thorlabs controller on its line: whole messages, repeated queries, signs of life, confirmed stops.

Degrees belong to ``drivers.stage.thorlabs``, the forms of messages to ``drivers.stage.thorlabs_protocol``.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Final, TypeVar

from drivers.clock import Clock
from drivers.errors import ReplyGarbled, ReplyTimeout
from drivers.link import Link, ReplyReader
from drivers.readings import read_until_agreed
from drivers.retry import repeat
from drivers.serial_port import Port
from drivers.stage import thorlabs_protocol as apt
from drivers.stage.thorlabs_protocol import Information, Status
from drivers.stage.watched import read_back_otherwise
from drivers.wire_log import WireLog

_REPLY_S: Final = 0.5
_MARKER_S: Final = 0.45
_QUIET_S: Final = 0.05
_LONGEST_DRAIN_S: Final = 1.0
_STOP_POLL_S: Final = 0.02
_POLLS_A_STOP: Final = 5
"""While the axis moves, the stop is sent again after so many readings: it may be lost, and has no reply."""

T = TypeVar("T")


class ThorlabsController(Link):
    """The controller of one axis, on a line of messages. Opening asks for its identity; it sets nothing but silence.

    port: The open port; the protocol needs 115200 baud.
    clock, wire_log: See ``drivers.link.Link``.
    homings: How many ends of a homing it has reported.
    Raises DeviceRefused: This driver does not know the model.
    Raises ReplyError, PortLost: The controller does not answer.
    """

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        self._sign_of_life = b""
        self.homings = 0
        super().__init__(
            port,
            clock=clock,
            resynchronise=self._resynchronise,
            unsolicited=self._take_unasked,
            wire_log=wire_log,
        )
        self.mark_out_of_step()
        self.family = apt.family_of(self.read_information().model, self.name)
        if self.family.sign_of_life:
            self._sign_of_life = apt.short(apt.STILL_THERE)

    def take_line(self) -> bytes | None:
        """Take one unread message.

        Returns: The message; None when no complete one is unread.
        Raises ReplyGarbled: What is unread does not begin with a header. It is thrown away.
        """
        unread = self.unread
        if len(unread) < apt.HEAD_SIZE:
            return None
        try:
            return self.take(apt.size(unread[: apt.HEAD_SIZE], self.name))
        except ReplyGarbled:
            self.take(len(unread))
            raise

    def read_information(self) -> Information:
        """Ask who it is, until two answers agree."""
        return self._read_twice(
            lambda: Information.unpack(self._query(apt.REQUEST_INFORMATION, apt.INFORMATION_LAYOUT)),
            "the identity",
        )

    def read_status(self) -> Status:
        """Ask for the status, until two answers agree: one changed bit could give an axis a reference."""
        return self._read_twice(
            lambda: Status.unpack(self._query(apt.REQUEST_STATUS, apt.STATUS_LAYOUT)), "the status"
        )

    def read_position(self) -> int:
        """Ask once for the position; who needs it sure asks again.

        Returns: Position, in counts.
        """
        return int(
            apt.POSITION_LAYOUT.unpack(self._query(apt.REQUEST_POSITION, apt.POSITION_LAYOUT))[1],
        )

    def read_speed(self) -> tuple[int, int]:
        """Ask for acceleration and speed.

        Returns: Acceleration and speed, in the controller's units.
        """
        data = self._read_twice(lambda: self._query(apt.REQUEST_SPEED, apt.SPEED_LAYOUT), "the speed")
        _, _, acceleration, speed = apt.SPEED_LAYOUT.unpack(data)
        return int(acceleration), int(speed)

    def set_speed(self, acceleration: int, speed: int) -> None:
        """Set acceleration and speed, and read them back. It does no harm to set them twice.

        acceleration, speed: In the controller's units.
        """
        self._set_until_right(
            apt.long(apt.SET_SPEED, apt.SPEED_LAYOUT.pack(apt.CHANNEL, 0, acceleration, speed)),
            self.read_speed,
            (acceleration, speed),
            "acceleration and speed",
        )

    def is_enabled(self) -> bool:
        """Ask whether the channel is switched on.

        Returns: Whether it is.
        """

        def ask() -> int:
            def read_reply(reader: ReplyReader) -> int:
                return apt.parameter_of(reader.read_line(), apt.REQUEST_ENABLED, self.name)

            return repeat(lambda: self._exchange(apt.short(apt.REQUEST_ENABLED, apt.CHANNEL), read_reply))

        return self._read_twice(ask, "the state of the channel") == apt.ON

    def enable(self) -> None:
        """Switch the channel on: the motor holds its position."""
        self._set_until_right(
            apt.short(apt.SET_ENABLED, apt.CHANNEL, apt.ON), self.is_enabled, True, "the channel"
        )

    def move(self, count: int) -> None:
        """Start a move. The command is sent once, and has no reply.

        count: Target, in counts.
        """
        self._command(apt.long(apt.MOVE_TO, apt.POSITION_LAYOUT.pack(apt.CHANNEL, count)))

    def home(self) -> None:
        """Start a search of the reference. The command is sent once, and has no reply."""
        self._command(apt.short(apt.HOME, apt.CHANNEL))

    def stop(self, ramp_s: float) -> None:
        """Ramp down at once, and ask until the axis stands. A stop that shows no effect is sent again.

        ramp_s: Time of the ramp from full speed, in seconds.
        Raises ReplyError: The axis did not report that it stands.
        """
        with self.lock:
            repeat(lambda: self._stop_once(ramp_s), tries=2)

    # ------------------------------------------------------------ inside

    def _stop_once(self, ramp_s: float) -> None:
        request = self._sign_of_life + apt.short(apt.STOP, apt.CHANNEL, apt.STOP_BY_RAMP)
        for poll in range(math.ceil((2.0 * ramp_s + 0.5) / _STOP_POLL_S)):
            if poll % _POLLS_A_STOP == 0:
                self.write(request)
            if not self.read_status().moving:
                return
            self.receive(_STOP_POLL_S)
        raise ReplyTimeout(
            "the controller still reports a motion after a stop.",
            where=self.name,
            remedy="Cut the stage's power.",
        )

    def _set_until_right(self, request: bytes, read: Callable[[], T], wanted: T, what: str) -> None:
        """Send a setting that has no reply, and read it back; send it again if it got lost."""
        for _ in range(3):
            if read() == wanted:
                return
            self._command(request)
        if (got := read()) != wanted:
            raise read_back_otherwise(self.name, what, wanted, got)

    def _command(self, request: bytes) -> None:
        with self.lock:
            self.bring_into_step()
            self.write(request)

    def _read_twice(self, read: Callable[[], T], what: str) -> T:
        return read_until_agreed(read, what=what, where=self.name)

    def _query(self, message: int, layout: struct.Struct) -> bytes:
        """Send a query, repeat it when no valid reply comes, and return the data of the reply."""
        return repeat(lambda: self._query_once(message, layout))

    def _query_once(
        self, message: int, layout: struct.Struct, *, deadline_s: float = _REPLY_S, urgent: bool = False
    ) -> bytes:
        def read_reply(reader: ReplyReader) -> bytes:
            return apt.data_of(reader.read_line(), message, layout, self.name)

        channel = 0 if message == apt.REQUEST_INFORMATION else apt.CHANNEL
        return self._exchange(apt.short(message, channel), read_reply, deadline_s=deadline_s, urgent=urgent)

    def _exchange(
        self,
        request: bytes,
        read_reply: Callable[[ReplyReader], T],
        *,
        deadline_s: float = _REPLY_S,
        urgent: bool = False,
    ) -> T:
        return self.exchange(self._sign_of_life + request, read_reply, deadline_s=deadline_s, urgent=urgent)

    def _take_unasked(self, message: bytes) -> bool:
        unasked = apt.is_unasked(message)
        if unasked and message[:2] == apt.HOMED.to_bytes(2, "little"):
            self.homings += 1
        return unasked

    def _resynchronise(self) -> None:
        """Silence what another program has switched on; then get the identity, alone on the line."""

        def clear_device() -> None:
            # Nothing that could complete a cut command may be sent here: a move is a command with data.
            self.write(apt.short(apt.STOP_UPDATES))
            self.drain(_QUIET_S, _LONGEST_DRAIN_S)

        self.prove_in_step(
            lambda: self._query_once(
                apt.REQUEST_INFORMATION, apt.INFORMATION_LAYOUT, deadline_s=_MARKER_S, urgent=True
            ),
            quiet_s=_QUIET_S,
            limit_s=_LONGEST_DRAIN_S,
            clear_device=clear_device,
            once_if_silent=True,
        )
