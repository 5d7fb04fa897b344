"""Flicker lights on an SCPI function generator: its output feeds the lamp, its sync output the camera.

A generator may clip a setting, refuse it, or accept and ignore it, so every setting is read back. Opening switches
nothing. Generators of several makes have different commands: see `drivers.light.scpi_dialects`.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from drivers.clock import Clock
from drivers.errors import SettingRefused, WrongDevice
from drivers.light import LightIdentity, LightSettings
from drivers.light.scpi_dialects import DIALECTS, DialectName, GeneratorReading, Load, Mode, Setting
from drivers.light.watched import WatchedLight
from drivers.serial_number import is_same_serial
from drivers.serial_port import LineSettings, Port, closed_on_error
from drivers.text_line import InstrumentError, ScpiLine
from drivers.wire_log import WireLog


class ScpiLight(WatchedLight):
    """A light behind an SCPI generator; ``serial`` as in the answer to ``*IDN?``, None when it is not checked.

    ``load`` is sent before the levels; "unchanged" for a generator without this setting. ``dialect``: "keysight",
    "numbered" or "siglent".
    """

    SETTINGS = LineSettings(9600)  # as generators are delivered
    _line: ScpiLine
    OUTPUT = LAMP = "output"
    STAYS_DARK = ("reads off", "Check whether the generator shows an overload of its output.")
    STAYS_LIT = ("reads on", "Switch the generator's output off by hand.")

    def __init__(
        self,
        port: Port,
        *,
        serial: str | None = None,
        clock: Clock,
        wire_log: WireLog | None = None,
        load: Load = "high-z",
        dialect: DialectName = "keysight",
    ) -> None:
        self._serial = serial
        self._load: Load = load
        self._dialect = DIALECTS[dialect]
        super().__init__()
        self._backwards = itertools.cycle((False, True))
        self._modes_ended = False
        self._sync_is_normal = False
        self._tells_states: bool | None = None
        self._silent_queries: set[str] = set()
        with closed_on_error(port):
            self._line = ScpiLine(port, clock=clock, wire_log=wire_log)
            self.identify()

    def identify(self) -> LightIdentity:
        """See `Light.identify`; the serial number is compared with the one in the station file."""
        identity = LightIdentity(*self._line.identity)
        if self._serial is not None and not is_same_serial(identity.serial, self._serial):
            raise WrongDevice(
                f"the station file names serial {self._serial}, but {identity.maker} {identity.model} with"
                f" serial {identity.serial} answers. Nothing was set.",
                where=self._line.name,
                remedy="Check the port and the serial in the station file.",
            )
        return identity

    def _apply(self, settings: LightSettings) -> LightSettings:
        """See `Light.apply`. The error names what was asked for and what the generator has instead."""
        self._end_modes()
        if self._load != "unchanged":
            load = self._dialect.load(self._load)
            self._set((load.name, load.commands[0]))
            self._require_kept(load, self._state(load))
        for setting in self._dialect.settings(settings, self._dialect.query_low_v(self._line)):
            self._set(setting)
        self._backwards = itertools.cycle((False, True))
        got = self._line.agreed(self._ask, "the settings")
        self._refuse_otherwise(
            got.differences(settings), "Ask for values within the generator's range and resolution."
        )
        return got.settings

    def _ask(self) -> GeneratorReading:
        """Ask for all settings: SCPI has no checksums, and a digit can change on the line."""
        return self._dialect.query_settings(self._line, backwards=next(self._backwards))

    def _read_once(self) -> LightSettings:
        return self._ask().settings

    def read(self) -> LightSettings:
        """See `Light.read`. Consecutive readings ask in two orders."""
        self._backwards = itertools.cycle((False, True))
        return super().read()

    def sync_polarity(self) -> str:
        """See `StatesSyncPolarity.sync_polarity`. Ends bursts and modulations, too, as `apply` does."""
        self._end_modes()
        return "normal" if self._sync_is_normal else "not stated by the device"

    def _switch_on(self) -> None:
        self._set(self._dialect.output(on=True))

    def _switch_off(self) -> None:
        _, command = self._dialect.output(on=False)
        self._line.send_urgent(command)

    def _insist_off(self) -> bool:
        _, command = self._dialect.output(on=False)
        self._line.command(command)
        return True

    def is_on(self) -> bool:
        """See `Light.is_on`."""
        return self._line.agreed(lambda: self._dialect.query_output(self._line), "the output's switch")

    def _reported_faults(self) -> list[str]:
        """Return the errors since the last call."""
        return [f"the generator reports {error}" for error in self._line.read_errors()]

    # ------------------------------------------------------------ inside

    def _end_modes(self) -> None:
        """End, once, what another program may have left on. A generator may lack any of it."""
        if self._modes_ended:
            return
        for mode in self._dialect.modes():
            self._end(mode)
        polarity = self._dialect.sync_polarity()
        self._sync_is_normal = polarity is not None and self._end(polarity)
        self._modes_ended = True

    def _end(self, mode: Mode) -> bool:
        """End a mode and read it back; return whether the generator confirms that it is ended."""
        errors = self._first_accepted(mode.commands)
        if errors and not all(error.tells_of_a_lack for error in errors):
            errors = self._first_accepted(mode.commands)  # an error may be older, and of something else
        if errors and all(error.tells_of_a_lack for error in errors):
            return False
        state = self._state(mode)
        self._require_kept(mode, state)
        if errors and (state is None or mode.is_switch):
            answers = "; ".join(map(str, errors))
            raise self._stays(mode, f"is refused: '{mode.commands[0]}' is answered by {answers}")
        return state is not None or self._line.has_error_queue

    def _require_kept(self, mode: Mode, state: str | None) -> None:
        if state is not None and not self._dialect.is_set(mode, state):
            after = f"after '{mode.commands[0]}', '{mode.query}' is answered by '{state}'"
            raise self._stays(mode, f"stays as another program left it: {after}")

    def _stays(self, mode: Mode, what: str) -> SettingRefused:
        return SettingRefused(
            f"{mode.name} {what}.",
            where=self._line.name,
            remedy="End it at the generator's front panel, or switch the generator off and on.",
        )

    def _first_accepted(self, commands: Sequence[str]) -> list[InstrumentError]:
        """Send commands until one is accepted; return the errors of the last one."""
        errors: list[InstrumentError] = []
        for command in commands:
            errors = self._line.command(command)
            if not errors:
                break
        return errors

    def _state(self, mode: Mode) -> str | None:
        """Ask for a state; None if the generator does not tell it. One that is silent at first is asked no more."""
        if self._tells_states is False or mode.query in self._silent_queries:
            return None
        state = self._line.query_if_known(mode.query)
        if self._tells_states is None:
            self._tells_states = state is not None
        if state is None:
            self._silent_queries.add(mode.query)
        elif not self._dialect.is_set(mode, state):
            return self._line.query_if_known(mode.query)  # one reply may be spoilt
        return state

    def _set(self, setting: Setting) -> None:
        name, command = setting
        errors = self._line.command(command)
        if errors:
            raise SettingRefused(
                f"{name} is refused: '{command}' is answered by {'; '.join(map(str, errors))}.",
                where=self._line.name,
                remedy=_remedy(name, errors),
            )


def _remedy(name: str, errors: Sequence[InstrumentError]) -> str:
    if any(error.code == -113 for error in errors):
        if name == "load":
            return "Write 'load: unchanged' in the station file: this generator has no load setting."
        return "Check that the station file names the right driver for this generator."
    return "Ask for a value within the generator's range."
