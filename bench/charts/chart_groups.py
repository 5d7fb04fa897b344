"""Which runs can be in one control chart: those of one camera, or of one type, on the same bench by the same model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Literal, NamedTuple

from bench.record.coverage import Estimate
from bench.record.run_facts import IndexedRun, RunDetails, RunPlace

Level = Literal["camera", "type"]


class ChartKey(NamedTuple):
    """What all runs of a group have in common; ``serial`` is empty for a camera type."""

    level: Level
    kind: str
    bench: str
    station: str
    camera_type: str
    serial: str
    collimator: str
    target: str
    model: str
    parameters: tuple[str, ...]


@dataclass(frozen=True)
class ChartRun:
    """One run in a chart."""

    run: str
    folder: str
    serial: str
    begun: datetime
    temperature_c: float | None  # Temperature of the camera, degrees Celsius; None if it is not known
    parameters: Mapping[str, Estimate]  # By name


@dataclass
class ChartGroup:
    """The runs of a chart."""

    key: ChartKey
    runs: list[ChartRun] = field(default_factory=list)  # Oldest first

    @property
    def days(self) -> list[float]:
        """Time of each run after the first one, days."""
        return [(run.begun - self.runs[0].begun).total_seconds() / 86400.0 for run in self.runs]


@dataclass
class Grouped:
    """Runs in groups."""

    groups: list[ChartGroup]  # Types first, then cameras, each in the order of their keys
    left_out: list[str]  # One sentence for each reason why runs are in no chart


def group_runs(
    indexed: Iterable[tuple[IndexedRun, RunDetails, RunPlace]], by: Level | None = None
) -> Grouped:
    """Put runs into groups that can be in one chart, by ``camera`` or ``type``; by both where None."""
    by_key: dict[ChartKey, ChartGroup] = {}
    without: dict[str, list[str]] = {}
    for run, details, place in indexed:
        point = _point(run)
        if isinstance(point, str):
            without.setdefault(point, []).append(run.id)
            continue
        key = _key(run, details, place)
        for level in ("camera", "type"):
            group_key = key if level == "camera" else key._replace(level="type", serial="")
            by_key.setdefault(group_key, ChartGroup(group_key)).runs.append(point)
    groups = [by_key[key] for key in sorted(by_key, key=lambda key: (key.level == "camera", key))]
    for group in groups:
        group.runs.sort(key=lambda point: (point.begun, point.folder))
    chosen = [group for group in groups if _wanted(group, by)]
    return Grouped(chosen, [_left_out(why, names) for why, names in without.items()])


def _wanted(group: ChartGroup, by: Level | None) -> bool:
    if group.key.level == "type" and by is None:
        return len({point.serial for point in group.runs}) > 1
    return by in {None, group.key.level}


def _key(run: IndexedRun, details: RunDetails, place: RunPlace) -> ChartKey:
    bench = f"{place.bench}, ledger {place.ledger}" if place.ledger else ""
    return ChartKey(
        "camera",
        run.kind,
        bench,
        run.station,
        details["camera_type"] or "camera type not known",
        run.camera,
        details["collimator_serial"] or "",
        details["target_serial"] or "",
        str(run.model),
        tuple(run.parameters),
    )


def _point(run: IndexedRun) -> ChartRun | str:
    """Return a run as a chart has it, or why it is in none."""
    if not run.parameters:
        return "have no result"
    if any(
        not (math.isfinite(value) and 0 < sigma < math.inf) for value, sigma, *_ in run.parameters.values()
    ):
        return "have a value or an uncertainty that is no usable number"
    try:
        begun = datetime.fromisoformat(run.begun_utc)
    except ValueError:
        return "have no time of their begin"
    if begun.tzinfo is None:
        begun = begun.replace(tzinfo=UTC)
    return ChartRun(run.id, run.folder, run.camera, begun, run.temperature_c, run.parameters)


def _left_out(why: str, names: Sequence[str]) -> str:
    shown = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
    if len(names) == 1:
        return f"1 run is in no chart: it {why.replace('have', 'has', 1).replace('their', 'its')} ({shown})."
    return f"{len(names)} runs are in no chart: they {why} ({shown})."
