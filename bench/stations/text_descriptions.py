"""The description of a stage's protocol: keys, checks, and its form for the driver. Opens nothing."""

from __future__ import annotations

import re
from dataclasses import fields
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self, TypeVar

from pydantic import Field, model_validator

from bench.stations.described_exchanges import (
    ADDRESS,
    LineText,
    Order,
    Query,
    ReplyText,
    RequestText,
    axes_told,
    check_has,
    parsed_line,
    parsed_reply,
    parsed_request,
)
from bench.stations.station_fields import Frame, Text
from drivers.described import description as of
from drivers.serial_port import LineSettings
from sequences.strict_model import Form, StrictModel, Within, is_plain_number

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_ENDS: Final = {"CR": b"\r", "LF": b"\n", "CRLF": b"\r\n", "space": b" ", "none": b""}
_D = TypeVar("_D", bound="DataclassInstance")

Tolerance = Annotated[float, Within(0, 50, "%")]
Factor = Annotated[float, Within(1e-12, 1e12, either_sign=True)]

_NUMERIC = re.compile(r"[-+]?[0-9]{1,15}")
_WORDS: Final = {"waveform": {"square", "sine", "steady"}, "sync": {"on", "off"}}


def made_of(kind: type[_D], *sections: StrictModel, **others: Any) -> _D:
    """Return a driver's object. Each field that ``others`` does not give comes from the first section that has it."""
    names = [field.name for field in fields(kind) if field.name not in others]
    values = {name: next(getattr(part, name) for part in sections if hasattr(part, name)) for name in names}
    return kind(**{name: _for_driver(value) for name, value in values.items()}, **others)


