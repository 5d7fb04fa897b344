"""The check standard of a station: one camera that is measured again and again, so that its chart watches the bench.

The chart and its rules are those of `chart_findings` (NIST/SEMATECH e-Handbook, 2.2.2 and 2.3.5, has the method).
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from bench.history.chart_findings import find_charts, group_runs
from bench.history.merged_runs import RunPlace
from bench.records.ledger import bench_ledger
from bench.records.run_folder import JOURNAL
from bench.records.run_index import RunIndex
from bench.stations.station import Station


def standard_problem(station: Station, home: Path, now: datetime) -> str:
    """Return why the bench must be looked at: the standard's newest run is out of control or too old; or empty."""
    standard = station.check_standard
    if standard is None:
        return ""
    index, name = RunIndex(home), f"The check standard, camera {standard.serial}"
    folders = [Path(run.folder) for run in bench_ledger().runs() if (Path(run.folder) / JOURNAL).is_file()]
    found, _ = index.runs(folders, camera=standard.serial, how="finished")
    own = [
        run
        for run in found
        if run.parameters and (run.station, run.simulated) == (station.name, station.is_simulated)
    ]
    if not own:
        return f"{name}, has no result on this station." if standard.every_days is not None else ""
    grouped = group_runs(
        ((run, details, RunPlace()) for run, details in zip(own, index.details(own), strict=True)), "camera"
    )
    newest = own[-1]
    for group in find_charts(grouped.groups, baseline=standard.baseline)["groups"]:
        if group["runs"][-1]["run"] == newest.id and (names := _violated(group)):
            return f"{name}, is out of control in its newest run {newest.id}: {', '.join(names)}."
    age = now - datetime.fromisoformat(newest.begun_utc)
    if standard.every_days is not None and age > timedelta(days=standard.every_days):
        days = age.total_seconds() / 86_400
        return f"{name}, was last measured {days:.1f} days ago; it is due every {standard.every_days:g} days."
    return ""


def _violated(group: Mapping[str, Any]) -> list[str]:
    """Return the parameters of a group of charts that are out of control, and beyond a limit in the newest run."""
    newest = len(group["runs"]) - 1
    return [
        chart["name"]
        for chart in group["parameters"]
        if chart["state"] == "out of control" and newest in (*chart["beyond"], *chart["ewma"]["beyond"])
    ]
