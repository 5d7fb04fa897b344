"""The description of a light's protocol: keys, checks, and its form for the driver. Opens nothing."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from bench.stations.description_fields import (
    NOTHING,
    Command,
    Described,
    Factor,
    Line,
    StateQuery,
    Tolerance,
    make_exchange,
    reply_check,
    request_check,
)
from bench.stations.station_fields import Text
from drivers.described import description as of
from sequences.strict_model import StrictModel


class _Set(StrictModel):
    """A command that sets a value of a light."""

    send: Annotated[Line, AfterValidator(request_check(NOTHING, "value"))]
    reply: Annotated[Line, AfterValidator(reply_check(NOTHING))]


class _Get(StrictModel):
    """A query of a value of a light."""

    send: Annotated[Line, AfterValidator(request_check(NOTHING))]
    reply: Annotated[Line, AfterValidator(reply_check(NOTHING, "value"))]


_WORDS: Final = {"waveform": {"square", "sine", "steady"}, "sync": {"on", "off"}}


class LightSettingConfig(StrictModel):
    """A setting of a light: written in the order of the file, and read back."""

    quantity: Literal["waveform", "frequency_hz", "duty_percent", "level_percent", "sync", "constant"]
    set: _Set
    query: _Get
    words: Annotated[
        dict[Text, Text],
        Field(
            default_factory=dict, max_length=5, description="The device's words for square, steady, on, off."
        ),
    ]
    takes: Annotated[
        Literal["value", "reciprocal"], Field(description="reciprocal: a period instead of a frequency.")
    ] = "value"
    factor: Annotated[Factor, Field(description="1000 for a period in ms.")] = 1.0
    range: tuple[float, float] | None = None
    value: Annotated[float | None, Field(description="Value of a constant.")] = None
    tolerance_percent: Tolerance = 0.0

    @model_validator(mode="after")
    def _consistent(self) -> LightSettingConfig:
        if (self.quantity == "constant") != (self.value is not None):
            raise PydanticCustomError("constant_value", "a constant needs value; no other setting has one.")
        known = _WORDS.get(self.quantity, set())
        if bool(known) != bool(self.words) or not set(self.words) <= known:
            named = ", ".join(sorted(known)) or "none"
            raise PydanticCustomError("words", "words of this setting: {named}.", {"named": named})
        if len(set(self.words.values())) < len(self.words):
            raise PydanticCustomError("same_words", "two words are the same for the device.")
        if self.range is not None and self.range[0] >= self.range[1]:
            raise PydanticCustomError("range_order", "range must be [lowest, highest].")
        return self

    def setting(self) -> of.LightSetting:
        """Return the setting for the driver."""
        lowest, highest = self.range or (float("-inf"), float("inf"))
        return of.LightSetting(
            quantity=self.quantity,
            set=make_exchange(self.set.send, self.set.reply, NOTHING, "value"),
            query=make_exchange(self.query.send, self.query.reply, NOTHING),
            factor=self.factor,
            inverse=self.takes == "reciprocal",
            words=dict(self.words),
            constant=self.value or 0.0,
            lowest=lowest,
            highest=highest,
            tolerance_percent=self.tolerance_percent,
        )


class LightProtocol(Described):
    """The description of a light."""

    format: Literal["starbench/light-protocol/1"]
    on: Command
    off: Command
    output: StateQuery
    faults: StateQuery | None = None
    settings: Annotated[list[LightSettingConfig], Field(min_length=1, max_length=20)]

    @model_validator(mode="after")
    def _needed(self) -> LightProtocol:
        names = [one.quantity for one in self.settings if one.quantity != "constant"]
        missing = {"frequency_hz", "level_percent"} - set(names)
        if missing:
            listed = " and ".join(sorted(missing))
            raise PydanticCustomError("settings_missing", "settings needs {listed}.", {"listed": listed})
        if len(names) > len(set(names)):
            raise PydanticCustomError("settings_twice", "a quantity stands twice in settings.")
        return self

    @property
    def has_sync(self) -> bool:
        """Whether the light has a sync output."""
        return any(one.quantity == "sync" for one in self.settings)

    @property
    def frequency_range_hz(self) -> tuple[float, float] | None:
        """Range of the flicker frequency, Hz; None if the description states none."""
        return next((one.range for one in self.settings if one.quantity == "frequency_hz"), None)

    def for_driver(self) -> of.LightDescription:
        """Return the description for the driver."""
        return of.LightDescription(
            line=self.of_line(),
            on=self.on.exchange(),
            off=self.off.exchange(),
            is_on=self.output.switch(),
            faults=None if self.faults is None else self.faults.switch(),
            settings=tuple(one.setting() for one in self.settings),
        )
