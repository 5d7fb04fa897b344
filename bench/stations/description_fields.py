"""What all descriptions of devices share: requests and replies, the line, refusals, notices, states.

The module checks templates; it reads no file and opens no device.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from bench.stations.station_fields import Text
from drivers.described import description as of
from drivers.described.description import Template, TemplateFault, parse_template
from sequences.plain_number import Within, is_plain_number
from sequences.strict_model import StrictModel

ADDRESS = frozenset({"address"})
NOTHING: frozenset[str] = frozenset()
_ENDS: Final = {"CR": b"\r", "LF": b"\n", "CRLF": b"\r\n", "space": b" "}


def template(text: str, known: frozenset[str], readable: frozenset[str] | None) -> Template:
    """Read a template; a fault of it becomes one of the document.

    known, readable: See `drivers.described.description.parse_template`.
    Raises PydanticCustomError: When it cannot be used.
    """
    try:
        return parse_template(text, known=known, readable=readable)
    except TemplateFault as fault:
        raise PydanticCustomError("template", "{fault}", {"fault": str(fault)}) from fault


def request_check(known: frozenset[str], value: str = "") -> Callable[[str], str]:
    """Return a check of a request that may carry one value, and then must.

    known: Names that may stand without a kind.
    value: Name of the value; empty for none.
    """

    def check(text: str) -> str:
        found = template(text, known, frozenset({value} - {""}))
        if value and value not in found.read_names:
            raise PydanticCustomError(
                "no_value",
                "the value is missing; write {name} where it belongs.",
                {"name": f"{{{value}:...}}"},
            )
        return text

    return check


def reply_check(known: frozenset[str], value: str = "") -> Callable[[str], str]:
    """Return a check of a reply that must have one value, or need not have any.

    known: Names that may stand without a kind, besides ``request``.
    value: Name of the value; empty for none.
    """

    def check(text: str) -> str:
        found = template(text, known | {"request"}, None)
        if value and value not in found.read_names:
            raise PydanticCustomError(
                "no_value",
                "the value is missing; write {name} where it stands.",
                {"name": f"{{{value}:...}}"},
            )
        return text

    return check


def make_exchange(send: str, reply: str | None, known: frozenset[str], value: str = "") -> of.Exchange:
    """Return an exchange for the driver, from templates that were checked.

    send, reply: The templates; None for no reply.
    known: Names that may stand without a kind.
    value: Name of the value that the request carries; empty for none.
    """
    return of.Exchange(
        template(send, known, frozenset({value} - {""})),
        None if reply is None else template(reply, known | {"request"}, None),
    )


Line = Annotated[str, Field(min_length=1, max_length=200)]


class Command(StrictModel):
    """A command to the whole device, with the reply that confirms it."""

    send: Annotated[Line, AfterValidator(request_check(NOTHING))]
    reply: Annotated[Line, AfterValidator(reply_check(NOTHING))]

    def exchange(self) -> of.Exchange:
        """Return the exchange for the driver."""
        return make_exchange(self.send, self.reply, NOTHING)


class SerialQuery(StrictModel):
    """A query of the serial number."""

    send: Annotated[Line, AfterValidator(request_check(NOTHING))]
    reply: Annotated[Line, AfterValidator(reply_check(NOTHING, "serial"))]


class StateQuery(StrictModel):
    """A query of a state. ``when`` lists the answers that mean: idle, homed, on, no fault."""

    send: Annotated[Line, AfterValidator(request_check(ADDRESS))]
    reply: Annotated[Line, AfterValidator(reply_check(ADDRESS, "state"))]
    when: Annotated[list[Text], Field(min_length=1, max_length=20)]

    @model_validator(mode="after")
    def _of_one_kind(self) -> StateQuery:
        read = template(self.reply, ADDRESS | {"request"}, None)
        kinds = {getattr(part, "kind", "") for part in read.parts if getattr(part, "name", "") == "state"}
        if kinds & {"integer", "number"} and not all(map(is_plain_number, self.when)):
            raise PydanticCustomError("when_number", "when must list numbers, as the reply has one.")
        return self

    def switch(self) -> of.Switch:
        """Return the query for the driver."""
        return of.Switch(make_exchange(self.send, self.reply, ADDRESS), tuple(self.when))


Tolerance = Annotated[float, Within(0, 50, "%")]
Factor = Annotated[float, Within(1e-12, 1e12, either_sign=True)]


class LineConfig(StrictModel):
    """The line to the device."""

    baudrate: Annotated[int, Within(50, 20_000_000, "Bd")]
    request_end: Annotated[Literal["CR", "LF", "CRLF", "space"], Field(description="Ends each request.")] = (
        "LF"
    )
    reply_end: Annotated[Literal["CR", "LF", "CRLF"], Field(description="Ends each reply.")] = "LF"
    reply_s: Annotated[float, Within(0.05, 10, "s"), Field(description="Longest wait for a reply.")] = 0.75
    quiet_s: Annotated[
        float, Within(0.02, 2, "s"), Field(description="Without a byte for this time, the line is silent.")
    ] = 0.1
    start_s: Annotated[
        float,
        Within(0, 30, "s"),
        Field(
            description="Longest time from opening the port to the first answer, if the device restarts then."
        ),
    ] = 0.0
    checksum: Annotated[
        Literal["none", "xor"], Field(description="xor: *HH after each request and each reply.")
    ] = "none"
    clear: Annotated[
        str,
        Field(
            max_length=8,
            pattern=r"^[!-~]*$",
            description="Text that makes a request invalid that was cut on its way; then it is ended.",
        ),
    ] = ""
    setup: Annotated[
        tuple[Annotated[Line, AfterValidator(request_check(NOTHING))], ...],
        Field(max_length=10, description="Requests that set the form of the replies, and nothing else."),
    ] = ()


class RefusalConfig(StrictModel):
    """A reply by which the device refuses a request."""

    reply: Annotated[Line, AfterValidator(reply_check(NOTHING))]
    means: Text | None = None
    codes: Annotated[
        dict[Annotated[str, Field(max_length=20)], Text],
        Field(default_factory=dict, max_length=200, description="Meaning by {code:...} of the reply."),
    ]


class NoticeConfig(StrictModel):
    """A text that the device sends without a request."""

    text: Annotated[str, Field(min_length=2, max_length=100, pattern=r"^[ -~]+$")]
    means: Annotated[Text | None, Field(description="What has happened; a move then fails.")] = None


class Described(StrictModel):
    """Keys of every description."""

    maker: Text
    model: Text
    line: LineConfig
    identity: Command
    serial: SerialQuery | None = None
    refusals: Annotated[tuple[RefusalConfig, ...], Field(max_length=20)] = ()
    notices: Annotated[tuple[NoticeConfig, ...], Field(max_length=20)] = ()

    def of_line(self) -> of.LineDescription:
        """Return the line for the driver."""
        return of.LineDescription(
            maker=self.maker,
            model=self.model,
            baudrate=self.line.baudrate,
            request_end=_ENDS[self.line.request_end],
            reply_end=_ENDS[self.line.reply_end],
            reply_s=self.line.reply_s,
            quiet_s=self.line.quiet_s,
            start_s=self.line.start_s,
            checksum=self.line.checksum,
            clear=self.line.clear.encode("ascii"),
            setup=tuple(template(text, NOTHING, NOTHING) for text in self.line.setup),
            identity=self.identity.exchange(),
            serial=None
            if self.serial is None
            else make_exchange(self.serial.send, self.serial.reply, NOTHING),
            refusals=tuple(
                of.Refusal(
                    template(one.reply, frozenset({"request"}), None), one.means or "", dict(one.codes)
                )
                for one in self.refusals
            ),
            notices=tuple(of.Notice(one.text, one.means or "") for one in self.notices),
        )
