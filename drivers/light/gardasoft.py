"""Gardasoft RT strobe controllers as flicker lights: an internal trigger pulses the lamp's channel.

All outputs pulse on the same trigger, so a second channel that is wired to the camera is the sync output. A steady
light is the channel's continuous mode. Levels are percent of the lamp's rating: ``high_v`` = 5 V stands for the full
brightness that the station file allows. Opening switches nothing.

Source: Gardasoft, "RTxxx LED lighting controllers: User Manual", section 12 (commands) and 13.5 (events).
"""

from __future__ import annotations

import re
from typing import Final

from drivers.clock import Clock
from drivers.errors import LightFault, ReplyError, SettingRefused, WrongDevice
from drivers.light import LightIdentity, LightSettings
from drivers.light.watched import FULL_SCALE_V, WatchedLight, percent_faults, steady_settings
from drivers.quantity import Quantity, read_quantity
from drivers.serial_port import LineSettings, Port, closed_on_error
from drivers.text_line import PROMPT_S, READABLE_REMEDY, TextLine
from drivers.wire_log import WireLog

CONTINUOUS: Final = "0"
PULSED: Final = "2"
"""Modes of a channel. In any further one (switched, selected) an input switches the light."""
IDENTITY: Final = re.compile(r"((?:RT|TR|VTR)\S*\d\S*) ?(.*?) ?(V\d\S*)")
REFUSED: Final = re.compile(r"Err ?(\d{1,3})", re.IGNORECASE)
_EVENT = re.compile(rb"\s*(Evt\d{1,3},\d{1,4};?)\s*")
_FIELD = re.compile(r"([A-Z]{1,2})(?:[ =]+(.*)|([\d+-].*))?")
_BETWEEN_FIELDS = re.compile(r" *[,;] *| +(?=[A-Z]{1,2}[ =]*[\d+-])")
"""What separates two fields: a comma, or a blank before the next name and its number."""

REFUSALS = {
    1: "a value is invalid",
    2: "unknown command",
    3: "a number has the wrong form",
    4: "wrong number of values",
    5: "a time was out of range and was changed to a valid one",
}
"""Meanings of the error numbers."""
_DELAY_MS = 0.01
"""The shortest delay from trigger to pulse that all such controllers take (VTR manuals: 0.01 to 999), in milliseconds;
the same for lamp and sync."""


