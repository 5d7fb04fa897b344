"""The ledger section of a station file: the second place for the head of the ledger, and what a break of it does."""

from __future__ import annotations

from pathlib import PurePosixPath, PureWindowsPath
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from sequences.strict_model import StrictModel

_STRICT = "strict"


def _absolute(path: str) -> str:
    """Accept an absolute path only: the station file is copied into every run folder. Raises PydanticCustomError."""
    if not (PurePosixPath(path).is_absolute() or PureWindowsPath(path).is_absolute()):
        raise PydanticCustomError(
            "not_absolute", "must be an absolute path of a file, such as /mnt/office/bench2.heads."
        )
    return path


class LedgerConfig(StrictModel):
    """Second place for the head of the bench's ledger, and what an unexplained break of the ledger does."""

    anchor: Annotated[
        str | None,
        Field(
            min_length=2,
            max_length=4096,
            description="File on another disk or share; each new head of the ledger is added to it.",
        ),
        AfterValidator(lambda path: None if path is None else _absolute(path)),
    ] = None
    strict: Annotated[
        bool, Field(description="Whether a break of the ledger that nobody has explained stops a run.")
    ] = False

    bare_words = (_STRICT,)

    @model_validator(mode="before")
    @classmethod
    def _from_word(cls, value: Any) -> Any:
        return {"strict": "true"} if value == _STRICT else value
