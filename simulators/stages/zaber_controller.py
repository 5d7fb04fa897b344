"""One controller of the Zaber ASCII family with its axis, of the X-RST kind.

Knows its settings, its warning flags and what it does with a command's words, as firmware 7 of Zaber's ASCII
protocol has them; neither frames nor checksums (`zaber` does that), and of the mechanics only what
`axis_motion` lets it command.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from simulators.stages.axis_motion import Axis, Mechanics
from simulators.world.trajectory import Pointing

#: Firmware 7 counts speeds in microsteps/s times this, and accelerations in 10000 microsteps/s^2 times this.
_TICK = 1.6384

#: Highest speed and acceleration that the settings take.
_MAX_SPEED_SETTING = 16_777_216
_MAX_ACCELERATION_SETTING = 32_767

#: Warning flags by rank: a reply carries the first one that is up.
_RANK = "FF FH FV FO FD FC FM FN FQ FI FS FB FP FE FT WL WP WV WT WS WM WR WH NC NI NT NU NR"

#: Flags that `warnings clear` does not take down: they last as long as their cause.
_NOT_CLEARABLE = {"WR", "FO", "FH"}


@dataclass(frozen=True)
class ZaberModel:
    """What a controller says it is, and the axis behind it.

    Attributes
    ----------
    serial
        Its serial number.
    lowest, highest
        Soft limits, microsteps; also where the settings start.
    speed_deg_s, acceleration_deg_s2
        Ramp settings at power-up.
    home_speed_deg_s
        Speed towards the reference sensor; the last part is ten times slower.
    encoder
        Whether there is an encoder on the shaft.
    """

    mechanics: Mechanics
    serial: str
    lowest: int
    highest: int
    device_id: int = 50958
    firmware: str = "7.38"
    build: str = "17403"
    speed_deg_s: float = 40.0
    acceleration_deg_s2: float = 200.0
    home_speed_deg_s: float = 20.0
    boot_s: float = 0.5
    encoder: bool = True


@dataclass
class CommandRejected(Exception):
    """A rejection: the word that stands in the reply's data."""

    reason: str


@dataclass
class _State:
    """All that a power cycle sets back."""

    settings: dict[str, int]
    flags: set[str] = field(default_factory=set)
    parked: bool = False
    was_busy: bool = False