class RtLine(TextLine):
    """A line to an RT controller. Every command has a reply, which is at least the prompt ``>``.

    Some models echo the command before the reply. Events come unasked once a program has enabled them.
    """

    def __init__(self, port: Port, *, clock: Clock, wire_log: WireLog | None = None) -> None:
        self._asked = ""
        self._events: list[str] = []
        super().__init__(
            port,
            identity_query="VR",
            is_identity=lambda text: IDENTITY.fullmatch(text) is not None,
            identity_form="a model such as 'RT420F-20 (HW02) V031'",
            clock=clock,
            request_end=b"\r",
            reply_end=b">",
            reply_s=PROMPT_S,
            wire_log=wire_log,
        )

    def command_urgent(self, command: str) -> None:
        """Send a command, without its end, at once, without resynchronising, and wait for its prompt."""
        with self.urgently():
            self._query_once(command)

    def query_fields(self, query: str) -> dict[str, str]:
        """Ask for settings."""
        text = self.query(query)
        fields = [_FIELD.fullmatch(part.strip()) for part in _BETWEEN_FIELDS.split(text)]
        if not all(fields):
            raise self.garbled_reply(f"{query} answered {text!r}.", READABLE_REMEDY)
        return {field[1]: (field[2] or field[3] or "").strip() for field in fields if field}

    def parse_percent(self, fields: dict[str, str]) -> Quantity:
        """Parse the brightness, percent; else raise `ReplyGarbled`."""
        return self._parsed(read_quantity(fields.get("S", ""), "%"), "S", fields)

    def parse_time(self, fields: dict[str, str], name: str) -> Quantity:
        """Parse a field as a time, ms; else raise `ReplyGarbled`."""
        got = self._parsed(read_quantity(fields.get(name, ""), "s", bare_factor=1e-3), name, fields)
        return Quantity(got.value * 1e3, got.half_digit * 1e3)

    def parse_mode(self, fields: dict[str, str]) -> str:
        """Parse the number of a channel's mode; else raise `ReplyGarbled`."""
        mode = fields.get("MD", "")
        if not re.fullmatch(r"\d", mode):
            raise self.garbled_reply(f"no mode of a channel in {fields}.", READABLE_REMEDY)
        return mode

    def take_events(self) -> list[str]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return list(dict.fromkeys(events))

    def inspect_old(self, old: bytes) -> None:
        """See `TextLine.inspect_old`."""
        self._keep_events(old)

    def is_filler(self, data: bytes) -> bool:
        """See `Link.is_filler`: events are kept."""
        return not self._keep_events(data).strip()

    # ------------------------------------------------------------ inside

    def _query_once(self, query: str, deadline_s: float | None = None) -> str:
        self._asked = query
        return super()._query_once(query, deadline_s)

    def _parse_reply(self, line: bytes) -> str:
        """Return the text before the prompt, without echo and events; the reply to most commands has none."""
        body = re.sub(rb"[\r\n]+", b" ", self._keep_events(line.removesuffix(b">")))
        if not re.fullmatch(rb"[ -~]*", body):
            raise self.garbled_reply(f"not a reply: {line[:80]!r}.")
        echo = r"\s*".join(map(re.escape, self._asked))
        return re.sub(rf"^\s*{echo}", "", body.decode("ascii"), flags=re.IGNORECASE).strip(" ;")

    def _keep_events(self, data: bytes) -> bytes:
        """Keep the events in some bytes, and return the rest."""
        self._events += [event.decode("ascii") for event in _EVENT.findall(data)]
        return _EVENT.sub(b"", data)

    def _parsed(self, quantity: Quantity | None, name: str, fields: dict[str, str]) -> Quantity:
        if quantity is None:
            raise self.garbled_reply(f"no quantity {name} in {fields}.", READABLE_REMEDY)
        return quantity


