"""How much longer than planned the latest runs of this bench took.

It is for forecasts: neither results.json nor plan.json rests on it, since others make both again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from statistics import median

from bench.base.errors import BenchError
from bench.record.events import Event
from bench.record.ledger import bench_ledger
from bench.record.ledger_marks import LedgerRun
from bench.record.run_folder import PLAN
from bench.record.storage import read_json
from bench.record.stored_run import StoredRun

_MOST_RUNS = 10  # Of a station: the newest, as the computer is today
_MOST_READ = 50  # Of the list of runs: each is a folder to be read
_NOT_THE_PACE = frozenset({Event.RUN_RESUMED, Event.DEVIATION, Event.ASKED})
"""Events of a run whose duration says nothing about the computer."""


@dataclass(frozen=True)
class Pace:
    """How many times as long as planned the last runs took, and how many runs these were."""

    factor: float = 1.0
    runs: int = 0
    station: str = ""  # Empty for all stations together

    def text(self) -> str:
        """Return what the last runs took."""
        place = f"On station {self.station}" if self.station else "On this computer"
        runs = "the last run" if self.runs == 1 else f"the last {self.runs} runs"
        return f"{place}, {runs} took {self.factor:.1f} times as long as planned (median)."


def paces(runs: Sequence[LedgerRun]) -> dict[str, Pace]:
    """Return each station's pace, and under an empty name that of all, from the newest runs without a stop."""
    ratios_of_station: dict[str, list[float]] = {}
    for run in reversed(runs[-_MOST_READ:]):
        if run.how == "finished" and (ratio := _ratio(Path(run.folder))) is not None:
            for station in (ratio[0], ""):
                ratios_of_station.setdefault(station, []).append(ratio[1])
    return {
        station: Pace(max(1.0, median(ratios[:_MOST_RUNS])), len(ratios[:_MOST_RUNS]), station)
        for station, ratios in ratios_of_station.items()
    }


def _ratio(folder: Path) -> tuple[str, float] | None:
    """Return the station of a run, and its duration over the planned one; None if it was stopped or cannot be read."""
    try:
        entries = StoredRun(folder).entries
        planned_s = float(read_json(folder / PLAN)["duration_s"])
        begun, ended = (datetime.fromisoformat(entries[place].utc) for place in (0, -1))
        if planned_s <= 0.0 or {entry.event for entry in entries} & _NOT_THE_PACE:
            return None
        return str(entries[0].data["station"]), (ended - begun).total_seconds() / planned_s
    except (BenchError, LookupError, TypeError, ValueError):
        return None


def pace_of(paces: Mapping[str, Pace], station: str) -> Pace:
    """Return the pace of a station; that of all stations together if it has none of its own."""
    return paces.get(station) or paces.get("", Pace())


def runs_of_bench() -> list[LedgerRun]:
    """Return the runs of this bench; none if its ledger is broken, which other commands tell."""
    with suppress(BenchError):
        return bench_ledger().runs()
    return []


def pace_on(station: str) -> Pace:
    """Return the pace of this bench's latest runs, for one run on a station."""
    return pace_of(paces(runs_of_bench()[-_MOST_RUNS:]), station)
