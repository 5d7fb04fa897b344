"""How long the last runs of a station took on this computer, against their plans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from statistics import median

from bench.base.errors import BenchError
from bench.records.events import Event
from bench.records.journal import read_journal
from bench.records.ledger_runs import LedgerRun
from bench.records.reading import read_json
from bench.records.run_folder import JOURNAL, PLAN

_MOST_RUNS = 10
_MOST_READ = 50
TOLD_FROM = 2.0
"""A forecast that is longer than the plan by this factor says why."""
_NOT_THE_PACE = frozenset({Event.RUN_RESUMED, Event.DEVIATION, Event.ASKED})
"""Events of a run whose duration says nothing about the computer."""


@dataclass(frozen=True)
class Pace:
    """How many times as long as planned the last runs took, and how many runs these were."""

    factor: float = 1.0
    runs: int = 0
    station: str = ""  # Empty for all stations together

    def text(self) -> str:
        """Return why a forecast is longer than the plan; empty below `TOLD_FROM`."""
        if self.factor < TOLD_FROM:
            return ""
        place = f"On station {self.station}" if self.station else "On this computer"
        return (
            f"{place}, the last {self.runs} runs took {self.factor:.1f} times as long as planned "
            "(median). The times below include this: the computer is slower than the plan assumes, or other programs "
            "keep it busy."
        )


def paces(runs: Sequence[LedgerRun]) -> dict[str, Pace]:
    """Return the pace of each station, from the newest runs of a ledger that finished without a stop.

    Returns: By the name of the station, and of all stations together under an empty name; a station without such a run
      is missing.
    """
    found: dict[str, list[float]] = {}
    for run in reversed(runs[-_MOST_READ:]):
        if run.how == "finished" and (one := _ratio(Path(run.folder))) is not None:
            for station in (one[0], ""):
                found.setdefault(station, []).append(one[1])
    return {
        station: Pace(max(1.0, median(ratios[:_MOST_RUNS])), len(ratios[:_MOST_RUNS]), station)
        for station, ratios in found.items()
    }


def _ratio(folder: Path) -> tuple[str, float] | None:
    """Return the station of a run, and its duration over the planned one; None if it was stopped or cannot be read."""
    try:
        entries = read_journal(folder / JOURNAL)[0]
        planned_s = float(read_json(folder / PLAN)["duration_s"])
        begun, ended = (datetime.fromisoformat(entries[place].utc) for place in (0, -1))
        if planned_s <= 0.0 or {entry.event for entry in entries} & _NOT_THE_PACE:
            return None
        return str(entries[0].data["station"]), (ended - begun).total_seconds() / planned_s
    except (BenchError, LookupError, TypeError, ValueError):
        return None
