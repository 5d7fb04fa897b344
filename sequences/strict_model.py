"""What all models of documents have in common: no unknown keys, one spelling of numbers, a JSON Schema that says so."""

from __future__ import annotations

import ast
import functools
import inspect
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

_PLAIN = re.compile(r"[+-]?(?:(?:0|[1-9][0-9]*)(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_ODD = re.compile(r"[+-]?[0-9][0-9_]*(?:\.[0-9_]*)?(?:[eE][+-]?[0-9_]+)?")


def is_plain_number(text: str) -> bool:
    """Return whether a text is a plain decimal number, in digits 0 to 9 and without leading zeros.

    >>> [is_plain_number(text) for text in ("60", "-0.5", ".5", "1e-3", "074", "6_0", "0x10", " 1", "nan")]
    [True, True, True, True, False, False, False, False, False]
    """
    return _PLAIN.fullmatch(text) is not None


def require_plain_number(value: Any) -> Any:
    """Refuse a text such as ``074`` or ``6_0`` that Python would read as a number, but that is not a plain decimal.

    A text that is no number at all is left to the field's own check.
    """
    if not isinstance(value, str) or is_plain_number(value):
        return value
    bare = value.strip()
    if is_plain_number(bare):
        what = "write the number without spaces"
    elif _ODD.fullmatch(bare):
        what = "write the number without leading zeros and underscores"
    else:
        return value
    raise PydanticCustomError("plain_number", "{what}", {"what": what})


@dataclass(frozen=True)
class Within:
    """The range of a number, for ``Annotated``: a message names both ends of it."""

    lowest: float
    highest: float
    unit: str = ""  # Unit of the number, for the message; empty for none
    either_sign: bool = False  # Whether the range holds for the size of the number, whatever its sign

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Add the check of the range after the check of the type."""
        return core_schema.no_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """State the range in the exported schema."""
        shown = handler(schema)
        lowest = -self.highest if self.either_sign else self.lowest
        return {**shown, "minimum": lowest, "maximum": self.highest}

    def check(self, number: float) -> float:
        """Refuse a number outside the range."""
        size = abs(number) if self.either_sign else number
        if self.lowest <= size <= self.highest:
            return number
        sign = ", positive or negative" if self.either_sign else ""
        unit = f" {self.unit}" if self.unit else ""
        raise PydanticCustomError(
            "outside",
            "must be from {lowest} to {highest}{unit}{sign}",
            {
                "lowest": f"{self.lowest:g}",
                "highest": f"{self.highest:g}",
                "unit": unit,
                "sign": sign,
            },
        )


@dataclass(frozen=True)
class Form:
    """The form of a text, for ``Annotated``: a message says it in words, and the exported schema by its pattern.

    A `Field` with lengths stands before it: behind it, its messages would speak of entries.
    """

    pattern: str
    words: str  # What the text must be, with an example

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Add the check of the form after the check of the type."""
        return core_schema.no_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """State the pattern in the exported schema."""
        return {**handler(schema), "pattern": self.pattern}

    def check(self, text: str) -> str:
        """Refuse a text of another form."""
        if re.fullmatch(self.pattern, text):
            return text
        raise PydanticCustomError("form", "must be {words}", {"words": self.words})


def with_plain_numbers(schema: Any) -> Any:
    """Return a schema of pydantic in which every number that is given as text must be a plain decimal number."""
    if isinstance(schema, list):
        return [with_plain_numbers(part) for part in schema]
    if isinstance(schema, tuple):
        return tuple(with_plain_numbers(part) for part in schema)
    if not isinstance(schema, dict):
        return schema
    if schema.get("type") == "function-before" and schema["function"].get("function") is require_plain_number:
        return schema
    kept = {"metadata", "serialization", "default", "function", "ref", "type", "cls", "config"}
    changed = {key: value if key in kept else with_plain_numbers(value) for key, value in schema.items()}
    if schema.get("type") in {"float", "int"}:
        return core_schema.no_info_before_validator_function(require_plain_number, changed)
    return changed


class StrictModel(BaseModel):
    """A mapping of a document: no unknown keys, plain finite numbers only, immutable."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True, defer_build=True)

    bare_words: ClassVar[tuple[str, ...]] = ()
    """Single words that may be written in place of the whole mapping."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Refuse numbers such as ``074`` and ``6_0`` everywhere in the document."""
        schema: CoreSchema = with_plain_numbers(handler(source))
        return schema

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Describe the keys by what stands below them, and allow the bare words in the exported schema too."""
        reference = handler(core_schema)
        schema = handler.resolve_ref_schema(reference)
        for base in reversed(cls.__mro__):
            if issubclass(base, StrictModel):
                for name, text in _below_keys(base.__module__).get(base.__name__, {}).items():
                    schema.get("properties", {}).get(name, {}).update(description=text)
        if cls.bare_words:
            mapping = dict(schema)
            schema.clear()
            schema["anyOf"] = [{"enum": list(cls.bare_words)}, mapping]
        return reference


@functools.cache
def _below_keys(module: str) -> dict[str, dict[str, str]]:
    """Return by class and name the texts below the keys of a module; pydantic would read them at every start."""
    try:
        parsed = ast.parse(inspect.getsource(sys.modules[module]))
    except (OSError, TypeError):  # a module without a file
        return {}
    return {model.name: dict(_texts(model)) for model in parsed.body if isinstance(model, ast.ClassDef)}


def _texts(model: ast.ClassDef) -> Iterator[tuple[str, str]]:
    for statement, below in pairwise(model.body):
        match statement, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                yield name, " ".join(text.split())
