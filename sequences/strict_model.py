"""The base of all documents' models: strict mappings, and bare words that stand for a mapping."""

from __future__ import annotations

from typing import ClassVar

from pydantic import BaseModel, ConfigDict, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema


class StrictModel(BaseModel):
    """A mapping of a document: no unknown keys, finite numbers only, immutable."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)

    bare_words: ClassVar[tuple[str, ...]] = ()
    """Single words that may be written in place of the whole mapping."""

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