class GardasoftLight(WatchedLight):
    """A light behind an RT controller.

    The controller reports a model (RT260-20; None: not checked) and no serial number. ``sync_channel`` is wired to the
    camera's trigger input; None when there is none. ``full_percent`` is the brightness at ``high_v`` = 5 V and
    ``sync_percent`` that of the sync channel, in percent of their ratings in the controller.
    """

    _line: RtLine
    SETTINGS = LineSettings(115200)
    STAYS_LIT = ("the trigger still runs or the light is still lit", "Switch the controller off.")

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
        super().__init__()
        self._steady_percent: float | None = None
        self._messages_ended = False
        with closed_on_error(port):
            self._line = RtLine(port, clock=clock, wire_log=wire_log)
            self.identify()

    def identify(self) -> LightIdentity:
        """See `Light.identify`; the model is compared with the one in the station file."""
        match = IDENTITY.fullmatch(self._line.identity_text)
        assert match is not None
        if self._model is not None and match[1] != self._model:
            raise WrongDevice(
                f"the station file names {self._model}, but {match[1]} answers. Nothing was set.",
                where=self._line.name,
                remedy="Check the port and the model in the station file.",
            )
        return LightIdentity("Gardasoft", match[1], "", match[3])

    def _apply(self, settings: LightSettings) -> LightSettings:
        """See `Light.apply`. A dark light stays dark.

        The level of a steady light can be read back only while it is lit. In the dark it is checked later, by ``on``.
        """
        percent = self._percent(settings)
        self._end_messages()
        if settings.waveform == "steady":
            return self._apply_steady(percent)
        self._steady_percent = None
        period_ms = round(1e3 / settings.frequency_hz, 4)  # to the digits that are sent
        width_ms = round(period_ms * settings.duty_percent / 100.0, 4)
        if self._is_surely_lit():
            self._set("frequency", f"TT1,{period_ms:.4f}")
        else:  # the trigger must run to accept a period: keep the lamp dark meanwhile
            self._set("level", f"RS{self._channel},0")
            self._set("frequency", f"TT1,{period_ms:.4f}")
            self._set("frequency", "TT0")
        self._set_pulse("pulse", self._channel, width_ms, percent)
        if self._sync_channel is not None and settings.sync_output:
            self._set_pulse("sync", self._sync_channel, width_ms, self._sync_percent)
        elif self._sync_channel is not None:
            self._set("sync", f"RS{self._sync_channel},0")
        self._check_settings(period_ms, width_ms, percent, sync=settings.sync_output)
        return self.read()

    def _switch_on(self) -> None:
        """Start the internal trigger, or the steady light."""
        if self._steady_percent is None:
            self._set("trigger", "TT1")
        else:
            self._set("level", f"RS{self._channel},{self._steady_percent:.1f}")
            self._check_steady(self._steady_percent)

    def _stays_dark(self) -> tuple[str, str]:
        trigger, steady = (
            "the trigger was started, but does not run.",
            "the light was switched on, but is dark.",
        )
        remedy = "Look up the error that the controller shows in its manual."
        return (trigger if self._steady_percent is None else steady), remedy

    def _switch_off(self) -> None:
        """Stop the internal trigger at once, without resynchronising, then a steady light."""
        try:
            self._line.command_urgent("TT0")
        except ReplyError:
            self._line.query("TT0")
        if self._lit_mode():
            self._set("level", f"RS{self._channel},0")

    def is_on(self) -> bool:
        """See `Light.is_on`. Asks whether the internal trigger runs or the channel may be lit without it."""
        return self._line.agreed(self._trigger_runs, "the trigger's state") or bool(self._lit_mode())

    def _reported_faults(self) -> list[str]:
        """Return the events since the last call, and the controller's latest one, which this clears."""
        refused = self._line.query("GR")
        events = [*self._line.take_events(), *filter(None, [refused])]
        return [f"the controller reports event {event} (see section 13.5 of its manual)" for event in events]

    # ------------------------------------------------------------ inside

    def _set(self, name: str, command: str) -> None:
        """Send a setting, and repeat it when its prompt does not come. Raises SettingRefused."""
        answer = self._line.query(command)
        match = REFUSED.fullmatch(answer)
        if match is not None or answer:
            words = REFUSALS.get(int(match[1]), "see its manual") if match else "no valid answer to a setting"
            raise SettingRefused(
                f"{name} is refused: '{command}' is answered by '{answer}': {words}.",
                where=self._line.name,
                remedy="Ask for a value within the controller's range, and the lamp's rating.",
            )

    def _set_pulse(self, name: str, channel: int, width_ms: float, percent: float) -> None:
        """Set a channel to pulses; end the time in which another program lets it ignore triggers."""
        pulse = f"RT{channel},{width_ms:.4f},{_DELAY_MS},{percent:.1f}"
        self._set(name, pulse)
        fields = self._line.query_fields(f"ST{channel}")
        if "RT" in fields and self._line.parse_time(fields, "RT").value > 0:
            self._set(name, f"{pulse},0")

    def _end_messages(self) -> None:
        """Switch off, once, that events come unasked: ``GR`` has none of those. A model may lack the command."""
        if not self._messages_ended:
            self._line.query("GT0")
            self._messages_ended = True

    def _refuse_impossible(self, settings: LightSettings) -> None:
        """See `WatchedLight._refuse_impossible`."""
        wrong = []
        steady = settings.waveform == "steady"
        if settings.waveform == "sine":
            wrong.append("this light makes square pulses only")
        wrong += percent_faults(settings, self._percent(settings), self._full_percent)
        if settings.sync_output and self._sync_channel is None and not steady:
            wrong.append("this light has no sync channel")
        self._refuse(wrong)

    def _percent(self, settings: LightSettings) -> float:
        return round(self._full_percent * settings.high_v / FULL_SCALE_V, 1)

    def _apply_steady(self, percent: float) -> LightSettings:
        """Keep a level for ``on``; set it at once when the light is lit already."""
        lit = self._is_surely_lit()
        self._set("trigger", "TT0")
        self._steady_percent = percent
        self._set("level", f"RS{self._channel},{percent if lit else 0:.1f}")
        if lit:
            self._check_steady(percent)
        return self._steady(percent)

    def _check_steady(self, percent: float) -> None:
        got = self.read()
        if got.waveform != "steady" or not self._level().agrees_with(percent):
            raise SettingRefused(
                f"a steady level of {percent:.1f} % was asked for, but the controller has {got}.",
                where=self._line.name,
                remedy="Ask for a level within the controller's range.",
            )

    def _steady(self, percent: float) -> LightSettings:
        return steady_settings(FULL_SCALE_V * percent / self._full_percent)

    def _level(self) -> Quantity:
        return self._line.parse_percent(self._line.query_fields(f"ST{self._channel}"))

    def _lit_mode(self) -> str:
        """Return the mode of a channel that may be lit without pulses; empty if it is dark. Two readings agree."""

        def read() -> str:
            channel = self._line.query_fields(f"ST{self._channel}")
            mode = self._line.parse_mode(channel)
            return mode if mode != PULSED and self._line.parse_percent(channel).value > 0 else ""

        return self._line.agreed(read, "the channel's mode")

    def _is_surely_lit(self) -> bool:
        """Whether the trigger runs, or the channel is lit without any input."""
        return self._line.agreed(self._trigger_runs, "the trigger's state") or self._lit_mode() == CONTINUOUS

    def _check_settings(self, period_ms: float, width_ms: float, percent: float, *, sync: bool) -> None:
        line = self._line
        general = line.query_fields("ST0")
        pairs = [("period", "ms", period_ms, line.parse_time(general, "TP"), 0.0)]
        channels = {"": (self._channel, percent)}
        if sync and self._sync_channel is not None:
            channels["sync "] = self._sync_channel, self._sync_percent
        for name, (channel, level) in channels.items():
            fields = line.query_fields(f"ST{channel}")
            pairs.append((f"{name}pulse width", "ms", width_ms, line.parse_time(fields, "PU"), 0.0))
            pairs.append((f"{name}brightness", "%", level, line.parse_percent(fields), 0.0))
            if "DL" in fields:
                pairs.append((f"{name}delay", "ms", _DELAY_MS, line.parse_time(fields, "DL"), _DELAY_MS))
            if "RT" in fields:  # it matters once it is as long as a period
                retrigger = line.parse_time(fields, "RT")
                pairs.append((f"{name}retrigger delay", "ms", 0.0, retrigger, 0.9 * period_ms))
        wrong = [
            f"{name}: asked {wanted:.4f} {unit}, got {got.value:.4f} {unit}"
            for name, unit, wanted, got, tolerance in pairs
            # the controller may round by 1 part in 100,000 more than it prints
            if abs(got.value - wanted) > max(tolerance, got.half_digit * 1.001 + 1e-5 * abs(wanted))
        ]
        self._refuse_otherwise(wrong, "Ask for values within the controller's range and resolution.")

    def _read_once(self) -> LightSettings:
        """Ask for all settings. ``ST0`` comes between the channels, because the answers of two channels look alike."""
        channel, general = self._line.query_fields(f"ST{self._channel}"), self._line.query_fields("ST0")
        sync = self._line.query_fields(f"ST{self._sync_channel}") if self._sync_channel is not None else {}
        self._line.query_fields("ST0")
        mode = self._line.parse_mode(channel)
        if mode == CONTINUOUS and self._steady_percent is not None:
            return self._steady(self._line.parse_percent(channel).value)
        if mode != PULSED:
            raise LightFault(
                f"channel {self._channel} is not in pulse mode.",
                where=self._line.name,
                remedy="Apply the light's settings first.",
            )
        period_ms = self._line.parse_time(general, "TP").value
        if period_ms <= 0:
            raise self._line.garbled_reply(f"the controller reports a period of {period_ms} ms.")
        percent = self._line.parse_percent(channel).value
        return LightSettings(
            waveform="square",
            frequency_hz=1e3 / period_ms,
            duty_percent=100.0 * self._line.parse_time(channel, "PU").value / period_ms,
            low_v=0.0,
            high_v=FULL_SCALE_V * percent / self._full_percent,
            sync_output=bool(sync) and self._line.parse_mode(sync) == PULSED,
        )

    def _trigger_runs(self) -> bool:
        state = self._line.query_fields("ST0").get("TM")
        if state not in {"0", "1"}:
            raise self._line.garbled_reply(f"the controller reports the trigger state {state!r}.")
        return state == "1"
