"""Talk to Dynamixel servos on one bus: whole packets, repeated questions, confirmed writes and stops.

Degrees and the names of axes belong to ``drivers.stage.dynamixel``.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Final, NamedTuple

from drivers.clock import Clock
from drivers.errors import DeviceRefused, ReplyError, ReplyGarbled
from drivers.link import Link, ReplyReader
from drivers.retry import repeat
from drivers.serial_port import Port
from drivers.stage import dynamixel_protocol as protocol
from drivers.stage.dynamixel_protocol import Packet, Settings, State
from drivers.wire_log import WireLog

_REPLY_S: Final = 0.5
_MARKER_S: Final = 0.3
_FIRST_STOP_S: Final = 0.2
_QUIET_S: Final = 0.03
_LONGEST_DRAIN_S: Final = 1.0
_BOOT_POLL_S: Final = 0.1
_BOOT_POLLS: Final = 30
_TICK_SLACK_S: Final = 0.05
_LONGEST_COMPARISON_S: Final = 10.0
"""The servo's own time repeats after 33 s."""
_PUSHING_COUNTS: Final = 20
"""A servo at rest that is further from its goal is blocked, and pushes."""
_SPEED_UNIT_COUNTS: Final = protocol.SPEED_UNIT_RPM * protocol.COUNTS_A_TURN / 60.0
_RAMP_UNIT_COUNTS: Final = protocol.RAMP_UNIT_REV_MIN2 * protocol.COUNTS_A_TURN / 3600.0


class _Age(NamedTuple):
    """The servo's own time in its latest state, and when it was asked and answered."""

    tick_ms: int
    sent_s: float
    received_s: float


