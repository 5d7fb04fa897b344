"""Talk to one Thorlabs controller by the APT protocol: repeated queries, signs of life, confirmed stops.

Moves and settings have no reply, so a setting is read back. Degrees belong to ``drivers.stage.thorlabs``.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Final, TypeVar

from drivers.clock import Clock
from drivers.errors import ReplyGarbled, ReplyTimeout
from drivers.link import TRIES, repeat
from drivers.serial_port import Port
from drivers.stage import thorlabs_messages as apt
from drivers.stage.line_per_axis import AxisController
from drivers.stage.refusals import read_back_otherwise
from drivers.wire_log import WireLog

_MARKER_S: Final = 0.45
"""Longest wait for the identity, which shows that no older reply will follow. After 0.3 s, a unit that restarts has not
answered yet."""
_STOP_POLL_S: Final = 0.02  # Pause between two readings, so that a stop is seen at once
_POLLS_A_STOP: Final = 5
"""While the axis moves, the stop is sent again after so many readings: it may be lost, and has no reply."""

T = TypeVar("T")


class ThorlabsController(AxisController):
    """The controller of one axis, on a line of messages. Opening asks for its identity; it sets nothing but silence.

    The protocol needs 115200 baud. ``homings`` is how many ends of a homing it has reported, ``reports`` what it has
    reported against the latest command, in words. An unknown model is refused.
    """

    SILENT_REMEDY = f"Check that the controller is switched on, and its port. {apt.NO_BAYS}"
    reply_s = 0.5  # The longest message takes 23 ms; the rest is for a busy computer

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        self._sign_of_life = b""
        self.homings = 0
        self.reports: list[str] = []
        super().__init__(port, clock=clock, wire_log=wire_log)
        self.mark_out_of_step()
        self.family = apt.family_of(self.read_information().model, self.name)
        if self.family.sign_of_life:
            self._sign_of_life = apt.short(apt.STILL_THERE)

    def take_line(self) -> bytes | None:
        """Take one unread message; None when no complete one is unread.

        What does not begin with a header raises `ReplyGarbled` and is thrown away.
        """
        unread = self.unread
        if len(unread) < apt.HEAD_SIZE:
            return None
        try:
            return self.take(apt.size(unread[: apt.HEAD_SIZE], self.name))
        except ReplyGarbled:
            self.take(len(unread))
            raise

    def take_unsolicited(self, line: bytes) -> bool:
        """Take a message that answers no request; count the ends of homings, and keep what it reports."""
        message = struct.unpack_from("<H", line)[0]
        self.homings += message == apt.HOMED
        if message == apt.FAULT:
            self.reports.append("the controller reports a fault of itself (message 0x0080)")
        elif message == apt.REFUSED and len(line) == apt.HEAD_SIZE + apt.REFUSED_LAYOUT.size:
            request, code, notes = apt.REFUSED_LAYOUT.unpack(line[apt.HEAD_SIZE :])
            words = notes.split(b"\0")[0].decode("ascii", errors="replace").strip()
            self.reports.append(
                f"the controller reports '{words or 'no reason'}' (code {code}, request {request:#06x})"
            )
        return message in apt.UNASKED

    def read_information(self) -> apt.Information:
        """Ask who it is, until two answers agree."""
        return self.agreed(
            lambda: apt.Information.unpack(self._query(apt.REQUEST_INFORMATION, apt.INFORMATION_LAYOUT)),
            "the identity",
        )

    def read_status(self) -> apt.Status:
        """Ask for the status, until two answers agree: one changed bit could give an axis a reference."""
        return self.agreed(
            lambda: apt.Status.unpack(self._query(apt.REQUEST_STATUS, apt.STATUS_LAYOUT)), "the status"
        )

    def read_position(self) -> int:
        """Ask once for the position, counts; who needs it sure asks again."""
        return int(apt.POSITION_LAYOUT.unpack(self._query(apt.REQUEST_POSITION, apt.POSITION_LAYOUT))[1])

    def read_speed(self) -> tuple[int, int]:
        """Ask for acceleration and speed, in the controller's units."""
        data = self.agreed(lambda: self._query(apt.REQUEST_SPEED, apt.SPEED_LAYOUT), "the speed")
        _, _, acceleration, speed = apt.SPEED_LAYOUT.unpack(data)
        return int(acceleration), int(speed)

    def set_speed(self, acceleration: int, speed: int) -> None:
        """Set acceleration and speed, in the controller's units, and read them back; twice does no harm."""
        self._set_until_right(
            apt.long(apt.SET_SPEED, apt.SPEED_LAYOUT.pack(apt.CHANNEL, 0, acceleration, speed)),
            self.read_speed,
            lambda present: apt.same_speed(acceleration, present[0]) and apt.same_speed(speed, present[1]),
            "acceleration and speed",
            (acceleration, speed),
        )

    def read_home(self) -> apt.HomeParameters | None:
        """Ask for the parameters of a search of the reference; None if the controller does not tell them."""
        try:
            data = self.agreed(lambda: self._query(apt.REQUEST_HOME, apt.HOME_LAYOUT), "the home parameters")
        except ReplyTimeout as error:
            self._require_alive(error)
            return None
        return apt.HomeParameters(*apt.HOME_LAYOUT.unpack(data)[1:])

    def set_home(self, wanted: apt.HomeParameters) -> apt.HomeParameters | None:
        """Set the parameters of a search of the reference; return what is read back, as `read_home`."""
        request = apt.long(apt.SET_HOME, apt.HOME_LAYOUT.pack(apt.CHANNEL, *vars(wanted).values()))
        if self.read_home() is None:
            self._command(request)
            return None
        self._set_until_right(request, self.read_home, wanted.agrees, "the home parameters", wanted)
        return self.read_home()

    def clear_backlash(self) -> None:
        """Switch a correction of backlash off, which overruns the target; a controller without one does not answer."""
        try:
            self._set_until_right(
                apt.long(apt.SET_BACKLASH, apt.POSITION_LAYOUT.pack(apt.CHANNEL, 0)),
                lambda: apt.POSITION_LAYOUT.unpack(self._query(apt.REQUEST_BACKLASH, apt.POSITION_LAYOUT))[1],
                lambda counts: counts == 0,
                "the backlash correction",
                0,
            )
        except ReplyTimeout as error:
            self._require_alive(error)

    def is_enabled(self) -> bool:
        """Ask whether the channel is switched on."""
        state = self.agreed(
            lambda: self._ask(
                apt.REQUEST_ENABLED, lambda reply: apt.parameter_of(reply, apt.REQUEST_ENABLED, self.name)
            ),
            "the state of the channel",
        )
        return state == apt.ON

    def enable(self) -> None:
        """Switch the channel on: the motor holds its position."""
        self._set_until_right(
            apt.short(apt.SET_ENABLED, apt.CHANNEL, apt.ON), self.is_enabled, bool, "the channel", True
        )

    def move(self, count: int) -> None:
        """Start a move to a count. The command is sent once, and has no reply."""
        self.reports.clear()
        self._command(apt.long(apt.MOVE_TO, apt.POSITION_LAYOUT.pack(apt.CHANNEL, count)))

    def home(self) -> None:
        """Start a search of the reference. The command is sent once, and has no reply."""
        self.reports.clear()
        self._command(apt.short(apt.HOME, apt.CHANNEL))

    def stop(self, ramp_s: float) -> None:
        """Ramp down at once, and ask until the axis stands, else raise `ReplyError`.

        A stop that shows no effect is sent again; ``ramp_s`` is the time of the ramp from full speed.
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

    def _set_until_right(
        self, request: bytes, read: Callable[[], T], is_right: Callable[[T], bool], what: str, wanted: object
    ) -> None:
        """Send a setting that has no reply, and read it back; send it again if it got lost."""
        for _ in range(3):
            if is_right(read()):
                return
            self._command(request)
        if not is_right(got := read()):
            raise read_back_otherwise(self.name, what, wanted, got)

    def _require_alive(self, error: ReplyTimeout) -> None:
        """Raise the error of a silence unless the controller answers another question: it did not know that one."""
        if error.late_s:
            raise error
        self.read_status()

    def _command(self, request: bytes) -> None:
        with self.lock:
            self.bring_into_step()
            self.write(request)

    def _query(self, message: int, layout: struct.Struct, *, tries: int = TRIES) -> bytes:
        """Send a query and return the data of the reply; see `_ask`."""
        return self._ask(message, lambda reply: apt.data_of(reply, message, layout, self.name), tries=tries)

    def _ask(self, message: int, parse: Callable[[bytes], T], *, tries: int = TRIES) -> T:
        """Send a query, ``tries`` times in all until its reply is valid; return what ``parse`` makes of the reply."""
        channel = 0 if message == apt.REQUEST_INFORMATION else apt.CHANNEL
        request = self._sign_of_life + apt.short(message, channel)
        return repeat(lambda: self.exchange(request, lambda reader: parse(reader.read_line())), tries=tries)

    def _resynchronise(self) -> None:
        """Silence what another program has switched on; then get the identity, alone on the line."""

        def clear_device() -> None:
            # Nothing that could complete a cut command may be sent here: a move is a command with data.
            self.write(apt.short(apt.STOP_UPDATES))
            self.drain()

        self.prove_in_step(
            lambda: self._query(apt.REQUEST_INFORMATION, apt.INFORMATION_LAYOUT, tries=1),
            marker_s=_MARKER_S,
            clear_device=clear_device,
            once_if_silent=True,
        )
