"""Requests and replies of a described device: checked templates, and their form for the driver."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, Field, field_validator

from drivers.described import description as of
from drivers.described.description import Template, parse_template
from sequences.strict_model import StrictModel

ADDRESS = frozenset({"address"})
NOTHING: frozenset[str] = frozenset()
Line = Annotated[str, Field(min_length=1, max_length=200)]


def check_has(template: Template, value: str, where: str, *, of_axes: bool = False) -> None:
    """Refuse a template without the value that it must have; of several axes, such as ``counts_2``, if it may be."""
    if value and value not in template.read_names and not (of_axes and axes_told(template, value)):
        raise ValueError(f"the value is missing; write {{{value}:...}} where it {where}.")


def axes_told(template: Template, value: str) -> set[str]:
    """Return the addresses, in small letters, of the axes of which a reply tells a value."""
    return {name.removeprefix(f"{value}_") for name in template.read_names if name.startswith(f"{value}_")}


def parsed_request(text: str, known: frozenset[str] = NOTHING, value: str = "") -> Template:
    """Read a request, which may carry one value."""
    return parse_template(text, known=known, readable=frozenset({value} - {""}))


def parsed_reply(text: str, known: frozenset[str] = NOTHING, value: str = "") -> Template:
    """Read a reply, which must have one value, or need not have any; ``request`` may stand in it too."""
    reply = parse_template(text, known=known | {"request"}, readable=None)
    check_has(reply, value, "stands", of_axes=bool(known))
    return reply


def parsed_line(text: str) -> Template:
    """Read the form of a line that answers nothing."""
    return parse_template(text, known=NOTHING, readable=None)


def _kept(check: Callable[[str], Template]) -> AfterValidator:
    """Return a validator that keeps a text which can be read."""

    def keep(text: str) -> str:
        check(text)
        return text

    return AfterValidator(keep)


RequestText = Annotated[Line, _kept(parsed_request)]
ReplyText = Annotated[Line, _kept(parsed_reply)]
LineText = Annotated[Line, _kept(parsed_line)]


class Sent(StrictModel):
    """What is sent to the device."""

    known: ClassVar[frozenset[str]] = NOTHING  # Names that may stand in it and in the reply without a kind
    carries: ClassVar[str] = ""  # Name of the value that the request carries; empty for none
    tells: ClassVar[str] = ""  # Name of the value that the reply must have; empty for none
    must_carry: ClassVar[bool] = True  # False for a setting with one value only: its request may lack it

    send: Line

    @field_validator("send")
    @classmethod
    def _is_request(cls, text: str) -> str:
        request = parsed_request(text, cls.known, cls.carries)
        if cls.must_carry:
            check_has(request, cls.carries, "belongs")
        return text

    @field_validator("reply", check_fields=False)  # of the models below
    @classmethod
    def _is_reply(cls, text: str | None) -> str | None:
        if text is not None:
            parsed_reply(text, cls.known, cls.tells)
        return text

    def _with(self, reply: str | None) -> of.Exchange:
        return of.Exchange(
            parsed_request(self.send, self.known, self.carries),
            None if reply is None else parsed_reply(reply, self.known),
        )


class Query(Sent):
    """A request and its reply."""

    reply: Line

    def for_driver(self) -> Any:
        """Return the exchange for the driver; of a query of a state its `of.Switch`."""
        return self._with(self.reply)


class Order(Sent):
    """A command, with the reply that confirms it; without one if the device does not answer it."""

    reply: Line | None = None

    def for_driver(self) -> of.Exchange:
        """Return the command for the driver."""
        return self._with(self.reply)
