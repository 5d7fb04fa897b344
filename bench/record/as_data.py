"""A dataclass as journal and results hold it."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, TypeVar, cast

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Form = TypeVar("Form")


def as_data(made: DataclassInstance, _form: type[Form]) -> Form:
    """Return the fields of a dataclass with the type of their place in a file, whose keys are these fields."""
    return cast("Form", asdict(made))