class ZaberController:
    """A controller with one axis.

    Parameters
    ----------
    model
        What it is.
    now_s
        Time of power-up.
    publish
        Called with every new course of the axis.
    """

    def __init__(
        self,
        model: ZaberModel,
        now_s: float = 0.0,
        publish: Callable[[Pointing], None] = lambda _pointing: None,
    ) -> None:
        self.model = model
        self.axis = Axis(model.mechanics, now_s, publish)
        self._state = self._powered_up()
        self._boot_ends_s = now_s

    # ------------------------------------------------------------------ what replies carry
    def awake(self, t_s: float) -> bool:
        """Whether it answers at all: not while it boots."""
        self._take_events(t_s)
        return t_s >= self._boot_ends_s

    def status(self, t_s: float) -> str:
        """BUSY while a ramp is under way, else IDLE."""
        return "BUSY" if self.axis.reports_busy(t_s) else "IDLE"

    def warnings(self, t_s: float) -> list[str]:
        """All flags that are up, the gravest first."""
        flags = set(self._state.flags)
        if not self.axis.referenced(t_s):
            flags.add("WR")
        return sorted(flags, key=_RANK.index)

    @property
    def checksums(self) -> bool:
        """Whether its messages end in a checksum."""
        return bool(self._state.settings["comm.checksum"])

    def came_to_rest(self, t_s: float) -> bool:
        """Whether a motion has ended since the last time this was asked, and alerts are wanted."""
        busy = self.axis.busy(t_s)
        ended = self._state.was_busy and not busy
        self._state.was_busy = busy
        return ended and bool(self._state.settings["comm.alert"])

    # ------------------------------------------------------------------ commands
    def execute(self, axis: int, words: list[str], t_s: float) -> str:
        """Do what a command says.

        Parameters
        ----------
        axis
            The axis addressed; 0 for the controller and all its axes.
        words
            The command; empty to ask for the status only.
        t_s
            When it arrives.

        Returns
        -------
        str
            The data of the reply.

        Raises
        ------
        CommandRejected
            When the reply is a rejection.
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
            "vel": lambda: str(round(self.axis.velocity(t_s) * _TICK)),
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
        lowest, highest = self._range(name)
        if not lowest <= value <= highest:
            raise CommandRejected("BADDATA")
        self._state.settings[name] = value
        return "0"

    def _range(self, name: str) -> tuple[int, int]:
        """Values that a setting takes."""
        ranges = {
            "comm.alert": (0, 1),
            "comm.checksum": (0, 1),
            "maxspeed": (1, _MAX_SPEED_SETTING),
            "limit.approach.maxspeed": (1, _MAX_SPEED_SETTING),
            "accel": (1, _MAX_ACCELERATION_SETTING),
            "limit.min": (-1_000_000_000, self._state.settings["limit.max"]),
            "limit.max": (self._state.settings["limit.min"], 1_000_000_000),
        }
        return ranges[name]

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
            speed = abs(arguments[0]) / _TICK
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
        """Refuse a motion that cannot be; else note whether it interrupts another."""
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
            self._state.settings = self._factory_settings()
        else:
            raise CommandRejected("BADCOMMAND")
        return "0"

    # ------------------------------------------------------------------ what is not on the wire
    def emergency_stop(self, t_s: float, *, released: bool = False) -> None:
        """Press the emergency stop, which halts the axis and holds it, or release it."""
        if released:
            self._state.flags.discard("FH")
            return
        self.axis.halt(t_s)
        self._state.flags.add("FH")

    def exchange(self, serial: str, t_s: float) -> None:
        """Be another controller of this model from now on, fresh from power-up."""
        self.model = replace(self.model, serial=serial)
        self._state = self._powered_up()
        self.restart(t_s)

    def _take_events(self, t_s: float) -> None:
        """Take up what has happened to the motion by now."""
        event = self.axis.take_event(t_s)
        if event is None:
            return
        if event.kind == "restart":
            self.restart(event.t_s)
        else:
            self._state.flags.add({"stall": "FS", "limit": "FE", "twist": "FT"}[event.kind])

    def restart(self, t_s: float) -> None:
        """Reboot: silent for a while, then without a reference, unless parked; settings are kept."""
        if not self._state.parked:
            self.axis.restart(t_s)
        self._state.flags.clear()
        self._state.was_busy = False
        self._boot_ends_s = t_s + self.model.boot_s

    # ------------------------------------------------------------------ inside
    def _powered_up(self) -> _State:
        # A bench's controllers are set up to guard their messages; factory settings leave checksums off.
        return _State(self._factory_settings() | {"comm.checksum": 1})

    def _factory_settings(self) -> dict[str, int]:
        scale = self.model.mechanics.counts_per_deg * _TICK
        return {
            "comm.alert": 0,
            "comm.checksum": 0,
            "maxspeed": round(self.model.speed_deg_s * scale),
            "limit.approach.maxspeed": round(self.model.home_speed_deg_s * scale),
            "accel": round(self.model.acceleration_deg_s2 * scale / 10_000.0),
            "limit.min": self.model.lowest,
            "limit.max": self.model.highest,
        }

    def _speed(self, setting: str) -> float:
        return self._state.settings[setting] / _TICK

    def _acceleration(self) -> float:
        return self._state.settings["accel"] * 10_000.0 / _TICK


def _integer(word: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise CommandRejected("BADDATA") from None


def _expect_no_arguments(words: list[str]) -> None:
    if words:
        raise CommandRejected("BADCOMMAND")


def _motion_ramp(arguments: list[int], speed: float, acceleration: float) -> tuple[float, float]:
    """Speed and acceleration of one motion, as given behind its target; 0 stands for the setting."""
    if any(argument < 0 for argument in arguments):
        raise CommandRejected("BADDATA")
    if arguments and arguments[0]:
        speed = arguments[0] / _TICK
    if len(arguments) > 1 and arguments[1]:
        acceleration = arguments[1] * 10_000.0 / _TICK
    return speed, acceleration
