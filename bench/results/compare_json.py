"""Compares two contents of JSON files value by value, and names each difference by its place."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

Number = int | float


@dataclass(frozen=True)
class Difference:
    """One difference."""

    where: str  # Place of the value: ``poses[0].attempts[1].sha256``
    # ``value``: both have it, and it differs. ``missing``: only the derived content has it. ``added``: only
    # the stored content has it.
    kind: Literal["value", "missing", "added"]
    # stored, derived: Both values; None where there is none.
    stored: Any
    derived: Any

    def __str__(self) -> str:
        if self.kind == "added":
            return f"{self.where} is {_shown(self.stored)}, which follows from nothing"
        if self.kind == "missing":
            return f"{self.where} is missing; it must be {_shown(self.derived)}"
        return f"{self.where} is {_shown(self.stored)}; it must be {_shown(self.derived)}"


Tolerance = Callable[[str, Number, Number, float], bool]
"""Whether two numbers count as equal: place, both numbers, and the largest number of their list."""


def exactly(_where: str, stored: Number, derived: Number, _scale: float) -> bool:
    """Return whether two numbers are equal to the last bit.

    Returns: True if they are.
    """
    return stored == derived


def differences(
    stored: Any, derived: Any, equal: Tolerance = exactly, where: str = ""
) -> Iterator[Difference]:
    """Compare two contents.

    equal: Whether two numbers count as equal.
    Yields: Each difference, in the order of the derived content.
    """
    yield from _differences(stored, json.loads(json.dumps(derived)), equal, where, 0.0)


def _differences(
    stored: Any, derived: Any, equal: Tolerance, where: str, scale: float
) -> Iterator[Difference]:
    if isinstance(derived, dict) and isinstance(stored, Mapping):
        for name, value in derived.items():
            place = f"{where}.{name}" if where else str(name)
            if name not in stored:
                yield Difference(place, "missing", None, value)
            else:
                yield from _differences(stored[name], value, equal, place, 0.0)
        for name in stored:
            if name not in derived:
                yield Difference(f"{where}.{name}" if where else str(name), "added", stored[name], None)
    elif isinstance(derived, list) and isinstance(stored, Sequence) and not isinstance(stored, str):
        if len(derived) != len(stored):
            kind: Literal["missing", "added"] = "missing" if len(stored) < len(derived) else "added"
            last = min(len(stored), len(derived))
            one = (None, derived[last]) if kind == "missing" else (stored[last], None)
            yield Difference(f"{where}[{last}]", kind, *one)
        scale = max(scale, _largest([*derived, *stored]))
        for number, (had, due) in enumerate(zip(stored, derived, strict=False)):
            yield from _differences(had, due, equal, f"{where}[{number}]", scale)
    elif not _same(stored, derived, equal, where, scale):
        yield Difference(where, "value", stored, derived)


def _same(stored: Any, derived: Any, equal: Tolerance, where: str, scale: float) -> bool:
    if _is_number(stored) and _is_number(derived):
        return equal(where, stored, derived, max(scale, abs(derived)))
    return type(stored) is type(derived) and bool(stored == derived)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _largest(values: Sequence[Any]) -> float:
    return max((abs(float(value)) for value in values if _is_number(value)), default=0.0)


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False) if not isinstance(value, float) else f"{value:.12g}"
    return text if len(text) <= 70 else f"{text[:67]}..."
