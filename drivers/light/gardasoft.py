"""Gardasoft RT strobe controllers as flicker lights: an internal trigger pulses the lamp's channel.

Knows their two-letter commands (manual of the RT series, section 12). All outputs pulse on the same trigger, so
a second channel, wired to the camera, is the sync; a steady light is the channel's continuous mode. Levels are
percent of the lamp's rating: ``high_v`` of the settings is taken as a share of 5 V, full scale being what the
station file allows. Nothing is switched by opening.
"""

from __future__ import annotations

from collections.abc import Sequence

from drivers.clock import Clock
from drivers.errors import LightFault, ReplyError, SettingRefused, WrongDevice
from drivers.light import LightIdentity, LightSettings
from drivers.light.rt_line import CONTINUOUS, IDENTITY, PULSED, REFUSALS, REFUSED, Quantity, RtLine
from drivers.readings import agreeing
from drivers.serial_port import Port, SerialPort
from drivers.wire_log import WireLog

FULL_SCALE_V = 5.0
_DELAY_MS = 0.01
"""The shortest delay from trigger to pulse; the same for lamp and sync."""


class GardasoftLight:
    """A light behind an RT controller. Implements ``drivers.light.Light``.

    Open it with ``GardasoftLight.open``; the constructor takes a port that is open already.

    Parameters
    ----------
    port
        The open port.
    model
        As the controller names itself (RT260-20); None when it need not be checked. It tells no serial number.
    channel
        Channel of the lamp.
    sync_channel
        Channel that is wired to the camera's trigger input; None when there is none.
    full_percent
        Brightness at ``high_v`` = 5 V, in percent of the lamp's rating as the controller knows it.
    sync_percent
        Brightness of the sync channel, in percent of its rating.
    clock, wire_log
        See ``drivers.link.Link``.

    Raises
    ------
    WrongDevice
        Another model answers; nothing was set.
    ReplyError, PortLost
    """

    def __init__(
        self,
        port: Port,
        *,
        model: str | None = None,
        channel: int = 1,
        sync_channel: int | None = 2,
        full_percent: float = 100.0,
        sync_percent: float = 100.0,
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> None:
        self._model = model
        self._channel = channel
        self._sync_channel = sync_channel
        self._full_percent = full_percent
        self._sync_percent = sync_percent
        self._switched_on = False
        self._steady_percent: float | None = None
        try:
            self._line = RtLine(port, clock=clock, wire_log=wire_log)
            self.identify()
        except BaseException:
            port.close()
            raise

    @classmethod
    def open(
        cls,
        port: str,
        *,
        model: str | None = None,
        channel: int = 1,
        sync_channel: int | None = 2,
        full_percent: float = 100.0,
        sync_percent: float = 100.0,
        baudrate: int = 115200,
        clock: Clock,
        wire_log: WireLog | None = None,
    ) -> GardasoftLight:
        """Open the port and check who answers. Sets and switches nothing.

        Raises PortNotFound, PortBusy, PortDenied, and what the constructor raises.
        """
        return cls(
            SerialPort(port, baudrate=baudrate),
            model=model,
            channel=channel,
            sync_channel=sync_channel,
            full_percent=full_percent,
            sync_percent=sync_percent,
            clock=clock,
            wire_log=wire_log,
        )

    def identify(self) -> LightIdentity:
        """Return who it is. Raises WrongDevice when the model is not the station file's."""
        match = IDENTITY.fullmatch(self._line.identity_text)
        assert match is not None
        if self._model is not None and match[1] != self._model:
            raise WrongDevice(
                f"the station file says {self._model}, but {match[1]} answers. Nothing was set.",
                where=self._line.name,
                remedy="Check the port and the model in the station file.",
            )
        return LightIdentity("Gardasoft", match[1], "", match[3])

    def apply(self, settings: LightSettings) -> LightSettings:
        """Set everything, read it back, and return what the controller says. Stays dark when it is dark.

        A steady level can be read back only while it burns: it is compared when it is switched on.

        Raises SettingRefused.
        """
        percent = round(self._full_percent * settings.high_v / FULL_SCALE_V, 1)
        self._refuse_impossible(settings, percent)
        if settings.waveform == "steady":
            return self._apply_steady(percent)
        self._steady_percent = None
        period_ms = round(1e3 / settings.frequency_hz, 4)  # as it is sent
        width_ms = round(period_ms * settings.duty_percent / 100.0, 4)
        if self.is_on():
            self._set("frequency", f"TT1,{period_ms:.4f}")
        else:
            self._set("level", f"RS{self._channel},0")  # dark, while the trigger must run to take its period
            self._set("frequency", f"TT1,{period_ms:.4f}")
            self._set("frequency", "TT0")
        self._set("pulse", f"RT{self._channel},{width_ms:.4f},{_DELAY_MS},{percent:.1f}")
        self._set_sync(settings.sync_output, width_ms)
        self._compare(period_ms, width_ms, percent)
        return self.read()

    def read(self) -> LightSettings:
        """Return the present settings, asked twice. Raises LightFault when the channel has none of ours."""
        return agreeing(self._read_once, what="the settings", where=self._line.name)

    def on(self) -> None:
        """Start the internal trigger, or the steady light, and see that it burns. Raises LightFault, SettingRefused."""
        if self._steady_percent is None:
            self._set("trigger", "TT1")
        else:
            self._set("level", f"RS{self._channel},{self._steady_percent:.1f}")
            self._compare_steady(self._steady_percent)
        if not self.is_on():
            steady = self._steady_percent is not None
            raise LightFault(
                "the light was switched on, but is dark."
                if steady
                else "the trigger was started, but does not run.",
                where=self._line.name,
                remedy="See what error the controller shows.",
            )
        self._switched_on = True

    def off(self) -> None:
        """Stop the internal trigger, and a steady light, and see that nothing burns; at once, before resynchronising.

        Raises LightFault; ReplyError, PortLost when it cannot be known.
        """
        self._switched_on = False
        try:
            self._line.at_once("TT0")
        except ReplyError:
            self._line.ask("TT0")
        if self._burns():
            self._set("level", f"RS{self._channel},0")
        if self.is_on():
            raise LightFault(
                "the trigger was stopped, but still runs, or the light still burns.",
                where=self._line.name,
                remedy="Switch the controller off.",
            )

    def is_on(self) -> bool:
        """Whether the internal trigger runs or the channel burns steadily, asked twice."""
        return agreeing(self._runs, what="the trigger's state", where=self._line.name) or self._burns()

    def faults(self) -> Sequence[str]:
        """Return the controller's latest event, which this clears, and whether it went dark by itself."""
        event = self._line.ask("GR")
        found = [f"the controller reports {event} (event codes: section 13.5 of its manual)"] if event else []
        if self._switched_on and not self.is_on():
            found.append("the light was switched on, but is off")
        return found

    def close(self) -> None:
        """Give the port back; does not switch anything."""
        self._line.close()

    # ------------------------------------------------------------ inside

    def _set(self, name: str, command: str) -> None:
        """Send a setting, again when its prompt is lost. Raises SettingRefused."""
        answer = self._line.ask(command)
        match = REFUSED.fullmatch(answer)
        if match is not None or answer:
            words = (
                REFUSALS.get(int(match[1]), "see its manual") if match else "it answers what it should not"
            )
            raise SettingRefused(
                f"{name} is not taken: '{command}' is answered '{answer}': {words}.",
                where=self._line.name,
                remedy="Ask for a value within the controller's range, and the lamp's rating.",
            )

    def _set_sync(self, wanted: bool, width_ms: float) -> None:
        if self._sync_channel is None:
            return
        pulse = f"RT{self._sync_channel},{width_ms:.4f},{_DELAY_MS},{self._sync_percent:.1f}"
        self._set("sync", pulse if wanted else f"RS{self._sync_channel},0")

    def _refuse_impossible(self, settings: LightSettings, percent: float) -> None:
        """Refuse what no RT controller can do, before anything is sent."""
        wrong = []
        steady = settings.waveform == "steady"
        if settings.waveform == "sine":
            wrong.append("it makes square pulses only")
        if settings.low_v != 0 and not steady:
            wrong.append("it is dark between pulses: low_v must be 0")
        if not 0 < percent <= self._full_percent:
            wrong.append(f"high_v must be above 0 V and at most {FULL_SCALE_V:g} V, its full scale")
        if settings.sync_output and self._sync_channel is None and not steady:
            wrong.append("it has no sync channel")
        if wrong:
            raise SettingRefused(
                f"{'; '.join(wrong)}.", where=self._line.name, remedy="Change the light step, or the station."
            )

    def _apply_steady(self, percent: float) -> LightSettings:
        """Keep a level for ``on``; take it at once where the light burns already."""
        burning = self.is_on()
        self._set("trigger", "TT0")
        self._steady_percent = percent
        self._set("level", f"RS{self._channel},{percent if burning else 0:.1f}")
        if burning:
            self._compare_steady(percent)
        return self._steady(percent)

    def _compare_steady(self, percent: float) -> None:
        got = self.read()
        if got.waveform != "steady" or not self._level().is_near(percent):
            raise SettingRefused(
                f"asked to burn steadily at {percent:.1f} %, it has {got}.",
                where=self._line.name,
                remedy="Ask for a level within the controller's range.",
            )

    def _steady(self, percent: float) -> LightSettings:
        level_v = FULL_SCALE_V * percent / self._full_percent
        return LightSettings(waveform="steady", low_v=level_v, high_v=level_v, sync_output=False)

    def _level(self) -> Quantity:
        return self._line.quantity(self._line.fields(f"ST{self._channel}"), "S")

    def _burns(self) -> bool:
        """Whether the channel is lit without any trigger, asked twice."""

        def read() -> bool:
            channel = self._line.fields(f"ST{self._channel}")
            return self._line.mode(channel) == CONTINUOUS and self._line.quantity(channel, "S").value > 0

        return agreeing(read, what="the channel's mode", where=self._line.name)

    def _compare(self, period_ms: float, width_ms: float, percent: float) -> None:
        general, channel = self._line.fields("ST0"), self._line.fields(f"ST{self._channel}")
        pairs = {
            "period": (period_ms, self._line.quantity(general, "TP"), "ms"),
            "pulse width": (width_ms, self._line.quantity(channel, "PU"), "ms"),
            "brightness": (percent, self._line.quantity(channel, "S"), "%"),
        }
        wrong = [
            f"{name}: asked {wanted:.4f} {unit}, got {got.value:.4f} {unit}"
            for name, (wanted, got, unit) in pairs.items()
            if not got.is_near(wanted)
        ]
        if wrong:
            raise SettingRefused(
                f"the controller has other settings than asked ({'; '.join(wrong)}).",
                where=self._line.name,
                remedy="Ask for values within the controller's range and resolution.",
            )

    def _read_once(self) -> LightSettings:
        """Ask for all settings; the controller's own between two channels', whose answers look alike."""
        channel, general = self._line.fields(f"ST{self._channel}"), self._line.fields("ST0")
        sync = self._line.fields(f"ST{self._sync_channel}") if self._sync_channel is not None else {}
        self._line.fields("ST0")
        mode = self._line.mode(channel)
        if mode == CONTINUOUS and self._steady_percent is not None:
            return self._steady(self._line.quantity(channel, "S").value)
        if mode != PULSED:
            raise LightFault(
                f"channel {self._channel} does not pulse.",
                where=self._line.name,
                remedy="Apply the light's settings first.",
            )
        period_ms = self._line.quantity(general, "TP").value
        if period_ms <= 0:
            raise self._line.garbled(f"a period of {period_ms} ms.")
        percent = self._line.quantity(channel, "S").value
        return LightSettings(
            waveform="square",
            frequency_hz=1e3 / period_ms,
            duty_percent=100.0 * self._line.quantity(channel, "PU").value / period_ms,
            low_v=0.0,
            high_v=FULL_SCALE_V * percent / self._full_percent,
            sync_output=bool(sync) and self._line.mode(sync) == PULSED,
        )

    def _runs(self) -> bool:
        state = self._line.fields("ST0").get("TM")
        if state not in {"0", "1"}:
            raise self._line.garbled(f"a trigger state {state!r}.")
        return state == "1"
