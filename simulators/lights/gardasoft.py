"""A simulated Gardasoft RT strobe controller that drives the bench's light.

    CCn,a,b CR      two-letter commands with parameters; semicolons separate several commands on a line
    text CR LF >    answers; each line of commands is answered by a final ``>``

A refused command is answered by ``Err n``; ``Err 5`` warns that a value was clipped to its range. After ``GT1``
the controller sends events unasked, as ``Evtc,e;``. A time without a unit is in milliseconds. With the internal
trigger on, an output in pulse mode flickers; in continuous mode it shines steadily.

Source: manual of the Gardasoft RT series, section 12. The layout of the answer to ``STc`` was written from memory
of the manual.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

from simulators.lights.driver import LightDriver
from simulators.world.world import FULL_DRIVE_V, LightState

_COMMAND: Final = re.compile(r"([A-Z]{2})(.*)")
_TIME: Final = re.compile(r"([0-9]*\.?[0-9]+)(US|MS|S)?")
_MS: Final = {"US": 1e-3, "MS": 1.0, "S": 1000.0, "": 1.0, None: 1.0}
_MAX_MESSAGE: Final = 256  # Bytes of a line of commands
_CHANNELS: Final = 4  # Outputs of an RT460

#: Ranges of a pulse's width and delay, and of the internal trigger's period, ms.
_WIDTH_MS: Final = (0.001, 999.0)
_DELAY_MS: Final = (0.005, 999.0)
_PERIOD_MS: Final = (0.1, 10_000.0)

#: Largest brightness of a pulse, percent of the lamp's rating.
_MAX_PERCENT: Final = 999.0

CONTINUOUS, SWITCHED, PULSE, SELECTED = 0, 1, 2, 3  # Modes of an output, as ``STc`` tells them

#: Numbers of the events that a fault of the light causes.
OVER_TEMPERATURE, OVER_CURRENT = 130, 131


class _RtError(Exception):
    """A refused command, with its error number; number 5 is only a warning."""

    def __str__(self) -> str:
        return f"Err {self.args[0]}"


@dataclass(frozen=True)
class Output:
    """Settings of one output."""

    mode: int = CONTINUOUS  # ``CONTINUOUS``, ``SWITCHED`` or ``PULSE``
    percent: float = 0.0  # Brightness, percent of the lamp's rating
    width_ms: float = 1.0  # Width of a pulse, ms
    delay_ms: float = 0.005  # Delay of a pulse after its trigger, ms
    retrigger_ms: float = 0.0  # Time after a pulse in which triggers are ignored, ms


class GardasoftRt(LightDriver):
    """The controller; output 1 drives the light, ``version`` is the answer to ``VR``."""

    LEFT = ("echo", "events", "continuous", "switched", "selected", "retrigger")

    def leave(self, what: str) -> None:
        """See `LightDriver.leave`. Some models echo every command (``echo``)."""
        modes = {"continuous": CONTINUOUS, "switched": SWITCHED, "selected": SELECTED}
        if what == "echo":
            self._echoes = True
        elif what == "events":
            self._events_enabled = True
        elif what in modes:
            self.outputs[1] = Output(modes[what], 30.0)
        elif what == "retrigger":
            self.outputs[1] = replace(self.outputs[1], retrigger_ms=500.0)
        else:
            super().leave(what)
        self._publish()

    def __init__(
        self,
        clock: Callable[[], float],
        drive: Callable[[LightState], None] = lambda _state: None,
        version: str = "RT460-20 (HW02) V031",
    ) -> None:
        super().__init__(clock, drive, ends=b"\r", ignored=b"\n", longest=_MAX_MESSAGE)
        self._version = version
        self._echoes = False
        self._max_percent = _MAX_PERCENT
        self._commands: dict[str, Callable[[list[str]], str]] = {
            "VR": lambda _words: self._version,
            "TT": self._set_trigger,
            "RT": self._set_pulse,
            "RS": self._set_level,
            "ST": self._status,
            "GT": self._set_events,
            "GR": self._clear,
        }
        self._power_up()

    def _power_up(self) -> None:
        self.outputs = {channel: Output() for channel in range(1, _CHANNELS + 1)}
        self._trigger = self._events_enabled = self._tripped = False
        self._period_ms = 20.0
        self._event = self._pending_events = ""
        self._publish()

    def _answer(self, message: bytes) -> bytes:
        text = message.decode("ascii", "replace")
        answers = "".join(self._execute(command.upper()) for command in text.replace(" ", "").split(";"))
        return f"{text if self._echoes else ''}{answers}>".encode("ascii", "replace")

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. These are events, if the host has enabled them."""
        events, self._pending_events = self._pending_events, ""
        return events.encode("ascii")

    def clip(self, most_v: float | None) -> None:
        """See `LightDriver.clip`."""
        self._max_percent = _MAX_PERCENT if most_v is None else 100.0 * most_v / FULL_DRIVE_V

    def trip(self, event: int = OVER_TEMPERATURE) -> None:
        """Let a protection switch the light off; the event is kept for ``GR``, and sent if events are enabled."""
        self._tripped = True
        self._event = f"Evt1,{event};"
        if self._events_enabled:
            self._pending_events += f"{self._event}\r\n"
        self._publish()

    def exchange(self, serial: str) -> None:
        """See `LightDriver.exchange`. This controller does not report a serial number."""
        del serial
        self._power_up()

    # ------------------------------------------------------------------ commands
    def _execute(self, command: str) -> str:
        if not command:
            return ""
        match = _COMMAND.fullmatch(command)
        letters, rest = (match[1], match[2]) if match else ("", "")
        try:
            reply = self._commands.get(letters, _unknown)([word for word in rest.split(",") if word])
        except _RtError as error:
            reply = str(error)
        return f"{reply}\r\n" if reply else ""

    def _set_trigger(self, words: list[str]) -> str:
        if words not in (["0"], ["1"]) and (len(words) != 2 or words[0] != "1"):
            raise _RtError(1 if words else 4)
        period, warned = self._period_ms, False
        if len(words) == 2:
            period, warned = _clipped(_time_ms(words[1]), _PERIOD_MS)
        self._trigger, self._period_ms = words[0] == "1", period
        return self._apply(warned=warned)

    def _set_pulse(self, words: list[str]) -> str:
        if len(words) not in {4, 5}:
            raise _RtError(4)
        channel = _channel(words[0])
        width, too_wide = _clipped(_time_ms(words[1]), _WIDTH_MS)
        delay, too_late = _clipped(_time_ms(words[2]), _DELAY_MS)
        percent, too_bright = _clipped(_number(words[3]), (0.0, self._max_percent))
        retrigger = _time_ms(words[4]) if len(words) > 4 else self.outputs[channel].retrigger_ms
        self.outputs[channel] = Output(PULSE, percent, width, delay, retrigger)
        return self._apply(warned=too_wide or too_late or too_bright)

    def _set_level(self, words: list[str]) -> str:
        if len(words) != 2:
            raise _RtError(4)
        channel = _channel(words[0])
        percent, warned = _clipped(_number(words[1]), (0.0, min(100.0, self._max_percent)))
        self.outputs[channel] = replace(self.outputs[channel], mode=CONTINUOUS, percent=percent)
        return self._apply(warned=warned)

    def _status(self, words: list[str]) -> str:
        _expect_at_most(words, 1)
        if words in ([], ["0"]):
            return f"TM {int(self._trigger)}, TP {self._period_ms:.3f}ms"
        channel = _channel(words[0])
        output = self.outputs[channel]
        return (
            f"CH {channel}, MD {output.mode}, S {output.percent:.1f}%, DL {output.delay_ms:.3f}ms, "
            f"PU {output.width_ms:.3f}ms, RT {output.retrigger_ms:.3f}ms, IP {channel}, FL 0, CS 1.000A, RA 1.000A"
        )

    def _set_events(self, words: list[str]) -> str:
        if words not in (["0"], ["1"]):
            raise _RtError(1 if words else 4)
        self._events_enabled = words == ["1"]
        return ""

    def _clear(self, words: list[str]) -> str:
        _expect_at_most(words, 0)
        event, self._event = self._event, ""
        self._tripped = False
        self._publish()
        return event

    # ------------------------------------------------------------------ effect
    def _apply(self, *, warned: bool) -> str:
        self._publish()
        if warned:
            raise _RtError(5)
        return ""

    def _publish(self) -> None:
        """Publish the state of the light; a period begins with the edge of the internal trigger."""
        output = self.outputs[1]
        level = output.percent / 100.0 * FULL_DRIVE_V
        flickers = output.mode == PULSE and self._trigger and output.retrigger_ms < self._period_ms
        steady = output.mode == CONTINUOUS
        self._show(
            1000.0 / self._period_ms,
            waveform="square",
            duty_percent=min(99.0, 100.0 * output.width_ms / self._period_ms),
            low_v=level if steady else 0.0,
            high_v=level if steady or flickers else 0.0,
            output=level > 0.0 and (steady or flickers) and not self._tripped,
            sync=self._trigger,
        )


def _unknown(_words: list[str]) -> str:
    raise _RtError(2)


def _clipped(value: float, bounds: tuple[float, float]) -> tuple[float, bool]:
    """Clip a value to its bounds; return the value and whether it changed."""
    held = min(max(value, bounds[0]), bounds[1])
    return held, held != value


def _time_ms(text: str) -> float:
    match = _TIME.fullmatch(text)
    if match is None:
        raise _RtError(3)
    return float(match[1]) * _MS[match[2]]


def _number(text: str) -> float:
    try:
        return float(text.removesuffix("%"))
    except ValueError:
        raise _RtError(3) from None


def _channel(text: str) -> int:
    if not text.isdigit():
        raise _RtError(3)
    if not 1 <= int(text) <= _CHANNELS:
        raise _RtError(1)
    return int(text)


def _expect_at_most(words: list[str], most: int) -> str:
    """Check the number of parameters; return an empty answer."""
    if len(words) > most:
        raise _RtError(4)
    return ""
