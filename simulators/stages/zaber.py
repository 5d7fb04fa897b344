r"""Simulated controllers chained on one line, which speak the Zaber ASCII protocol: frames, addresses, ids, checksums.

    /device axis id words:LRC\n         a request; device 0 addresses all, id and checksum are optional
    @dd axis id OK|RJ BUSY|IDLE WW data:LRC\r\n     a reply, with the id of its request
    !dd axis BUSY|IDLE WW:LRC\r\n                   an alert, sent unasked at the end of a motion

The checksum (LRC) is the two's complement of the sum of all bytes between the first character and the colon.
A request with a wrong checksum is not answered. `zaber_controller` executes the commands.

Reference: Zaber's ASCII Protocol Manual, firmware 7.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from simulators.stages.axis_motion import Axis, AxisModel, MotionEvent, Unit
from simulators.world.trajectory import LoadTrajectory

#: Longest request, bytes; longer ones are dropped.
_MAX_REQUEST = 80

_END_OF_LINE = re.compile(rb"[\r\n]+")

#: Warning flags by rank: a reply carries the highest active one.
_RANK = "FF FH FV FO FD FC FM FN FQ FI FS FB FP FE FT WL WP WV WT WS WM WR WH NC NI NT NU NR"

#: Flags that `warnings clear` does not clear: they last as long as their cause.
_NOT_CLEARABLE = {"WR", "FO", "FH"}

#: Unit of the settings: maxspeed = 1.6384 x microsteps/s, accel = 1.6384 x microsteps/s^2 / 10000
#: (ASCII Protocol Manual, settings maxspeed and accel).
SPEED_UNIT = 1.6384

#: Largest values of the speed and acceleration settings.
_MAX_SPEED_SETTING = 16_777_216
_MAX_ACCELERATION_SETTING = 32_767  # 15 bits


#: ``accel`` reads the one and writes both of the settings of acceleration and deceleration.
_SAME_SETTING = {"accel": "motion.accelonly"}

#: Speed towards the reference sensor, degrees/s; the last part is ten times slower.
_HOME_SPEED_DEG_S = 20.0


def factory_settings(model: AxisModel) -> dict[str, int]:
    """Return the factory settings of a controller."""
    counts_per_deg = model.mechanics.counts_per_deg
    scale, limit = counts_per_deg * SPEED_UNIT, round(model.limit_deg * counts_per_deg)
    acceleration = round(model.acceleration_deg_s2 * scale / 10_000.0)
    return {
        "comm.alert": 0,
        "comm.checksum": 0,
        "maxspeed": round(model.speed_deg_s * scale),
        "limit.approach.maxspeed": round(_HOME_SPEED_DEG_S * scale),
        "motion.accelonly": acceleration,
        "motion.decelonly": acceleration,
        "resolution": 64,
        "limit.cycle.dist": 0,
        "limit.min": -limit,
        "limit.max": limit,
    }


def setting_range(name: str, settings: Mapping[str, int]) -> tuple[int, int]:
    """Return the range of a setting."""
    ranges = {
        "comm.alert": (0, 1),
        "comm.checksum": (0, 1),
        "maxspeed": (1, _MAX_SPEED_SETTING),
        "limit.approach.maxspeed": (1, _MAX_SPEED_SETTING),
        "motion.accelonly": (0, _MAX_ACCELERATION_SETTING),
        "motion.decelonly": (0, _MAX_ACCELERATION_SETTING),
        "resolution": (1, 256),
        "limit.cycle.dist": (0, 1_000_000_000),
        "limit.min": (-1_000_000_000, settings["limit.max"]),
        "limit.max": (settings["limit.min"], 1_000_000_000),
    }
    return ranges[name]


@dataclass
class CommandRejected(Exception):
    """A rejected command."""

    reason: str  # Data of the reply, e.g. ``BADDATA``.


class ZaberController(Unit):
    """A controller with one axis."""

    BOOT_S = 0.5

    def __init__(
        self,
        model: AxisModel,
        now_s: float = 0.0,
        publish: Callable[[LoadTrajectory], None] = lambda _pointing: None,
    ) -> None:
        self.model = model
        self.axis = Axis(model.mechanics, now_s, publish)
        super().__init__([self.axis], now_s)
        self._deliver()

    def _deliver(self) -> None:
        self._settings = factory_settings(self.model)
        self._parked = False
        self._power_up()

    def _power_up(self) -> None:
        self._flags: set[str] = set()
        self._was_busy = False

    # ------------------------------------------------------------------ fields of replies
    def awake(self, t_s: float) -> bool:
        """See `Unit.awake`."""
        self.take_events(t_s)
        return super().awake(t_s)

    def status(self, t_s: float) -> str:
        """Return the status word of a reply."""
        return "BUSY" if self.axis.reports_busy(t_s) else "IDLE"

    def warnings(self, t_s: float) -> list[str]:
        """Return all active warning flags."""
        flags = set(self._flags)
        if not self.axis.referenced(t_s):
            flags.add("WR")
        return sorted(flags, key=_RANK.index)

    @property
    def checksums(self) -> bool:
        """Whether its messages end in a checksum."""
        return bool(self._settings["comm.checksum"])

    def came_to_rest(self, t_s: float) -> bool:
        """Return whether an alert is due: a motion has ended since the last call, and alerts are enabled."""
        busy = self.axis.busy(t_s)
        ended = self._was_busy and not busy
        self._was_busy = busy
        return ended and bool(self._settings["comm.alert"])

    # ------------------------------------------------------------------ commands
    def execute(self, axis: int, words: list[str], t_s: float) -> str:
        """Execute a command of an axis (0: all axes), or read the status without words; else `CommandRejected`."""
        if axis > 1:
            raise CommandRejected("BADAXIS")
        if not words:
            return "0"
        commands: dict[str, Callable[[list[str], float], str]] = {
            "get": self._get,
            "set": self._set,
            "home": self._home,
            "move": self._move,
            "stop": self._stop,
            "warnings": self._warnings,
            "tools": self._tools,
        }
        if words[0] not in commands:
            raise CommandRejected("BADCOMMAND")
        return commands[words[0]](words[1:], t_s)

    def _get(self, words: list[str], t_s: float) -> str:
        if len(words) != 1:
            raise CommandRejected("BADCOMMAND")
        name = words[0]
        readings: dict[str, Callable[[], str]] = {
            **dict.fromkeys(("deviceid", "device.id"), lambda: "50958"),
            "system.serial": lambda: self.model.serial,
            "version": lambda: "7.38",
            "comm.packet.size.max": lambda: "80",
            "pos": lambda: str(round(self.axis.counter(t_s))),
            "parking.state": lambda: str(int(self._parked)),
        }
        if self.model.encoder:
            readings["encoder.pos"] = lambda: str(round(self.axis.encoder(t_s)))
        if name in readings:
            return readings[name]()
        name = _SAME_SETTING.get(name, name)
        if name in self._settings:
            return str(self._settings[name])
        raise CommandRejected("BADCOMMAND")

    def _set(self, words: list[str], t_s: float) -> str:
        if len(words) != 2:
            raise CommandRejected("BADCOMMAND")
        name, value = words[0], _integer(words[1])
        if name == "pos":
            self.axis.set_counter(value, t_s)
            self.axis.set_encoder(value, t_s)
            return "0"
        if name == "accel":
            self._set(["motion.decelonly", words[1]], t_s)
        name = _SAME_SETTING.get(name, name)
        if name not in self._settings:
            raise CommandRejected("BADCOMMAND")
        if name == "resolution":
            self._settings |= {
                limit: self._settings[limit] * value // self._settings["resolution"]
                for limit in ("limit.min", "limit.max")
            }
        lowest, highest = setting_range(name, self._settings)
        if not lowest <= value <= highest:
            raise CommandRejected("BADDATA")
        self._settings[name] = value
        return "0"

    def _home(self, words: list[str], t_s: float) -> str:
        _expect_no_arguments(words)
        self._begin_motion(t_s)
        speed = min(self._speed("limit.approach.maxspeed"), self._speed("maxspeed"))
        self.axis.home(t_s, speed, speed / 10.0, self._acceleration())
        self._was_busy = True
        return "0"

    def _move(self, words: list[str], t_s: float) -> str:
        lowest, highest = self._settings["limit.min"], self._settings["limit.max"]
        match words:
            case ["abs", target]:
                goal = _integer(target)
            case ["rel", way]:
                goal = round(self.axis.counter(t_s)) + _integer(way)
            case ["max"]:
                goal = highest
            case _:
                raise CommandRejected("BADCOMMAND")
        if not lowest <= goal <= highest:
            raise CommandRejected("BADDATA")
        self._begin_motion(t_s)
        self.axis.move_to(goal, t_s, self._speed("maxspeed"), self._acceleration())
        self._was_busy = self.axis.busy(t_s)
        return "0"

    def _begin_motion(self, t_s: float) -> None:
        """Reject an impossible motion; set flag NI if the motion interrupts another one."""
        if self._parked:
            raise CommandRejected("PARKED")
        if "FH" in self._flags:
            raise CommandRejected("DRIVERDISABLED")
        if self.axis.busy(t_s):
            self._flags.add("NI")
        else:
            self._flags.discard("NI")

    def _stop(self, words: list[str], t_s: float) -> str:
        _expect_no_arguments(words)
        if self.axis.busy(t_s):
            self._flags.add("NI")
            self.axis.stop(t_s, self._acceleration())
        return "0"

    def _warnings(self, words: list[str], t_s: float) -> str:
        if words not in ([], ["clear"]):
            raise CommandRejected("BADCOMMAND")
        flags = self.warnings(t_s)
        if words:
            self._flags &= _NOT_CLEARABLE
        return " ".join([f"{len(flags):02d}", *flags])

    def _tools(self, words: list[str], t_s: float) -> str:
        if words not in (["parking", "park"], ["parking", "unpark"]):
            raise CommandRejected("BADCOMMAND")
        if self.axis.busy(t_s):
            raise CommandRejected("STATUSBUSY")
        self._parked = words[1] == "park"
        return "0"

    # ------------------------------------------------------------------ events outside the protocol
    def emergency_stop(self, t_s: float, *, released: bool = False) -> None:
        """Press the emergency stop, which halts and holds the axis, or release it."""
        if released:
            self._flags.discard("FH")
            return
        self.axis.halt(t_s)
        self._flags.add("FH")

    def exchange(self, serial: str, t_s: float) -> None:
        """See `Unit.exchange`."""
        self.model = replace(self.model, serial=serial)
        self._deliver()
        self.restart(t_s)

    def _notice(self, axis: Axis, event: MotionEvent, t_s: float) -> None:
        del axis, t_s
        self._flags.add({"stall": "FS", "limit": "FE", "twist": "FT"}[event.kind])

    def restart(self, t_s: float) -> None:
        """See `Unit.restart`. A parked axis keeps its reference, and settings are kept."""
        self._moved = () if self._parked else (self.axis,)
        super().restart(t_s)
        self._moved = (self.axis,)

    # ------------------------------------------------------------------ internals
    def _speed(self, setting: str) -> float:
        return self._settings[setting] / SPEED_UNIT

    def _acceleration(self) -> float:
        return self._settings["motion.accelonly"] * 10_000.0 / SPEED_UNIT


def _integer(word: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise CommandRejected("BADDATA") from None


def _expect_no_arguments(words: list[str]) -> None:
    if words:
        raise CommandRejected("BADCOMMAND")


class Request(NamedTuple):
    """A parsed request."""

    device: int  # Number of the device; 0 stands for all
    axis: int  # Number of the axis; 0 stands for all
    message_id: str | None  # Two digits; None if the request has no id
    words: list[str]


def checksum(body: str) -> str:
    """Return the longitudinal redundancy check (LRC) of a message.

    >>> checksum("1 1 03 home")
    '32'
    """
    return f"{-sum(body.encode('ascii')) & 0xFF:02X}"


def parse_request(line: bytes) -> Request | None:
    """Parse a line; None if a controller does not answer it: noise, or a wrong checksum.

    >>> parse_request(b"/1 1 05 move abs 50000:B7")
    Request(device=1, axis=1, message_id='05', words=['move', 'abs', '50000'])
    >>> parse_request(b"/1 1 05 move abs 50001:B7") is None
    True
    """
    _, slash, rest = line.rpartition(b"/")
    if not slash or len(line) > _MAX_REQUEST or not rest.isascii():
        return None
    body, colon, given = rest.decode("ascii").partition(":")
    if colon and given.strip().upper() != checksum(body):
        return None
    words = body.split()
    numbers = 0
    while numbers < 3 and numbers < len(words) and words[numbers].isdigit():
        numbers += 1
    device, axis = ([int(word) for word in words[: min(numbers, 2)]] + [0, 0])[:2]
    message_id = f"{int(words[2]) % 100:02d}" if numbers == 3 else None
    return Request(device, axis, message_id, words[numbers:])


class ZaberChain:
    """Controllers on one line, as a dialect of it, in the order of their addresses, from 1."""

    baud = 115_200

    def __init__(self, controllers: Sequence[ZaberController], clock: Callable[[], float]) -> None:
        self.controllers = tuple(controllers)
        self._clock = clock
        self._buffer = b""

    def receive(self, data: bytes) -> bytes:
        """See `Dialect.receive`."""
        *lines, self._buffer = _END_OF_LINE.split(self._buffer + data)
        self._buffer = self._buffer[-2 * _MAX_REQUEST :]
        return b"".join(self._answers(line) for line in lines)

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. These are alerts at the end of motions."""
        now = self._clock()
        return b"".join(
            _frame("!", f"{address:02d} 1 {controller.status(now)} {_flag(controller, now)}", controller)
            for address, controller in enumerate(self.controllers, start=1)
            if controller.awake(now) and controller.came_to_rest(now)
        )

    def _answers(self, line: bytes) -> bytes:
        request = parse_request(line)
        if request is None:
            return b""
        return b"".join(
            self._answer(address, controller, request)
            for address, controller in enumerate(self.controllers, start=1)
            if request.device in {0, address} and controller.awake(self._clock())
        )

    def _answer(self, address: int, controller: ZaberController, request: Request) -> bytes:
        now = self._clock()
        try:
            verdict, data = "OK", controller.execute(request.axis, request.words, now)
        except CommandRejected as refusal:
            verdict, data = "RJ", refusal.reason
        message_id = f"{request.message_id} " if request.message_id else ""
        status = f"{verdict} {controller.status(now)} {_flag(controller, now)}"
        return _frame("@", f"{address:02d} {request.axis} {message_id}{status} {data}", controller)


def _flag(controller: ZaberController, now: float) -> str:
    """Return the highest warning flag, or "--"."""
    return (controller.warnings(now) or ["--"])[0]


def _frame(kind: str, body: str, controller: ZaberController) -> bytes:
    end = f":{checksum(body)}" if controller.checksums else ""
    return f"{kind}{body}{end}\r\n".encode("ascii")
