"""Frozen dataclasses to JSON and back. Reading is strict: every key, and each value of its stated type.

It knows texts, whole numbers, finite numbers, booleans, literals, tuples, values that may be None, and dataclasses of
these. It touches no files.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from functools import cache
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

from bench.base.bounded_json import canonical_json, parse_json
from bench.base.errors import EvidenceError

Data = TypeVar("Data")
_MOST_FAULTS = 20


def to_json(data: Any) -> bytes:
    """Return a dataclass as JSON with a final line feed; the same data gives the same bytes."""
    return canonical_json(dataclasses.asdict(data), ascii_only=False)


def from_json(data: bytes, kind: type[Data], where: str) -> Data:
    """Read a dataclass from JSON.

    Raises EvidenceError: When it is not JSON, a key is missing, unknown or double, or a value is not of its
      type; the message names up to 20 faults.
    """
    faults: list[str] = []
    try:
        found = parse_json(data)
        value = _read(found, kind, "", faults)
    except ValueError as error:
        faults = [f"it is not readable JSON ({error})"]
        value = None
    if faults:
        more = [f"and {len(faults) - _MOST_FAULTS} more"] if len(faults) > _MOST_FAULTS else []
        raise EvidenceError(
            "This is not a certificate of this form: " + "; ".join([*faults[:_MOST_FAULTS], *more]) + ".",
            where=where,
            remedy="Another version of Starbench wrote it, or it was changed.",
        )
    return typing.cast("Data", value)


@cache
def _fields(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind)


def _read(found: Any, kind: Any, path: str, faults: list[str]) -> Any:
    """Return a value of a type; add a fault, and return None, where it is not one."""
    origin = get_origin(kind)
    if origin in (Union, types.UnionType):
        (inner,) = (one for one in get_args(kind) if one is not type(None))
        return None if found is None else _read(found, inner, path, faults)
    if origin is tuple and isinstance(found, list):
        inner = get_args(kind)[0]
        return tuple(_read(one, inner, f"{path}[{at}]", faults) for at, one in enumerate(found))
    if dataclasses.is_dataclass(kind) and isinstance(found, dict):
        return _read_dataclass(found, kind, path, faults)
    if _is_plain(found, kind):
        return float(found) if kind is float else found
    faults.append(f"{path or 'the whole'} must be {_name(kind)}")
    return None


def _is_plain(found: Any, kind: Any) -> bool:
    """Return whether a value is of a type that is neither a list nor a mapping."""
    if get_origin(kind) is Literal:
        return isinstance(found, str) and found in get_args(kind)
    if kind is float:
        return isinstance(found, int | float) and not isinstance(found, bool) and math.isfinite(found)
    return type(found) is kind


def _read_dataclass(found: dict[str, Any], kind: Any, path: str, faults: list[str]) -> Any:
    fields = _fields(kind)
    prefix = f"{path}." if path else ""
    faults += [f"{prefix}{name} is missing" for name in fields if name not in found]
    faults += [f"{prefix}{name[:60]} is unknown" for name in found if name not in fields]
    if set(found) != set(fields):
        return None
    before = len(faults)
    values = {name: _read(found[name], wanted, f"{prefix}{name}", faults) for name, wanted in fields.items()}
    return kind(**values) if len(faults) == before else None


def _name(kind: Any) -> str:
    if get_origin(kind) is tuple:
        return "a list"
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(map(str, get_args(kind)))
    names = {str: "a text", float: "a finite number", int: "a whole number", bool: "true or false"}
    return names.get(kind, "a mapping")
