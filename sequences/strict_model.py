"""The base of all documents' models: strict mappings, and bare words that stand for a mapping."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from sequences.plain_number import with_plain_numbers


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
        """Allow the bare words in the exported schema too."""
        reference = handler(core_schema)
        if cls.bare_words:
            schema = handler.resolve_ref_schema(reference)
            mapping = dict(schema)
            schema.clear()
            schema["anyOf"] = [{"enum": list(cls.bare_words)}, mapping]
        return reference
