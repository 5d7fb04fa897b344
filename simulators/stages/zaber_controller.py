"""One controller of the Zaber X-RST kind with its axis: settings, warning flags and commands.

`zaber` handles frames and checksums; `axis_motion` moves the axis. Reference: Zaber's ASCII Protocol Manual, firmware
7; the warning flags are those of Zaber's own library (zaber-motion).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from simulators.stages.axis_motion import Axis
from simulators.stages.zaber_model import SPEED_UNIT, ZaberModel, setting_range
from simulators.world.trajectory import LoadTrajectory

#: Warning flags by rank: a reply carries the highest active one.
_RANK = "FF FH FV FO FD FC FM FN FQ FI FS FB FP FE FT WL WP WV WT WS WM WR WH NC NI NT NU NR"

#: Flags that `warnings clear` does not clear: they last as long as their cause.
_NOT_CLEARABLE = {"WR", "FO", "FH"}


@dataclass
class CommandRejected(Exception):
    """A rejected command."""

    reason: str  # Data of the reply, e.g. ``BADDATA``.


@dataclass
class _State:
    """Everything that a power cycle resets."""

    settings: dict[str, int]
    flags: set[str] = field(default_factory=set)
    parked: bool = False
    was_busy: bool = False


class ZaberController:
    """A controller with one axis.

    now_s: Time of power-up, s.
    """

    def __init__(
        self,
        model: ZaberModel,
        now_s: float = 0.0,
        publish: Callable[[LoadTrajectory], None] = lambda _pointing: None,
    ) -> None:
        self.model = model
        self.axis = Axis(model.mechanics, now_s, publish)
        self._state = self._powered_up()
        self._boot_ends_s = now_s

    # ------------------------------------------------------------------ fields of replies
    def awake(self, t_s: float) -> bool:
        """Return whether the controller answers; it does not while it boots.

        t_s: Time, s.
        Returns: Whether it answers.
        """
        self._take_events(t_s)
        return t_s >= self._boot_ends_s

    def status(self, t_s: float) -> str:
        """Return the status word of a reply.

        t_s: Time, s.
        Returns: BUSY during a ramp, otherwise IDLE.
        """
        return "BUSY" if self.axis.reports_busy(t_s) else "IDLE"

    def warnings(self, t_s: float) -> list[str]:
        """Return all active warning flags.

        t_s: Time, s.
        Returns: Flags by rank, the highest first.
        """
        flags = set(self._state.flags)
        if not self.axis.referenced(t_s):
            flags.add("WR")
        return sorted(flags, key=_RANK.index)

    @property
    def checksums(self) -> bool:
        """Whether its messages end in a checksum."""
        return bool(self._state.settings["comm.checksum"])

    def came_to_rest(self, t_s: float) -> bool:
        """Return whether an alert is due: a motion has ended since the last call, and alerts are enabled.

        t_s: Time, s.
        Returns: Whether an alert is due.
        """
        busy = self.axis.busy(t_s)
        ended = self._state.was_busy and not busy
        self._state.was_busy = busy
        return ended and bool(self._state.settings["comm.alert"])

    # ------------------------------------------------------------------ commands
    def execute(self, axis: int, words: list[str], t_s: float) -> str:
        """Execute a command.

        axis: Addressed axis; 0 for the controller and all its axes.
        words: Words of the command; empty to read the status only.
        t_s: Time of its arrival, s.
        Raises CommandRejected: If the reply is a rejection.
        """
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
            "estop": self._estop,
            "warnings": self._warnings,
            "tools": self._tools,
            "system": self._system,
        }
        if words[0] not in commands:
            raise CommandRejected("BADCOMMAND")
        return commands[words[0]](words[1:], t_s)

    def _get(self, words: list[str], t_s: float) -> str:
        if len(words) != 1:
            raise CommandRejected("BADCOMMAND")
        name = words[0]
        readings: dict[str, Callable[[], str]] = {
            "deviceid": lambda: str(self.model.device_id),
            "system.serial": lambda: self.model.serial,
            "version": lambda: self.model.firmware,
            "version.build": lambda: self.model.build,
            "system.axiscount": lambda: "1",
            "system.voltage": lambda: "47.9",
            "system.temperature": lambda: "31.4",
            "comm.packet.size.max": lambda: "80",
            "comm.word.size.max": lambda: "50",
            "comm.command.packets.max": lambda: "1",
            "get.settings.max": lambda: "1",
            "resolution": lambda: "64",
            "pos": lambda: str(round(self.axis.counter(t_s))),
            "vel": lambda: str(round(self.axis.velocity(t_s) * SPEED_UNIT)),
            "limit.home.triggered": lambda: str(int(self.axis.referenced(t_s))),
            "parking.state": lambda: str(int(self._state.parked)),
        }
        if self.model.encoder:
            readings["encoder.pos"] = lambda: str(round(self.axis.encoder(t_s)))
        if name in readings:
            return readings[name]()
        if name in self._state.settings:
            return str(self._state.settings[name])
        raise CommandRejected("BADCOMMAND")

    def _set(self, words: list[str], t_s: float) -> str:
        if len(words) != 2:
            raise CommandRejected("BADCOMMAND")
        name, value = words[0], _integer(words[1])
        if name == "pos":
            self.axis.set_counter(value, t_s)
            self.axis.set_encoder(value, t_s)
            return "0"
        if name not in self._state.settings:
            raise CommandRejected("BADCOMMAND")
        lowest, highest = setting_range(name, self._state.settings)
        if not lowest <= value <= highest:
            raise CommandRejected("BADDATA")
        self._state.settings[name] = value
        return "0"

    def _home(self, words: list[str], t_s: float) -> str:
        _expect_no_arguments(words)
        self._begin_motion(t_s)
        speed = min(self._speed("limit.approach.maxspeed"), self._speed("maxspeed"))
        self.axis.home(t_s, speed, speed / 10.0, self._acceleration())
        self._state.was_busy = True
        return "0"

    def _move(self, words: list[str], t_s: float) -> str:
        if not words:
            raise CommandRejected("BADCOMMAND")
        kind, arguments = words[0], [_integer(word) for word in words[1:]]
        lowest, highest = self._state.settings["limit.min"], self._state.settings["limit.max"]
        speed, acceleration = self._speed("maxspeed"), self._acceleration()
        if kind in {"abs", "rel"} and 1 <= len(arguments) <= 3:
            start = 0 if kind == "abs" else round(self.axis.counter(t_s))
            target = start + arguments[0]
            speed, acceleration = _motion_ramp(arguments[1:], speed, acceleration)
        elif kind == "vel" and 1 <= len(arguments) <= 2:
            target = highest if arguments[0] > 0 else lowest
            speed = abs(arguments[0]) / SPEED_UNIT
            acceleration = _motion_ramp([0, *arguments[1:]], speed, acceleration)[1]
            if speed == 0.0:
                return self._stop([], t_s)
        elif kind in {"max", "min"} and len(arguments) <= 2:
            target = highest if kind == "max" else lowest
            speed, acceleration = _motion_ramp(arguments, speed, acceleration)
        else:
            raise CommandRejected("BADCOMMAND")
        if not lowest <= target <= highest:
            raise CommandRejected("BADDATA")
        self._begin_motion(t_s)
        self.axis.move_to(target, t_s, speed, acceleration)
        self._state.was_busy = self.axis.busy(t_s)
        return "0"

    def _begin_motion(self, t_s: float) -> None:
        """Reject an impossible motion; set flag NI if the motion interrupts another one."""
        if self._state.parked:
            raise CommandRejected("PARKED")
        if "FH" in self._state.flags:
            raise CommandRejected("DRIVERDISABLED")
        if self.axis.busy(t_s):
            self._state.flags.add("NI")
        else:
            self._state.flags.discard("NI")

    def _stop(self, words: list[str], t_s: float) -> str:
        _expect_no_arguments(words)
        if self.axis.busy(t_s):
            self._state.flags.add("NI")
            self.axis.stop(t_s, self._acceleration())
        return "0"

    def _estop(self, words: list[str], t_s: float) -> str:
        _expect_no_arguments(words)
        if self.axis.busy(t_s):
            self._state.flags.add("NI")
            self.axis.halt(t_s)
        return "0"

    def _warnings(self, words: list[str], t_s: float) -> str:
        if words not in ([], ["clear"]):
            raise CommandRejected("BADCOMMAND")
        flags = self.warnings(t_s)
        if words:
            self._state.flags &= _NOT_CLEARABLE
        return " ".join([f"{len(flags):02d}", *flags])

    def _tools(self, words: list[str], t_s: float) -> str:
        if words[:1] == ["echo"]:
            return " ".join(words[1:]) or "0"
        if words not in (["parking", "park"], ["parking", "unpark"]):
            raise CommandRejected("BADCOMMAND")
        if self.axis.busy(t_s):
            raise CommandRejected("STATUSBUSY")
        self._state.parked = words[1] == "park"
        return "0"

    def _system(self, words: list[str], t_s: float) -> str:
        if words == ["reset"]:
            self.restart(t_s)
        elif words == ["restore"]:
            self._state.settings = self.model.factory_settings()
        else:
            raise CommandRejected("BADCOMMAND")
        return "0"

    # ------------------------------------------------------------------ events outside the protocol
    def emergency_stop(self, t_s: float, *, released: bool = False) -> None:
        """Press the emergency stop, which halts and holds the axis, or release it.

        t_s: Time, s.
        released: True releases the button.
        """
        if released:
            self._state.flags.discard("FH")
            return
        self.axis.halt(t_s)
        self._state.flags.add("FH")

    def exchange(self, serial: str, t_s: float) -> None:
        """Replace the controller by another one of this model, fresh from power-up.

        t_s: Time, s.
        """
        self.model = replace(self.model, serial=serial)
        self._state = self._powered_up()
        self.restart(t_s)

    def _take_events(self, t_s: float) -> None:
        """Process the events of the motion so far."""
        event = self.axis.take_event(t_s)
        if event is None:
            return
        if event.kind == "restart":
            self.restart(event.t_s)
        else:
            self._state.flags.add({"stall": "FS", "limit": "FE", "twist": "FT"}[event.kind])

    def restart(self, t_s: float) -> None:
        """Reboot: no answers for a while, then no reference unless parked; settings are kept.

        t_s: Time of the reboot, s.
        """
        if not self._state.parked:
            self.axis.restart(t_s)
        self._state.flags.clear()
        self._state.was_busy = False
        self._boot_ends_s = t_s + self.model.boot_s

    # ------------------------------------------------------------------ internals
    def _powered_up(self) -> _State:
        # On a bench, checksums are switched on; factory settings leave them off.
        return _State(self.model.factory_settings() | {"comm.checksum": 1})

    def _speed(self, setting: str) -> float:
        return self._state.settings[setting] / SPEED_UNIT

    def _acceleration(self) -> float:
        return self._state.settings["accel"] * 10_000.0 / SPEED_UNIT


def _integer(word: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise CommandRejected("BADDATA") from None


def _expect_no_arguments(words: list[str]) -> None:
    if words:
        raise CommandRejected("BADCOMMAND")


def _motion_ramp(arguments: list[int], speed: float, acceleration: float) -> tuple[float, float]:
    """Return speed and acceleration of one motion, as given after its target; 0 stands for the setting."""
    if any(argument < 0 for argument in arguments):
        raise CommandRejected("BADDATA")
    if arguments and arguments[0]:
        speed = arguments[0] / SPEED_UNIT
    if len(arguments) > 1 and arguments[1]:
        acceleration = arguments[1] * 10_000.0 / SPEED_UNIT
    return speed, acceleration
