"""The check standard of a station: one camera that is measured again and again, so that its chart watches the bench."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

from bench.charts.chart_findings import find_charts
from bench.charts.chart_groups import group_runs
from bench.record.ledger import bench_ledger
from bench.record.run_facts import RunPlace
from bench.record.run_folder import JOURNAL
from bench.record.run_index import RunIndex
from bench.record.summaries import ChartGroupData, has_limits
from bench.stations.station import Station


def standard_problem(station: Station, home: Path, now: datetime) -> str:
    """Return why the check standard says that the bench must be looked at; empty if it does not."""
    standard = station.check_standard
    if standard is None:
        return ""
    index, name = RunIndex(home), f"The check standard, camera {standard.serial}"
    folders = [Path(run.folder) for run in bench_ledger().runs() if (Path(run.folder) / JOURNAL).is_file()]
    runs, _ = index.runs(folders, camera=standard.serial, how="finished")
    own = [
        run
        for run in runs
        if run.parameters and (run.station, run.simulated) == (station.name, station.is_simulated)
    ]
    if not own:
        return f"{name}, has no result on this station." if standard.every_days is not None else ""
    grouped = group_runs(((*runs, RunPlace()) for runs in index.details(own)), "camera")
    newest = own[-1]
    for group in find_charts(grouped.groups, baseline=standard.baseline)["groups"]:
        if group["runs"][-1]["run"] == newest.id and (names := _violated(group)):
            return f"{name}, is out of control in its newest run {newest.id}: {', '.join(names)}."
    age = now - datetime.fromisoformat(newest.begun_utc)
    if standard.every_days is not None and age > timedelta(days=standard.every_days):
        days = age.total_seconds() / 86_400
        return f"{name}, was last measured {days:.1f} days ago; it is due every {standard.every_days:g} days."
    return ""


def _violated(group: ChartGroupData) -> list[str]:
    """Return the parameters of a group of charts that are out of control, and beyond a limit in the newest run."""
    newest = len(group["runs"]) - 1
    return [
        chart["name"]
        for chart in group["parameters"]
        if has_limits(chart)
        and chart["state"] == "out of control"
        and newest in (*chart["beyond"], *chart["ewma"]["beyond"])
    ]
