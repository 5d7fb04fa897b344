"""Compares what was made again with what is stored: within the uncertainty it is confirmed, whatever version made it.

What differs by more than `bench.again.limits` is a fault if the same engine made both. Of another engine it is not
confirmed.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bench.again.limits import EXACT, MOST_SHARE, Rules
from bench.evidence.findings import Findings
from bench.solve.results_content import other_software
from calib.arrays import Array
from calib.calibration import ENGINES

_WORK = "iterations"  # A number of work, not of a result: rounding may change it
_COVARIANCES = ("matrix", "covariance_rad2", "sight_covariance_rad2")
MOST_SHOWN = 12
"""Differences of one file that are shown one by one: what changed is seen from the first ones."""


@dataclass(frozen=True)
class Difference:
    """One difference."""

    where: str  # Place of the value: ``poses[0].attempts[1].sha256``
    kind: Literal["value", "missing", "added"]  # ``missing`` in the stored content, ``added`` to it
    stored: Any  # None where the stored content has no such part
    derived: Any  # None where the derived content has no such part

    def __str__(self) -> str:
        if self.kind == "added":
            return f"{self.where} is {_shown(self.stored)}, which follows from nothing"
        if self.kind == "missing":
            return f"{self.where} is missing; it must be {_shown(self.derived)}"
        return f"{self.where} is {_shown(self.stored)}; made again, it is {_shown(self.derived)}"

    @property
    def is_of_form(self) -> bool:
        """Whether it is a part that only one of both has, or another sentence: a version may change these alone."""
        sentences = all(isinstance(text, str) and " " in text for text in (self.stored, self.derived))
        return self.kind != "value" or sentences


@dataclass(frozen=True)
class Maker:
    """Who made what is stored: software by name, and the engine of the calibration."""

    software: Mapping[str, Any]
    engine: Mapping[str, Any] | None = None  # ``name`` and ``version``; None if none is stated

    @property
    def is_same_program(self) -> bool:
        """Whether this program made it, by the hash of its sources."""
        return not other_software(self.software, ["program"])

    @property
    def is_same_engine(self) -> bool:
        """Whether an engine of the same revision made it."""
        stated = self.engine or {}
        return self.is_same_program or ENGINES.get(str(stated.get("name"))) == stated.get("version", 0)

    def differs_from_here(self, difference: Difference) -> bool:
        """Return whether a difference may come from another version: of its form from any, else of another engine."""
        return not (self.is_same_program if difference.is_of_form else self.is_same_engine)

    @property
    def how_to_install(self) -> str:
        """Return which version made it, and how to get it: the end of a message, without a full stop."""
        version, program = (self.software.get(name, "unknown") for name in ("starbench", "program"))
        return (
            f"Starbench {version} (program {program}) made it: install that version"
            f" (pip install starbench=={version}) and verify again with it"
        )


def judge(kind: str, name: str, seen: Iterable[Difference], maker: Maker, findings: Findings) -> None:
    """Add the differences of one file: faults, or what this version does not confirm; of many the first ones."""
    faults: list[Difference] = []
    others: list[Difference] = []
    for difference in seen:
        (others if maker.differs_from_here(difference) else faults).append(difference)
    for difference in faults[:MOST_SHOWN]:
        findings.fault(kind, name, str(difference))
    if len(faults) > MOST_SHOWN:
        findings.fault(kind, name, f"{len(faults) - MOST_SHOWN} further values differ")
    if others:
        shown = "; ".join(map(str, others[:MOST_SHOWN]))
        more = f"; and {len(others) - MOST_SHOWN} more" if len(others) > MOST_SHOWN else ""
        findings.not_confirmed.append(f"{name}: {shown}{more}. {maker.how_to_install}")


def differences(stored: Any, derived: Any, rules: Rules = EXACT, where: str = "") -> Iterator[Difference]:
    """Compare two contents, and yield each difference in the order of the derived one.

    Without a limit of its own, a number that is calculated may differ by `MOST_SHARE`, others by that of ``rules``.
    """
    yield from _differences(stored, json.loads(json.dumps(derived)), rules, where, None)


def _differences(
    stored: Any, derived: Any, rules: Rules, where: str, limit: Any, scale: float = 0.0
) -> Iterator[Difference]:
    """``limit`` is that of the place, None for the usual one; ``scale`` the largest number of the list around it."""
    name = where.rpartition(".")[2]
    if name in _COVARIANCES:
        yield from _of_covariance(stored, derived, where)
    elif isinstance(derived, dict) and isinstance(stored, Mapping):
        prefix = where and f"{where}."
        for key, value in derived.items():
            if key not in stored:
                yield Difference(f"{prefix}{key}", "missing", None, value)
            else:
                own = rules.inside(where, key, derived, limit)
                yield from _differences(stored[key], value, rules, f"{prefix}{key}", own)
        for key in stored:
            if key not in derived:
                yield Difference(f"{prefix}{key}", "added", stored[key], None)
    elif isinstance(derived, list) and isinstance(stored, Sequence) and not isinstance(stored, str):
        last = min(len(stored), len(derived))
        if len(stored) < len(derived):
            yield Difference(f"{where}[{last}]", "missing", None, derived[last])
        elif len(stored) > len(derived):
            yield Difference(f"{where}[{last}]", "added", stored[last], None)
        scale = max(scale, _largest([*derived, *stored]))
        for number, (had, due) in enumerate(zip(stored, derived, strict=False)):
            own = limit[number] if isinstance(limit, list) else limit
            yield from _differences(had, due, rules, f"{where}[{number}]", own, scale)
    elif name != _WORK and not rules.same(stored, derived, where, limit, scale):
        yield Difference(where, "value", stored, derived)


def _of_covariance(stored: Any, derived: Any, where: str) -> Iterator[Difference]:
    try:
        had, due = np.array(stored, np.float64), np.array(derived, np.float64)
        yield from arrays_differ(where, had, due, limit_of_covariances(due))
    except (TypeError, ValueError):
        yield Difference(where, "value", stored, derived)


def limit_of_covariances(derived: Array) -> Array:
    """Return how far each element of (..., N, N) covariances may differ while each sigma stays within `MOST_SHARE`."""
    sigma = np.sqrt(np.maximum(np.diagonal(derived, axis1=-2, axis2=-1), 0.0))
    return np.asarray(2 * MOST_SHARE * sigma[..., :, None] * sigma[..., None, :])


def arrays_differ(where: str, stored: Array, derived: Array, limit: Array | float) -> Iterator[Difference]:
    """Yield the first element of two arrays that differs by more than its limit, or their shapes."""
    if stored.shape != derived.shape:
        yield Difference(f"{where}.shape", "value", list(stored.shape), list(derived.shape))
    elif len(far := np.argwhere(~(np.abs(stored - derived) <= limit))):
        at = tuple(far[0])
        place = "".join(f"[{index}]" for index in at)
        yield Difference(f"{where}{place}", "value", stored[at].item(), derived[at].item())


def _largest(values: Sequence[Any]) -> float:
    return max((abs(value) for value in values if isinstance(value, float)), default=0.0)


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False) if not isinstance(value, float) else f"{value:.12g}"
    return text if len(text) <= 70 else f"{text[:67]}..."
