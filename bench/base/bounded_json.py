"""Parse JSON that others may have written: one reading only, and bounded, so that memory and stack are too.

What two readers could read differently is refused: a key that stands twice, a byte-order mark, ``NaN``, blanks behind
the end. `canonical_json` is the one form that the program writes.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final

MOST_LEVELS: Final = 100
"""Deepest nesting that is read; the deepest file of Starbench has less than 20 levels."""
MOST_VALUES: Final = 5_000_000
"""Most values that are read: the results of ten thousand poses have three million. Each needs about 100 bytes."""


def parse_json(data: bytes | str) -> Any:
    """Parse JSON of bounded depth and size that all readers read alike, else `ValueError`, never RecursionError."""
    text = data.decode("utf-8") if isinstance(data, bytes) else data
    levels = text.count("[") + text.count("{")
    if len(text) > MOST_VALUES and levels + text.count(",") > MOST_VALUES:
        raise ValueError(f"it has more than {MOST_VALUES} values")
    if text.removesuffix("\n")[-1:].isspace():
        windows = "its lines end in CR LF, as on Windows"
        raise ValueError(windows if text.endswith("\r\n") else "blanks stand behind its end")
    if text.startswith("\ufeff"):
        raise ValueError("it begins with a byte-order mark (BOM)")
    try:
        value = _DECODER.decode(text)
    except RecursionError:
        raise _too_deep() from None
    if levels > MOST_LEVELS:  # else it cannot have so many levels
        _refuse_deep(value)
    return value


def canonical_json(value: Any, *, ascii_only: bool = True) -> bytes:
    """Return JSON as all files of a run, a certificate or of recalculated results hold it; numbers must be finite.

    A dataclass is written as its fields.
    """
    text = json.dumps(value, indent=1, allow_nan=False, ensure_ascii=ascii_only, default=asdict)
    return (text + "\n").encode()


def content_key(parts: Mapping[str, Any]) -> str:
    """Return the hash of all that decides a result: 64 hexadecimal digits.

    >>> content_key({"a": 1, "b": 2}) == content_key({"b": 2, "a": 1})
    True
    """
    return hashlib.sha256(json.dumps(parts, sort_keys=True, allow_nan=False).encode()).hexdigest()


def leaves(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Yield each value of a JSON value with its path of keys and places; empty mappings and lists are values."""
    if isinstance(value, Mapping) and value:
        for name, inner in value.items():
            yield from leaves(inner, (*path, name))
    elif isinstance(value, list | tuple) and value:
        for number, inner in enumerate(value):
            yield from leaves(inner, (*path, number))
    else:
        yield path, value


def mapped(value: Any, change: Callable[[Any], Any]) -> Any:
    """Return a JSON value in which each value is changed; tuples become lists."""
    if isinstance(value, Mapping):
        return {name: mapped(inner, change) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [mapped(inner, change) for inner in value]
    return change(value)


def without_nan(value: Any) -> Any:
    """Return a JSON value with None in place of numbers that are not finite, which JSON does not have."""
    return mapped(value, lambda leaf: None if isinstance(leaf, float) and not math.isfinite(leaf) else leaf)


def _without_doubles(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    mapping = dict(pairs)
    if len(mapping) != len(pairs):
        names = [name for name, _ in pairs]
        double = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the key {double[:40]!r} is there twice")
    return mapping


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is not a number")


_DECODER: Final = json.JSONDecoder(object_pairs_hook=_without_doubles, parse_constant=_refuse_constant)


def _refuse_deep(value: Any) -> None:
    """Raise ValueError for a value with too many levels. Level by level, because a recursion could be too deep."""
    level = [value] if isinstance(value, dict | list) else []
    for _ in range(MOST_LEVELS):
        if not level:
            return
        level = [
            inner
            for container in level
            for inner in (container.values() if isinstance(container, dict) else container)
            if isinstance(inner, dict | list)
        ]
    if level:
        raise _too_deep()


def _too_deep() -> ValueError:
    return ValueError(f"it is nested too deeply: more than {MOST_LEVELS} levels")
