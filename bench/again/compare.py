"""Compares what was made again with what is stored: within the uncertainty it is confirmed, whatever version made it.

A value may differ by a tenth of its U, every other number by a twentieth; counts, names and verdicts not at all. What
differs by more is a fault if the same engine made both. Of another engine it is not confirmed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from bench.evidence.findings import Findings
from bench.record.coverage import coverage_factor
from bench.solve.results_content import other_software
from calib.arrays import Array
from calib.calibration import ENGINES

MOST_OF_U = 0.1
"""A value may differ by this part of its expanded uncertainty: ten times less than what anybody may rely on."""
MOST_SHARE = 0.05
"""An uncertainty, and any other number, may differ by this share of itself: U is stated with two digits."""
_ROUNDING = 1e-6
"""Share of the largest number of a list by which its small ones may differ: what cancels leaves the rounding."""
_CANCELLED = 1e-9
"""Numbers of this size are 0."""
_WORK = "iterations"
"""A number of work, not of a result: rounding may change it."""
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


def limits_of_values(calibration: Mapping[str, Any]) -> dict[str, float]:
    """Return how far each value may differ from that of a calibration, as results.json has it, by its place."""
    return {
        f"calibration.{part}.{name}": MOST_OF_U * coverage_factor(calibration, name) * sigma  # type: ignore[arg-type]
        for name, sigma in calibration["sigma"].items()
        for part in ("camera", "collimator")
    }


def differences(
    stored: Any, derived: Any, limits: Mapping[str, float] = MappingProxyType({}), where: str = ""
) -> Iterator[Difference]:
    """Compare two contents, and yield each difference in the order of the derived one; ``limits`` by place."""
    yield from _differences(stored, json.loads(json.dumps(derived)), limits, where, 0.0)


def _differences(
    stored: Any, derived: Any, limits: Mapping[str, float], where: str, scale: float
) -> Iterator[Difference]:
    """``scale`` is the largest number of the list in which these stand."""
    name = where.rpartition(".")[2]
    if name in _COVARIANCES:
        yield from _of_covariance(stored, derived, where)
    elif isinstance(derived, dict) and isinstance(stored, Mapping):
        prefix = where and f"{where}."
        for key, value in derived.items():
            if key not in stored:
                yield Difference(f"{prefix}{key}", "missing", None, value)
            else:
                yield from _differences(stored[key], value, limits, f"{prefix}{key}", 0.0)
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
            yield from _differences(had, due, limits, f"{where}[{number}]", scale)
    elif name != _WORK and not _same(stored, derived, limits, where, scale):
        yield Difference(where, "value", stored, derived)


def _same(stored: Any, derived: Any, limits: Mapping[str, float], where: str, scale: float) -> bool:
    if not (_is_finite(stored) and _is_finite(derived)) or (
        isinstance(stored, int) and isinstance(derived, int)
    ):
        return type(stored) is type(derived) and bool(stored == derived)
    share = MOST_SHARE * max(abs(stored), abs(derived))
    limit = limits.get(where, max(share, _ROUNDING * scale, _CANCELLED))
    return bool(abs(stored - derived) <= limit)


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


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _largest(values: Sequence[Any]) -> float:
    return max((abs(float(value)) for value in values if _is_finite(value)), default=0.0)


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False) if not isinstance(value, float) else f"{value:.12g}"
    return text if len(text) <= 70 else f"{text[:67]}..."
