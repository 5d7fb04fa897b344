"""Compares the numbers of results that were made again with the stored ones: rounding, another program, or a fault.

Numbers count as equal within a small tolerance, because another computer may round otherwise. A later program finds
stars a little differently: what differs within the limits below is told as not compared, by more as a fault.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bench.evidence.findings import Findings
from bench.record.run_folder import RESULTS
from calib.view import View

Number = int | float
Tolerance = Callable[[str, Number, Number, float], bool]
"""Whether two numbers count as equal: place, both numbers, and the largest number of their list."""

TOLERANCE_SIGMAS = 1e-3
"""Values that differ by less than this fraction of their standard uncertainty count as equal."""
TOLERANCE_SHARE = 1e-6
"""Other numbers that differ by less than this fraction of themselves count as equal."""
_COUNTED = ("iterations",)
"""Numbers of work, not of results: rounding may change them by a few."""
MOST_SHOWN = 12
"""Differences of one file that are shown one by one."""
MOST_SIGMAS = 0.25
"""A value of the calibration may differ by this share of its standard uncertainty."""
MOST_SIGMA_RATIO = 4.0
"""A standard uncertainty may differ by this factor: a later program may know another source of error."""
MOST_SHARE = 0.25
"""A number measured on a pose may differ by this share of itself, or of the largest number in its list."""
MOST_PX = 0.02
"""A star may lie this far away, per axis."""
_MOST_STARS = 0.02
"""Share of the stars of a view that only one of both programs may have."""
_VALUES = ("calibration.camera.", "calibration.collimator.")
_SIGMA = "calibration.sigma."
_FOLLOWS = (
    "calibration.",
    "projection.",
    "halves.",
    "comparison[",
    "gimbal.",
    "mount_faces[",
    "check.",
)
"""Numbers that follow from stars and model; values and standard uncertainties among them have limits of their own."""
_TABLES = ("calibration.budget_rows[", "calibration.not_included[")
"""Tables whose rows another program may order and name otherwise."""
_WORDS = (".notes[", ".says[")
"""Sentences that another program may write otherwise."""
_MEASURED = ("poses[", "pose ", "gates[")
_NUMBER = re.compile(r"\d+(\.\d+)?")
_SMALL_PX = 0.01
"""A measured number in px may differ by this much, whatever its size."""


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


def exactly(_where: str, stored: Number, derived: Number, _scale: float) -> bool:
    """Return whether two numbers are equal to the last bit."""
    return stored == derived


def differences(
    stored: Any, derived: Any, equal: Tolerance = exactly, where: str = ""
) -> Iterator[Difference]:
    """Compare two contents, and yield each difference in the order of the derived one."""
    yield from _differences(stored, json.loads(json.dumps(derived)), equal, where, 0.0)


def _differences(
    stored: Any, derived: Any, equal: Tolerance, where: str, scale: float
) -> Iterator[Difference]:
    if isinstance(derived, dict) and isinstance(stored, Mapping):
        prefix = where and f"{where}."
        for name, value in derived.items():
            if name not in stored:
                yield Difference(f"{prefix}{name}", "missing", None, value)
            else:
                yield from _differences(stored[name], value, equal, f"{prefix}{name}", 0.0)
        for name in stored:
            if name not in derived:
                yield Difference(f"{prefix}{name}", "added", stored[name], None)
    elif isinstance(derived, list) and isinstance(stored, Sequence) and not isinstance(stored, str):
        last = min(len(stored), len(derived))
        if len(stored) < len(derived):
            yield Difference(f"{where}[{last}]", "missing", None, derived[last])
        elif len(stored) > len(derived):
            yield Difference(f"{where}[{last}]", "added", stored[last], None)
        scale = max(scale, _largest([*derived, *stored]))
        for number, (had, due) in enumerate(zip(stored, derived, strict=False)):
            yield from _differences(had, due, equal, f"{where}[{number}]", scale)
    elif not _same(stored, derived, equal, where, scale):
        yield Difference(where, "value", stored, derived)


def _same(stored: Any, derived: Any, equal: Tolerance, where: str, scale: float) -> bool:
    if _is_finite(stored) and _is_finite(derived):
        return equal(where, stored, derived, max(scale, abs(derived)))
    return type(stored) is type(derived) and bool(stored == derived)


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _largest(values: Sequence[Any]) -> float:
    return max((abs(float(value)) for value in values if _is_finite(value)), default=0.0)


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False) if not isinstance(value, float) else f"{value:.12g}"
    return text if len(text) <= 70 else f"{text[:67]}..."


def check_numbers(
    stored: Mapping[str, Any], again: Mapping[str, Any], findings: Findings, other: str, source: str
) -> None:
    """Compare results.json with what follows from ``source``; ``other`` tells how the program differs, or is empty."""
    rounded = list(differences(stored, again))
    if not rounded:
        findings.remarks.append(f"calculated again from the {source}: every number is equal to the last bit")
        return
    sigma = again["calibration"]["sigma"]
    every = list(differences(stored, again, tolerance(sigma)))
    excused = [difference for difference in every if other and is_excused(difference, sigma)]
    seen = [difference for difference in every if difference not in excused]
    if excused:
        places = described(excused, sigma, MOST_SHOWN)
        findings.could_not_compare(
            f"{RESULTS} with the {source}: another program calculated it, with differences in {places}",
            "results",
        )
    add_faults("results", RESULTS, f"the {source} do not give it: ", seen, findings)
    if seen and other:
        findings.remarks.append(
            f"the results were made with {other}, but the differences are too large to come from that alone"
        )
    rounded = [
        difference
        for difference in rounded
        if difference.kind == "value" and not isinstance(difference.stored, str)
    ]
    if not seen and not excused and rounded:
        findings.remarks.append(
            f"calculated again from the {source}: {len(rounded)} numbers differ, by rounding only: {rounded[0]}"
        )


def add_faults(kind: str, name: str, what: str, seen: Sequence[Difference], findings: Findings) -> None:
    """Add the differences of one file to the faults; of many the first ones, and the number of the others."""
    for difference in seen[:MOST_SHOWN]:
        findings.fault(kind, name, f"{what}{difference}")
    if len(seen) > MOST_SHOWN:
        findings.fault(kind, name, f"{len(seen) - MOST_SHOWN} further values differ")


def tolerance(sigma: Mapping[str, float]) -> Tolerance:
    """Return the tolerance for numbers of results.json, with the standard uncertainties of the calibration."""
    parameters = {
        f"calibration.{part}.{name}": TOLERANCE_SIGMAS * value
        for name, value in sigma.items()
        for part in ("camera", "collimator", "sigma")
    }

    def equal(where: str, stored: Number, derived: Number, scale: float) -> bool:
        if where.rpartition(".")[2] in _COUNTED:
            return abs(stored - derived) <= max(2.0, 0.1 * abs(derived))
        if where in parameters:
            return abs(stored - derived) <= parameters[where]
        return abs(stored - derived) <= TOLERANCE_SHARE * scale

    return equal


def is_excused(difference: Difference, sigma: Mapping[str, float]) -> bool:
    """Return whether a difference beyond rounding may come from another program: it is within these limits."""
    words = any(part in difference.where for part in _WORDS)
    if difference.kind != "value" or words or difference.where.startswith(_TABLES):
        return True
    if isinstance(difference.stored, str) and isinstance(difference.derived, str):
        return _same_words(difference.stored, difference.derived)
    return _is_number(difference.stored) and _is_number(difference.derived) and _is_near(difference, sigma)


def _is_near(difference: Difference, sigma: Mapping[str, float]) -> bool:
    """Return whether two numbers are within the limits."""
    name = difference.where.rpartition(".")[2]
    apart = abs(difference.stored - difference.derived)
    if difference.where.startswith(_VALUES) and name in sigma:
        return bool(apart <= MOST_SIGMAS * sigma[name])
    if difference.where.startswith(_SIGMA):
        low, high = sorted((abs(difference.stored), abs(difference.derived)))
        return bool(low > 0 and high <= MOST_SIGMA_RATIO * low)
    if difference.where.startswith(_FOLLOWS):
        return True
    least = _SMALL_PX if name.endswith("_px") or name == "value" else 0.0
    return difference.where.startswith(_MEASURED) and apart <= max(
        least, MOST_SHARE * max(abs(difference.stored), abs(difference.derived))
    )


def described(excused: Sequence[Difference], sigma: Mapping[str, float], most: int) -> str:
    """Return excused differences as text, such as ``calibration.notes[0], 433 numbers (...)``."""
    numbers = [
        difference
        for difference in excused
        if difference.kind == "value" and _is_number(difference.stored) and _is_number(difference.derived)
    ]
    places = list(
        dict.fromkeys(_place(difference.where) for difference in excused if difference not in numbers)
    )
    texts = places[:most]
    if len(places) > most:
        texts.append(f"{len(places) - most} more places")
    if numbers:
        texts.append(f"{len(numbers)} number{'s' if len(numbers) != 1 else ''}{_sizes(numbers, sigma)}")
    return ", ".join(texts)


def _place(where: str) -> str:
    """Return the place of a value; of one in a table the table."""
    return where.partition("[")[0] if where.startswith(_TABLES) else where


def _sizes(numbers: Sequence[Difference], sigma: Mapping[str, float]) -> str:
    """Return how far values and standard uncertainties differ at most, in parentheses; empty if none does."""
    names = {number.where: number.where.rpartition(".")[2] for number in numbers}
    values = [
        number for number in numbers if number.where.startswith(_VALUES) and names[number.where] in sigma
    ]
    sigmas = [number for number in numbers if number.where.startswith(_SIGMA)]
    texts = []
    if values:
        far = max(
            values,
            key=lambda difference: (
                abs(difference.stored - difference.derived) / sigma[names[difference.where]]
            ),
        )
        share = abs(far.stored - far.derived) / sigma[names[far.where]]
        texts.append(f"{names[far.where]} differs most, by {share:.2g} of its standard uncertainty")
    if sigmas:
        far = max(sigmas, key=lambda difference: abs(np.log(difference.stored / difference.derived)))
        texts.append(
            f"the standard uncertainty of {names[far.where]} is {far.stored:.3g}, here {far.derived:.3g}"
        )
    return f" ({'; '.join(texts)})" if texts else ""


def same_stars(stored: View, again: View) -> bool:
    """Return whether two programs found nearly all stars the same, within `MOST_PX`, and none elsewhere."""
    both, at, there = np.intersect1d(stored.ids, again.ids, return_indices=True)
    if len(both) < (1.0 - _MOST_STARS) * max(len(stored), len(again)):
        return False
    return bool((np.abs(stored.points_px[at] - again.points_px[there]) <= MOST_PX).all())


def _same_words(stored: str, derived: str) -> bool:
    """Return whether two sentences have the same words; numbers in them may differ."""
    return " " in stored and _NUMBER.sub("#", stored) == _NUMBER.sub("#", derived)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
