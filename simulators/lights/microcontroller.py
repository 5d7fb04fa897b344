"""A simulated microcontroller light with Starbench's own line protocol, version 1.

    FREQ 50*25 LF             a command, with the XOR of the bytes before the star as two hexadecimal digits
    FREQ 50 ok*01 CR LF       its answer: the command, then ok, a value after =, or err and a number
    FREQ? = 50.000000*29 CR LF

A timer of 16 bits at 16 MHz makes the flicker, so a frequency is rounded to whole ticks and is read back as it is.
After ``DOG`` seconds without a valid command the light goes dark. At power-up it is dark.

Reference: docs/protocols/starbench-light.md. Written from that page, without the firmware and without the driver.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from simulators.lights.driver import LightDriver
from simulators.world.world import FULL_DRIVE_V, LightState

_CLOCK_HZ: Final = 16_000_000  # Of the timer, as are the next two
_PRESCALERS: Final = (1, 8, 64, 256, 1024)  # Of the ATmega328P's timer 1, as its 16 bits
_MOST_TICKS: Final = 65_536
_MAX_LINE: Final = 64  # Bytes; a line of the protocol has at most 60 characters

BAD_CHECKSUM, UNKNOWN, BAD_VALUE, OUT_OF_RANGE, FAULT_LATCHED = 1, 2, 3, 4, 5
"""Numbers of the errors."""


class _Refused(Exception):
    """A refused command, with its number."""

    def __str__(self) -> str:
        return f"err {self.args[0]}"


class MicrocontrollerLight(LightDriver):
    """The light; ``serial`` is the answer to ``SERIAL?``."""

    def __init__(
        self,
        serial: str,
        clock: Callable[[], float],
        drive: Callable[[LightState], None] = lambda _state: None,
    ) -> None:
        super().__init__(clock, drive, ignored=b"\r", longest=_MAX_LINE)
        self._serial = serial
        self._most_percent = 100.0
        self._power_up()

    def _power_up(self) -> None:
        self._buffer = b""
        self._steady = self._on = False
        self._sync = True
        self._ticks, self._prescaler, self._high_ticks = 33_333, 8, 16_667
        self._duty = 50.0
        self._level = 0.0
        self._dog_s = 60.0
        self._fault = "none"
        self._heard_s = self._clock()
        self._publish()

    def receive(self, data: bytes) -> bytes:
        """See `Dialect.receive`."""
        self._watch()
        return super().receive(data)

    def unsolicited(self) -> bytes:
        """See `Dialect.unsolicited`. The light says nothing unasked; its watchdog runs."""
        self._watch()
        return b""

    def clip(self, most_v: float | None) -> None:
        """See `LightDriver.clip`."""
        self._most_percent = 100.0 if most_v is None else 100.0 * most_v / FULL_DRIVE_V

    def trip(self) -> None:
        """Let the thermal protection switch the light off."""
        self._on = False
        self._fault = "hot"
        self._publish()

    def exchange(self, serial: str) -> None:
        """See `LightDriver.exchange`."""
        self._serial = serial
        self._power_up()

    # ------------------------------------------------------------------ commands
    def _answer(self, message: bytes) -> bytes:
        if not message:
            return b""
        body, star, digits = message.rpartition(b"*")
        if not star or digits != b"%02X" % _xor(body):
            return _framed(f"? err {BAD_CHECKSUM}")
        self._heard_s = self._clock()
        text = body.decode("ascii", "replace")
        try:
            return _framed(f"{text} {self._execute(text)}")
        except _Refused as refused:
            return _framed(f"{text} {refused}")

    def _execute(self, text: str) -> str:
        name, _, value = text.partition(" ")
        answers: dict[str, Callable[[], str]] = {
            "ID?": lambda: "STARLIGHT 1 sim-1.0",
            "SERIAL?": lambda: self._serial,
            "WAVE?": lambda: "steady" if self._steady else "square",
            "FREQ?": lambda: f"{self._frequency_hz():.6f}",
            "DUTY?": lambda: f"{100.0 * self._high_ticks / self._ticks:.4f}",
            "LEVEL?": lambda: f"{self._level:.2f}",
            "SYNC?": lambda: "on" if self._sync else "off",
            "OUT?": lambda: "on" if self._on else "off",
            "DOG?": lambda: f"{self._dog_s:.0f}",
            "FAULT?": lambda: self._fault,
        }
        if name in answers and not value:
            return f"= {answers[name]()}"
        commands: dict[str, Callable[[str], None]] = {
            "WAVE": self._set_wave,
            "FREQ": self._set_frequency,
            "DUTY": self._set_duty,
            "LEVEL": self._set_level,
            "SYNC": self._set_sync,
            "DOG": self._set_dog,
            "ON": self._switch_on,
            "OFF": self._switch_off,
        }
        if name not in commands:
            raise _Refused(UNKNOWN)
        commands[name](value)
        self._publish()
        return "ok"

    def _set_wave(self, value: str) -> None:
        if value not in {"square", "steady"}:
            raise _Refused(BAD_VALUE)
        self._steady = value == "steady"

    def _set_frequency(self, value: str) -> None:
        frequency = _number(value, 0.5, 5000.0)
        for prescaler in _PRESCALERS:
            ticks = round(_CLOCK_HZ / (prescaler * frequency))
            if ticks <= _MOST_TICKS:
                break
        self._ticks, self._prescaler = ticks, prescaler
        self._high_ticks = round(self._duty / 100.0 * ticks)

    def _set_duty(self, value: str) -> None:
        self._duty = _number(value, 1.0, 99.0)
        self._high_ticks = round(self._duty / 100.0 * self._ticks)

    def _set_level(self, value: str) -> None:
        self._level = min(_number(value, 0.0, 100.0), self._most_percent)

    def _set_sync(self, value: str) -> None:
        if value not in {"on", "off"}:
            raise _Refused(BAD_VALUE)
        self._sync = value == "on"

    def _set_dog(self, value: str) -> None:
        self._dog_s = _number(value, 1.0, 3600.0)

    def _switch_on(self, value: str) -> None:
        if value:
            raise _Refused(BAD_VALUE)
        if self._fault == "hot":
            raise _Refused(FAULT_LATCHED)
        self._fault = "none"
        self._on = True

    def _switch_off(self, value: str) -> None:
        if value:
            raise _Refused(BAD_VALUE)
        self._on = False

    # ------------------------------------------------------------------ effect
    def _frequency_hz(self) -> float:
        return _CLOCK_HZ / (self._prescaler * self._ticks)

    def _watch(self) -> None:
        """Go dark when no valid command has come for too long."""
        if self._on and self._clock() - self._heard_s > self._dog_s:
            self._on = False
            self._fault = "watchdog"
            self._publish()

    def _publish(self) -> None:
        level_v = self._level / 100.0 * FULL_DRIVE_V
        self._show(
            self._frequency_hz(),
            waveform="square",
            duty_percent=100.0 * self._high_ticks / self._ticks,
            low_v=level_v if self._steady else 0.0,
            high_v=level_v,
            output=self._on,
            sync=self._on and self._sync and not self._steady,
        )


def _framed(text: str) -> bytes:
    body = text.encode("ascii", "replace")
    return body + b"*%02X\r\n" % _xor(body)


def _xor(data: bytes) -> int:
    value = 0
    for byte in data:
        value ^= byte
    return value


def _number(text: str, lowest: float, highest: float) -> float:
    try:
        value = float(text)
    except ValueError:
        raise _Refused(BAD_VALUE) from None
    if not lowest <= value <= highest:
        raise _Refused(OUT_OF_RANGE)
    return value
