"""Reading of the configuration by pydantic: types that check themselves, and errors that name the key and its place.

A section of the configuration is a dataclass derived from `Section`; its fields state type and range.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from functools import lru_cache
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BeforeValidator, TypeAdapter, ValidationError, model_validator

from simulators.errors import ConfigError

_Kind = TypeVar("_Kind")

_NEGATIVE = "{!r} is negative.", "Give a number of at least 0."


class Wrong(ValueError):
    """A value that is not valid; ``at`` names a place within it."""

    def __init__(self, what: str, remedy: str = "", at: str = "") -> None:
        super().__init__(what)
        self.remedy, self.at = remedy, at


class Section:
    """A section of the configuration: a mapping with the fields of a dataclass as keys."""

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, given: object) -> object:
        if isinstance(given, cls):
            return given
        if not isinstance(given, Mapping):
            raise Wrong(f"A mapping is expected, not {given!r}.")
        known = keys_of(cls)
        for key in given:
            if key not in known:
                raise Wrong("Unknown key.", f"Known are: {', '.join(known)}.", f".{key}")
        return dict(given)


def keys_of(section: type) -> list[str]:
    """Return the keys of a section."""
    return [field.name for field in fields(section)]


def read_section(kind: type[_Kind], given: object, where: str, over: _Kind | None = None) -> _Kind:
    """Read a section (see `read`); the values of ``over``, or the defaults, hold where no key is given."""
    if over is None or not isinstance(given, Mapping):
        section: _Kind = read(kind, given, where)
        return section
    unchanged = {key: getattr(over, key) for key in keys_of(kind) if key not in given}
    changed: _Kind = read(kind, {**given, **unchanged}, where)
    return changed


def read(kind: Any, given: object, where: str) -> Any:
    """Read a value of a type; `ConfigError` names the invalid key that is given first."""
    try:
        return _adapter(kind).validate_python(given)
    except ValidationError as error:
        order = list(given) if isinstance(given, Mapping) else []
        first = min(
            error.errors(), key=lambda detail: order.index(detail["loc"][0]) if detail["loc"] and order else 0
        )
        why = first.get("ctx", {}).get("error", first["msg"])
        at, remedy = (why.at, why.remedy) if isinstance(why, Wrong) else ("", "")
        inside = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"])
        raise ConfigError(str(why), where=f"{where}{inside}{at}", remedy=remedy) from error


@lru_cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def number(value: object, at: str = "") -> float:
    """Check that a value is a finite number; ``at`` names its place."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= sys.float_info.max:
        raise Wrong(f"A finite number is expected, not {value!r}.", at=at)
    return float(value)


def numbers(count: int) -> BeforeValidator:
    """Return the check of a list of some numbers."""

    def check(value: object) -> tuple[float, ...]:
        if not isinstance(value, (list, tuple)) or len(value) != count:
            raise Wrong(f"{count} numbers are expected, not {value!r}.")
        return tuple(number(element) for element in value)

    return BeforeValidator(check)


def refused_as_given(wrong: Callable[[float], bool], what: str, remedy: str = "") -> BeforeValidator:
    """Return the check of a number whose message shows it as it is given, in place of {!r}."""

    def check(value: object) -> object:
        if wrong(number(value)):
            raise Wrong(what.format(value), remedy)
        return value

    return BeforeValidator(check)


def refused(wrong: Callable[[Any], bool], what: str, remedy: str = "") -> AfterValidator:
    """Return the check of a value of the right type; the message shows it in place of {}."""

    def check(value: Any) -> Any:
        if wrong(value):
            raise Wrong(what.format(value), remedy)
        return value

    return AfterValidator(check)


def one_of(known: Collection[str], what: str = "value") -> BeforeValidator:
    """Return the check of one of a few words."""

    def check(value: object) -> object:
        if not isinstance(value, str) or value not in known:
            raise Wrong(f"Unknown {what} {value!r}.", f"Use one of: {', '.join(known)}.")
        return value

    return BeforeValidator(check)


def _whole(value: object) -> int:
    if number(value) != int(number(value)):
        raise Wrong(f"A whole number is expected, not {value!r}.")
    return int(number(value))


def _count(value: object) -> int:
    if number(value) != int(number(value)) or number(value) < 1:
        raise Wrong(f"A whole number of at least 1 is expected, not {value!r}.")
    return int(number(value))


def text(value: object) -> str:
    """Check that a value is text."""
    if not isinstance(value, str):
        raise Wrong(f"Text is expected, not {value!r}.")
    return value


def _switch(value: object) -> bool:
    if not isinstance(value, bool):
        raise Wrong(f"True or false is expected, not {value!r}.")
    return value


Number = Annotated[float, BeforeValidator(number)]
Positive = Annotated[
    float, refused_as_given(lambda value: value <= 0.0, "{!r} is not positive.", "Give a positive number.")
]
NotNegative = Annotated[float, refused_as_given(lambda value: value < 0.0, *_NEGATIVE)]
Pair = Annotated[tuple[float, float], numbers(2)]
Vector = Annotated[tuple[float, float, float], numbers(3)]
Whole = Annotated[int, BeforeValidator(_whole)]
Count = Annotated[int, BeforeValidator(_count)]
Text = Annotated[str, BeforeValidator(text)]
Switch = Annotated[bool, BeforeValidator(_switch)]