def _for_driver(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return tuple(map(_for_driver, value))
    return value.for_driver() if hasattr(value, "for_driver") else value


class SerialQuery(Query):
    """A query of the serial number."""

    tells = "serial"


class StateQuery(Query):
    """A query of a state. ``when`` lists the answers that mean: idle, homed, on, no fault."""

    known, tells = ADDRESS, "state"

    when: Annotated[list[Text], Field(min_length=1, max_length=20)]
    bits: tuple[Annotated[int, Within(0, 31, "")], ...] = ()
    """Bits of the answer that count, from 0; the others are taken as 0."""

    @model_validator(mode="after")
    def _of_one_kind(self) -> StateQuery:
        read = of.parse_template(self.reply, known=ADDRESS | {"request"}, readable=None)
        kinds = {
            part.kind
            for part in read.parts
            if isinstance(part, of.Placeholder) and part.name.startswith("state")
        }
        is_number = bool(kinds & {"integer", "number", "size", "hex", "signed_hex"})
        if is_number and not all(map(is_plain_number, self.when)):
            raise ValueError("when must list numbers, as the reply has one.")
        if self.bits and (not is_number or "number" in kinds):
            raise ValueError("bits needs a state that is a whole number.")
        return self

    def for_driver(self) -> of.Switch:
        """Return the query for the driver."""
        mask = sum(1 << bit for bit in set(self.bits)) if self.bits else -1
        return of.Switch(super().for_driver(), tuple(self.when), mask)


class LineConfig(StrictModel):
    """The line to the device."""

    baudrate: Annotated[int, Within(50, 20_000_000, "Bd")]
    rtscts: bool = False
    """Whether the line has hardware flow control (RTS/CTS)."""
    frame: Frame = "8N1"
    """Data bits, parity and stop bits."""
    xonxoff: bool = False
    """Whether the bytes XON and XOFF hold the sender."""
    request_end: Literal["CR", "LF", "CRLF", "space", "none"] = "LF"
    """Ends each request."""
    reply_end: Literal["CR", "LF", "CRLF", "none"] = "LF"
    """Ends each reply; none: a silence of `quiet_s` ends it."""
    prompt: Annotated[str, Field(max_length=20), Form(r"^[ -~]*$", "ASCII characters")] = ""
    """Ends each reply in place of `reply_end`, and stands in it."""
    reply_s: Annotated[float, Within(0.05, 10, "s")] = 0.75
    """Longest wait for a reply."""
    quiet_s: Annotated[float, Within(0.02, 2, "s")] = 0.1
    """Without a byte for this time, the line is silent."""
    start_s: Annotated[float, Within(0, 30, "s")] = 0.0
    """Longest time from opening the port to the first answer, if the device restarts then."""
    checksum: of.Checksum = "none"
    """Two hexadecimal digits after each request and each reply: of the XOR of all bytes, behind a star, of their sum,
    or of its two's complement."""
    clear: Annotated[str, Field(max_length=8), Form(r"^[!-~]*$", "ASCII characters without blanks")] = ""
    """Text that makes a request invalid that was cut on its way; then it is ended."""
    setup: Annotated[tuple[RequestText, ...], Field(max_length=10)] = ()
    """Requests that set the form of the replies, and nothing else."""


class RefusalConfig(StrictModel):
    """A reply by which the device refuses a request."""

    reply: ReplyText
    means: Text | None = None
    codes: Annotated[
        dict[Annotated[str, Field(max_length=20)], Text], Field(default_factory=dict, max_length=200)
    ]
    """Meaning by {code:...} of the reply."""
    fine: Annotated[tuple[Text, ...], Field(max_length=20)] = ()
    """Codes that refuse nothing."""


class NoticeConfig(StrictModel):
    """A text that the device sends without a request."""

    text: Annotated[str, Field(min_length=2, max_length=100), Form(r"^[ -~]+$", "ASCII characters")]
    means: Text | None = None
    """What has happened; a move then fails."""


class Described(StrictModel):
    """Keys of every description."""

    maker: Text
    model: Text
    line: LineConfig
    identity: Query
    serial: SerialQuery | None = None
    refusals: Annotated[tuple[RefusalConfig, ...], Field(max_length=20)] = ()
    notices: Annotated[tuple[NoticeConfig, ...], Field(max_length=20)] = ()
    unasked: Annotated[tuple[LineText, ...], Field(max_length=20)] = ()
    """Lines that the device sends without a request; they are left out."""

    def of_line(self) -> of.LineDescription:
        """Return the line for the driver."""
        return made_of(
            of.LineDescription,
            self,
            self.line,
            settings=LineSettings(self.line.baudrate, self.line.rtscts, self.line.frame, self.line.xonxoff),
            request_end=_ENDS[self.line.request_end],
            reply_end=_ENDS[self.line.reply_end],
            prompt=self.line.prompt.encode("ascii"),
            clear=self.line.clear.encode("ascii"),
            setup=tuple(map(parsed_request, self.line.setup)),
            refusals=tuple(
                of.Refusal(
                    parsed_reply(refusal.reply), refusal.means or "", dict(refusal.codes), refusal.fine
                )
                for refusal in self.refusals
            ),
            notices=tuple(of.Notice(notice.text, notice.means or "") for notice in self.notices),
            unasked=tuple(map(parsed_line, self.unasked)),
        )


class _SettingConfig(StrictModel):
    """What the settings of lights and of axes share."""

    value: Annotated[float | Text | None, Field(union_mode="left_to_right")] = None
    """Value of a constant."""
    tolerance_percent: Tolerance = 0.0

    if TYPE_CHECKING:

        @property
        def quantity(self) -> str: ...

        @property
        def set(self) -> Order: ...

    @model_validator(mode="after")
    def _has_value(self) -> Self:
        if (self.quantity == "constant") != (self.value is not None):
            raise ValueError("a constant needs value; no other setting has one.")
        if self.value is None:
            check_has(parsed_request(self.set.send, self.set.known, "value"), "value", "belongs")
        return self


class _Set(Order):
    """A command that sets a value of a light."""

    carries, must_carry = "value", False


class _Get(Query):
    """A query of a value of a light."""

    tells = "value"


class LightSettingConfig(_SettingConfig):
    """A setting of a light: written in the order of the file, and read back."""

    quantity: Literal["waveform", "frequency_hz", "duty_percent", "level_percent", "sync", "constant"]
    set: _Set
    query: _Get
    words: Annotated[dict[Text, Text], Field(default_factory=dict, max_length=5)]
    """The device's words for square, steady, on, off."""
    takes: Literal["value", "reciprocal"] = "value"
    """reciprocal: a period instead of a frequency."""
    factor: Factor = 1.0
    """1000 for a period in ms."""
    query_factor: Factor | None = None
    """Factor of the value that is read, if it is another one."""
    range: tuple[float, float] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> LightSettingConfig:
        known = _WORDS.get(self.quantity, set())
        if bool(known) != bool(self.words) or not set(self.words) <= known:
            named = ", ".join(sorted(known)) or "none"
            raise ValueError(f"words of this setting: {named}.")
        if not re.search(r"\{value:(word|text)\}", self.query.reply) and not all(
            map(_NUMERIC.fullmatch, self.words.values())
        ):
            raise ValueError("words must be numbers, as the reply has one.")
        if len(set(self.words.values())) < len(self.words):
            raise ValueError("two words are the same for the device.")
        if self.range is not None and self.range[0] >= self.range[1]:
            raise ValueError("range must be [lowest, highest].")
        return self

    def for_driver(self) -> of.LightSetting:
        """Return the setting for the driver."""
        lowest, highest = self.range or (float("-inf"), float("inf"))
        return made_of(
            of.LightSetting,
            self,
            query_factor=self.query_factor or self.factor,
            inverse=self.takes == "reciprocal",
            constant=self.value or 0.0,
            lowest=lowest,
            highest=highest,
        )


class LightProtocol(Described):
    """The description of a light."""

    format: Literal["starbench/light-protocol/1"]
    on: Order
    off: Order
    output: StateQuery
    faults: StateQuery | None = None
    settings: Annotated[list[LightSettingConfig], Field(min_length=1, max_length=20)]

    @model_validator(mode="after")
    def _needed(self) -> LightProtocol:
        names = [setting.quantity for setting in self.settings if setting.quantity != "constant"]
        missing = {"frequency_hz", "level_percent"} - set(names)
        if missing:
            listed = " and ".join(sorted(missing))
            raise ValueError(f"settings needs {listed}.")
        if len(names) > len(set(names)):
            raise ValueError("a quantity stands twice in settings.")
        return self

    @property
    def has_sync(self) -> bool:
        """Whether the light has a sync output."""
        return any(setting.quantity == "sync" for setting in self.settings)

    @property
    def frequency_range_hz(self) -> tuple[float, float] | None:
        """Range of the flicker frequency, Hz; None if the description states none."""
        return next((setting.range for setting in self.settings if setting.quantity == "frequency_hz"), None)

    def for_driver(self) -> of.LightDescription:
        """Return the description for the driver."""
        return made_of(of.LightDescription, self, line=self.of_line(), is_on=self.output.for_driver())


class _AxisQuery(Query):
    """A query to an axis whose reply has the value ``counts``."""

    known, tells = ADDRESS, "counts"


class _AxisCommand(Order):
    """A command to an axis."""

    known = ADDRESS


class _Motion(_AxisCommand):
    """A command that moves an axis."""

    reply_comes: Literal["at_once", "at_end"] = "at_once"
    """Whether the device replies at once, or when the motion has ended."""

    @model_validator(mode="after")
    def _has_late_reply(self) -> Self:
        if self.reply_comes == "at_end" and self.reply is None:
            raise ValueError("reply_comes: at_end needs reply.")
        return self


class _Move(_Motion):
    """A move to an absolute position, which stands as ``{target:...}`` in counts."""

    carries = "target"


class _Scale(Query):
    """A query of the scale of an axis."""

    known, tells = ADDRESS, "scale"

    unit: Literal["counts_per_deg", "deg_per_count", "arcsec_per_count"]


class _SetAxis(Order):
    """A command that sets a value of an axis."""

    known, carries, must_carry = ADDRESS, "value", False


class _GetAxis(Query):
    """A query of a value of an axis."""

    known, tells = ADDRESS, "value"


class AxisSettingConfig(_SettingConfig):
    """A setting of an axis, in counts (``speed``: counts/s): written when the device is opened, and read back."""

    quantity: Literal["speed", "acceleration", "lowest", "highest", "constant"]
    set: _SetAxis
    query: _GetAxis
    factor: Factor = 1.0
    """The device's value divided by that in counts."""

    def for_driver(self) -> of.AxisSetting:
        """Return the setting for the driver."""
        return made_of(of.AxisSetting, self, constant=self.value or 0.0)


class AxisProtocol(StrictModel):
    """Requests to one axis; ``{address}`` is the axis's address in the station file."""

    position: _AxisQuery
    idle: StateQuery
    move: _Move
    start: _AxisCommand | None = None
    """Starts the move, where `move` sets the target alone."""
    home: _Motion
    at_home: float | None = None
    """Counts at which a finished search of the reference leaves the axis."""
    encoder: _AxisQuery | None = None
    reference: StateQuery | Literal["own"] = "own"
    """Whether the axis has a reference; own: the device does not tell."""
    errors: StateQuery | None = None
    """Errors of commands; asked after each command that the device does not answer."""
    faults: StateQuery | None = None
    scale: _Scale | None = None
    lowest: _AxisQuery | None = None
    highest: _AxisQuery | None = None
    settings: Annotated[tuple[AxisSettingConfig, ...], Field(max_length=20)] = ()
    setup: Annotated[tuple[_AxisCommand, ...], Field(max_length=20)] = ()


class StageProtocol(Described):
    """The description of a stage."""

    format: Literal["starbench/stage-protocol/1"]
    stop: _AxisCommand
    modes: Annotated[tuple[Order, ...], Field(max_length=20)] = ()
    """Commands that undo modes of another program; sent between stops, before settings."""
    axis: AxisProtocol

    @property
    def has_addresses(self) -> bool:
        """Whether moves name their axis, so that there may be several."""
        return "{address}" in self.axis.move.send

    def untold(self, address: str) -> list[str]:
        """Return the keys of the queries whose reply tells of several axes, but not of the one with this address."""
        queries = {name: getattr(self.axis, name) for name in type(self.axis).model_fields}
        queries |= {f"settings[{at}].query": setting.query for at, setting in enumerate(self.axis.settings)}
        by_query = {
            name: axes_told(parsed_reply(query.reply, query.known, query.tells), query.tells)
            for name, query in queries.items()
            if isinstance(query, Query)
        }
        return [
            name for name, addresses in by_query.items() if addresses and address.lower() not in addresses
        ]

    def for_driver(self) -> of.StageDescription:
        """Return the description for the driver."""
        axis = self.axis
        return made_of(
            of.StageDescription,
            axis,
            self,
            line=self.of_line(),
            reference=None if axis.reference == "own" else axis.reference.for_driver(),
            home_replies_at_end=axis.home.reply_comes == "at_end",
            move_replies_at_end=axis.move.reply_comes == "at_end",
            scale_unit=axis.scale.unit if axis.scale else "counts_per_deg",
        )