class DynamixelBus(Link):
    """The servos on one line. Opening sends nothing.

    clock, wire_log: See ``drivers.link.Link``.
    """

    def __init__(
        self, port: Port, servos: Sequence[int], *, clock: Clock, wire_log: WireLog | None = None
    ) -> None:
        self._servos = tuple(servos)
        self._asked = self._servos[0]
        self._ages: dict[int, _Age] = {}
        super().__init__(
            port,
            clock=clock,
            resynchronise=self._resynchronise,
            unsolicited=self._is_echo,
            wire_log=wire_log,
        )
        self.mark_out_of_step()

    def take_line(self) -> bytes | None:
        """Take one unread packet. Bytes before a header are noise, and are thrown away.

        Returns: The packet; None when no complete one is unread.
        """
        while True:
            unread = self.unread
            start = unread.find(protocol.HEADER)
            if start < 0:
                self.take(max(0, len(unread) - len(protocol.HEADER) + 1))
                return None
            self.take(start)
            if len(unread) - start < protocol.HEAD_SIZE:
                return None
            size = protocol.size(unread[start : start + protocol.HEAD_SIZE])
            if size:
                return self.take(size)
            self.take(len(protocol.HEADER))

    def read_settings(self, servo: int) -> Settings:
        """Ask for the settings that outlast a loss of power."""
        return Settings.unpack(repeat(lambda: self._read(servo, 0, protocol.SETTINGS_SIZE)))

    def read_state(self, servo: int) -> State:
        """Ask for the state."""
        return repeat(lambda: self._read_state(servo))

    def write_value(self, servo: int, address: int, data: bytes) -> None:
        """Write a value; repeat it when no status packet comes, which does no harm.

        data: The value. Not a goal while the torque is on: see `move`.
        Raises ReplyError: No valid status packet came at the last attempt.
        """
        repeat(lambda: self._write(servo, address, data))

    def move(self, servo: int, goal: int) -> None:
        """Write a goal, once.

        goal: Target, in counts.
        Raises ReplyError: No valid status packet came: the axis may be moving.
        """
        self._write(servo, protocol.GOAL, struct.pack("<i", goal))

    def reboot(self, servo: int) -> None:
        """Restart a servo, once, and wait until it answers. Its torque is off then.

        Raises ReplyError: It does not answer.
        """
        self._exchange(servo, protocol.REBOOT, b"", 0)
        for _ in range(_BOOT_POLLS):
            self._clock.sleep(_BOOT_POLL_S)
            try:
                self._exchange(servo, protocol.PING, b"", 3, deadline_s=_BOOT_POLL_S)
            except ReplyError:
                continue
            return
        self.read_state(servo)

    def stop_all(self) -> None:
        """Set the goal of every servo where it can come to rest, and read it back.

        A servo that does not answer does not delay the stop of the others: it is asked again after them. The torque
        stays on, so that no axis falls.

        Raises ReplyError: A servo did not confirm its stop at the last attempt.
        """
        with self.lock:
            left = []
            for servo in self._servos:
                try:
                    self._stop(servo, deadline_s=_FIRST_STOP_S)
                except ReplyError:
                    left.append(servo)
            failed: ReplyError | None = None
            for servo in left:
                try:
                    repeat(lambda servo=servo: self._stop(servo))  # type: ignore[misc]
                except ReplyError as error:
                    failed = error
            if failed is not None:
                raise failed

    # ------------------------------------------------------------ inside

    def _stop(self, servo: int, deadline_s: float = _REPLY_S) -> None:
        state = self._read_state(servo, deadline_s)
        if not state.torque:
            return
        goal = _resting_goal(state)
        if goal != state.goal:
            self._write(servo, protocol.GOAL, struct.pack("<i", goal), deadline_s)
            state = self._read_state(servo, deadline_s)
        if state.torque and state.goal != goal:
            raise ReplyGarbled(
                f"servo {servo} did not take the goal of a stop.",
                where=self.name,
                remedy="Cut the servo's power.",
            )

    def _read_state(self, servo: int, deadline_s: float = _REPLY_S) -> State:
        with self.lock:
            self._asked = servo
            self.bring_into_step()
            sent_s = self._clock.monotonic()
            state = State.unpack(self._read(servo, protocol.STATE_FIRST, protocol.STATE_SIZE, deadline_s))
            self._check_age(servo, state, sent_s, self._clock.monotonic())
            return state

    def _check_age(self, servo: int, state: State, sent_s: float, received_s: float) -> None:
        """Refuse a state that the servo's own clock shows to be an old one: a late packet looks like its successor."""
        before = self._ages.pop(servo, None)
        if before is not None and received_s - before.sent_s < _LONGEST_COMPARISON_S:
            tick_s = (state.tick_ms - before.tick_ms) % protocol.TICK_PERIOD_MS / 1000.0
            least_s = 0.5 * (sent_s - before.received_s) - _TICK_SLACK_S
            most_s = 2.0 * (received_s - before.sent_s) + _TICK_SLACK_S
            if not least_s <= tick_s <= most_s:
                self.mark_out_of_step()
                raise protocol.garbled(
                    f"servo {servo} sent a state of another moment, or has restarted.", self.name
                )
        self._ages[servo] = _Age(state.tick_ms, sent_s, received_s)

    def _read(self, servo: int, first: int, count: int, deadline_s: float = _REPLY_S) -> bytes:
        request = struct.pack("<HH", first, count)
        return self._exchange(servo, protocol.READ, request, count, deadline_s=deadline_s)

    def _write(self, servo: int, address: int, data: bytes, deadline_s: float = _REPLY_S) -> None:
        request = struct.pack("<H", address) + data
        self._exchange(servo, protocol.WRITE, request, 0, deadline_s=deadline_s)

    def _exchange(
        self,
        servo: int,
        instruction: int,
        parameters: bytes,
        count: int,
        *,
        deadline_s: float = _REPLY_S,
        urgent: bool = False,
    ) -> bytes:
        """Send an instruction, and return the parameters of its status packet."""

        def read_reply(reader: ReplyReader) -> bytes | DeviceRefused:
            while True:
                status = self._parse(reader.read_line())
                if status.servo == servo:  # a late packet of another servo is no answer
                    try:
                        return protocol.data_of(status, count, self.name)
                    except DeviceRefused as error:
                        return error

        with self.lock:
            self._asked = servo
            answer = self.exchange(
                protocol.packet(servo, instruction, parameters),
                read_reply,
                deadline_s=deadline_s,
                urgent=urgent,
            )
        if isinstance(answer, DeviceRefused):
            raise answer
        return answer

    def _parse(self, data: bytes) -> Packet:
        return protocol.parse(data, self.name)

    def _is_echo(self, data: bytes) -> bool:
        """Whether a packet is an instruction: an adapter of one wire hears what it sends."""
        return self._parse(data).instruction != protocol.STATUS

    def _resynchronise(self) -> None:
        """Wait for silence; then get the answer to a ping, which no other instruction has, alone on the line."""
        self.prove_in_step(
            lambda: self._exchange(self._asked, protocol.PING, b"", 3, deadline_s=_MARKER_S, urgent=True),
            quiet_s=_QUIET_S,
            limit_s=_LONGEST_DRAIN_S,
            remedy="Check the cable, and that no two servos have the same id.",
            once_if_silent=True,
        )


def _resting_goal(state: State) -> int:
    """Return the goal at which a servo comes to rest by its ramp, at most the present goal."""
    away = state.goal - state.position
    if not state.moving:
        return state.goal if abs(away) <= _PUSHING_COUNTS else state.position
    speed, ramp = state.velocity * _SPEED_UNIT_COUNTS, state.ramp * _RAMP_UNIT_COUNTS
    braking = math.trunc(speed * abs(speed) / (2.0 * ramp)) if ramp else 0
    if braking * away > 0 and abs(braking) > abs(away):
        return state.goal
    return state.position + braking
