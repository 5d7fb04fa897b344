"""Parse JSON that others may have written. Depth and number of values are bounded, so memory and stack are too.

Files are read by `bench.records.reading`, which bounds their size.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, Final

MOST_LEVELS: Final = 100
"""Deepest nesting that is read; the deepest file of Starbench has less than 20 levels."""
MOST_VALUES: Final = 5_000_000
"""Most values that are read: the results of ten thousand poses have three million. Each needs about 100 bytes."""


def parse_json(
    data: bytes | str,
    *,
    object_pairs_hook: Callable[[list[tuple[str, Any]]], Any] | None = None,
    parse_constant: Callable[[str], Any] | None = None,
) -> Any:
    """Parse JSON of a bounded depth and number of values.

    object_pairs_hook, parse_constant: As for `json.loads`.
    Raises ValueError: If it is not JSON, is nested too deeply, or has too many values; never RecursionError.
    """
    marks: tuple[Any, ...] = (b",", b"[", b"{") if isinstance(data, bytes) else (",", "[", "{")
    if sum(data.count(mark) for mark in marks) > MOST_VALUES:
        raise ValueError(f"it has more than {MOST_VALUES} values")
    try:
        found = json.loads(data, object_pairs_hook=object_pairs_hook, parse_constant=parse_constant)
    except RecursionError:
        raise _too_deep() from None
    _refuse_deep(found)
    return found


def _refuse_deep(found: Any) -> None:
    """Raise ValueError for a value with too many levels. Level by level, because a recursion could be too deep."""
    level = [found] if isinstance(found, dict | list) else []
    for _ in range(MOST_LEVELS):
        if not level:
            return
        level = [
            inner
            for one in level
            for inner in (one.values() if isinstance(one, dict) else one)
            if isinstance(inner, dict | list)
        ]
    if level:
        raise _too_deep()


def _too_deep() -> ValueError:
    return ValueError(f"it is nested too deeply: more than {MOST_LEVELS} levels")
