"""Compares what two sides left, and sorts the differences into those on purpose and those that nobody announced."""

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import yaml

from comparison.reading import Value, equal

_SHOWN_LINES, _SHOWN = 12, 160


@dataclass(frozen=True)
class Difference:
    """One place that the two sides fill differently; `relative` where both hold numbers of one shape."""

    scenario: str
    place: str
    words: str
    relative: float | None = None

    def __str__(self) -> str:
        amount = "" if self.relative is None else f" (relative {self.relative:.2g})"
        return f"{self.scenario}: {self.place}: {self.words}{amount}"


@dataclass
class Expected:
    """An entry of the list of what differs on purpose, and how many differences it has explained."""

    scenario: str
    place: str
    reason: str
    says: str = ""
    relative: float | None = None
    matched: int = field(default=0, compare=False)

    def explains(self, difference: Difference) -> bool:
        fits = fnmatchcase(difference.scenario, self.scenario) and fnmatchcase(difference.place, self.place)
        if not fits or (self.says and not re.search(self.says, difference.words)):
            return False
        return self.relative is None or (
            difference.relative is not None and difference.relative <= self.relative
        )


def read_expected(path: Path) -> list[Expected]:
    """The list, in the order of the file; an entry that lacks scenario, place or reason is an error."""
    listed = yaml.safe_load(path.read_text(encoding="utf-8")) or []
    return [Expected(**entry) for entry in listed]


def compare(scenario: str, old: Mapping[str, Value], new: Mapping[str, Value]) -> list[Difference]:
    """Every place that differs, in the order of the places."""
    differences = []
    for place in sorted({*old, *new}):
        if place not in new:
            differences.append(Difference(scenario, place, f"only old: {_short(old[place])}"))
        elif place not in old:
            differences.append(Difference(scenario, place, f"only new: {_short(new[place])}"))
        elif not equal(old[place], new[place]):
            words = _told(old[place], new[place])
            differences.append(Difference(scenario, place, words, relative(old[place], new[place])))
    return differences


def sort_out(
    differences: Iterable[Difference], expected: Iterable[Expected]
) -> list[tuple[Difference, str | None]]:
    """Each difference with the reason of the first entry that explains it, or None."""
    entries = list(expected)
    sorted_out = []
    for difference in differences:
        entry = next((entry for entry in entries if entry.explains(difference)), None)
        if entry is not None:
            entry.matched += 1
        sorted_out.append((difference, entry.reason if entry is not None else None))
    return sorted_out


def relative(old: Value, new: Value) -> float | None:
    """Largest difference of the numbers, over the largest of them; None where they cannot be compared."""
    if not (_is_number(old) and _is_number(new)):
        return None
    before, other = np.asarray(old, float), np.asarray(new, float)
    if before.shape != other.shape or not np.array_equal(np.isnan(before), np.isnan(other)):
        return None
    size = max(float(np.nanmax(abs(before), initial=0.0)), float(np.nanmax(abs(other), initial=0.0)))
    return float(np.nanmax(abs(before - other), initial=0.0)) / size if size else 0.0


def _is_number(value: Value) -> bool:
    if isinstance(value, np.ndarray | np.number):
        return bool(np.issubdtype(value.dtype, np.number))
    return isinstance(value, int | float) and not isinstance(value, bool)


def _told(old: Value, new: Value) -> str:
    if isinstance(old, list) and isinstance(new, list):
        lines = list(difflib.unified_diff(list(map(str, old)), list(map(str, new)), lineterm="", n=0))[2:]
        shown = [line[:_SHOWN] for line in lines if not line.startswith("@@")]
        more = [f"... and {len(shown) - _SHOWN_LINES} more lines"] if len(shown) > _SHOWN_LINES else []
        return "\n    ".join(["lines differ", *shown[:_SHOWN_LINES], *more])
    return f"{_short(old)} -> {_short(new)}"


def _short(value: Value) -> str:
    text = f"{value.dtype} array of {value.shape}" if isinstance(value, np.ndarray) else repr(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
