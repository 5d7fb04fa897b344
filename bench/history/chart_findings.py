"""Control charts and drift of every parameter of groups of runs, with a verdict in plain words.

A station's check standard is one camera that is measured again and again, so that its chart watches the bench
(NIST/SEMATECH e-Handbook, 2.2.2 and 2.3.5).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal, NamedTuple

from scipy import stats

from bench.history.merged_runs import RunPlace
from bench.history.statistics import LEVEL, SHEWHART_CHANCE, Drift, Ewma, ewma, find_drift, holm, individuals
from bench.history.table import parameter_unit
from bench.records.ledger import bench_ledger
from bench.records.run_facts import Estimate
from bench.records.run_folder import JOURNAL
from bench.records.run_index import IndexedRun, RunIndex
from bench.report.text import meaning_of, number, with_uncertainty
from bench.stations.station import Station
from bench.terminal.encoding import counted

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


@dataclass
class Grouped:
    """Runs in groups."""

    groups: list[ChartGroup]  # Types first, then cameras, each in the order of their keys
    left_out: list[str]  # One sentence for each reason why runs are in no chart


def group_runs(
    found: Iterable[tuple[IndexedRun, Mapping[str, Any], RunPlace]], by: Level | None = None
) -> Grouped:
    """Put runs into groups that can be in one chart, by ``camera`` or ``type``; by both where None."""
    by_key: dict[ChartKey, ChartGroup] = {}
    without: dict[str, list[str]] = {}
    for run, details, place in found:
        point = _point(run)
        if isinstance(point, str):
            without.setdefault(point, []).append(run.id)
            continue
        key = _key(run, details, place)
        for level in ("camera", "type"):
            one = key if level == "camera" else key._replace(level="type", serial="")
            by_key.setdefault(one, ChartGroup(one)).runs.append(point)
    groups = [by_key[key] for key in sorted(by_key, key=lambda key: (key.level == "camera", key))]
    for group in groups:
        group.runs.sort(key=lambda point: (point.begun, point.folder))
    chosen = [group for group in groups if _wanted(group, by)]
    return Grouped(chosen, [_left_out(why, names) for why, names in without.items()])


def _wanted(group: ChartGroup, by: Level | None) -> bool:
    if group.key.level == "type" and by is None:
        return len({point.serial for point in group.runs}) > 1
    return by in {None, group.key.level}


def _key(run: IndexedRun, details: Mapping[str, Any], place: RunPlace) -> ChartKey:
    bench = f"{place.bench}, ledger {place.ledger}" if place.ledger else ""
    return ChartKey(
        "camera",
        run.kind,
        bench,
        run.station,
        str(details.get("camera_type") or "camera type not known"),
        run.camera,
        str(details.get("collimator_serial") or ""),
        str(details.get("target_serial") or ""),
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


# The verdict in plain words.

_DAYS_A_YEAR = 365.25
_NAMED = 3
_SCATTER_SIGMAS = 3.5

Finding = Mapping[str, Any]


def slope_text(slope: Finding, unit: str, per: str) -> str:
    """Return a slope, ``value`` and ``expanded``, in a unit (or empty) per ``day``, ``hour``, ``year`` or ``°C``.

    >>> slope_text({"value": 0.5, "expanded": 0.1}, "px", "day")
    '+0.50 ± 0.10 px per day'
    """
    factor = {"hour": 1.0 / 24.0, "year": _DAYS_A_YEAR}.get(per, 1.0)
    value, expanded = with_uncertainty(slope["value"] * factor, slope["expanded"] * factor)
    sign = "+" if slope["value"] > 0 else ""
    return f"{sign}{value} ± {expanded}{' ' if unit else ''}{unit} per {per}"


def time_unit(span_days: float) -> str:
    """Return the unit in which to state a slope of so many days: ``hour``, ``day`` or ``year``."""
    return "hour" if span_days < 2.0 else "day" if span_days < 120.0 else "year"


def name_slopes(chart: dict[str, Any], group: Finding) -> None:
    """Add ``text`` to the slopes of a chart: the value with its uncertainty, in a unit of time that suits the runs."""
    per = time_unit(_span_days(group))
    for name, unit in (("per_day", per), ("per_c", "°C")):
        if chart["drift"][name] is not None:
            slope = chart["drift"][name]
            slope |= {"text": slope_text(slope, chart["unit"], unit), "per": unit}


def parameter_verdict(chart: Finding, group: Finding) -> str:
    """Say what a chart of a group shows."""
    runs = len(chart["values"])
    if chart["state"] == "too few":
        return f"{counted(runs, 'run')}: too few for limits (at least 5 are needed)."
    sentences = [_control(chart, group, runs), *_drifts(chart)]
    if group["level"] == "camera" and (ratio := excess_scatter(chart, runs)):
        sentences.append(
            f"The runs scatter {number(ratio, 2)} times as much as their stated uncertainties predict."
        )
    if chart["provisional"]:
        sentences.append(f"The limits come from {chart['baseline']} runs: provisional until there are 20.")
    return " ".join(sentences)


def excess_scatter(chart: Finding, runs: int) -> float | None:
    """Return a chart's Birge ratio if 3.5 of its standard deviations above 1; else None.

    That is about 1 / sqrt(2 n) if the uncertainties are right (Birge, Phys. Rev. 40 (1932) 207).
    """
    ratio = chart["drift"]["scatter"]
    least = 1.0 + _SCATTER_SIGMAS / math.sqrt(2.0 * max(runs - 2, 1))
    return float(ratio) if ratio is not None and ratio > least else None


def _control(chart: Finding, group: Finding, runs: int) -> str:
    beyond, averages = chart["beyond"], chart["ewma"]["beyond"]
    low, high = (
        with_uncertainty(chart["lower"], chart["sigma"])[0],
        with_uncertainty(chart["upper"], chart["sigma"])[0],
    )
    within = f"{low} to {high}{' ' if chart['unit'] else ''}{chart['unit']}"
    if chart["state"] == "in control":
        return f"In control: all {runs} runs lie within {within}."
    parts = []
    if beyond:
        expected = number(SHEWHART_CHANCE * runs, 2)
        parts.append(
            f"{counted(len(beyond), 'run')} of {runs} {'lies' if len(beyond) == 1 else 'lie'} outside {within}"
            f" ({_named(beyond, group)}); about {expected} by chance"
        )
    if averages:
        place = averages[0]
        parts.append(
            f"the moving average (EWMA) left its limits at {_named([place], group)}: the mean may have shifted"
        )
    lead = "Out of control" if chart["state"] == "out of control" else "Check, it may be chance"
    return f"{lead}: {'; '.join(parts)}."  # fmt: skip


def _drifts(chart: Finding) -> list[str]:
    drift = chart["drift"]
    found = []
    for name, what in (("per_day", "time"), ("per_c", "temperature")):
        slope = drift[name]
        if slope is not None and slope["seen"]:
            chance = (
                f"p = {number(slope['p_adjusted'], 1)}" if slope["p_adjusted"] >= 1e-6 else "p < 0.000001"
            )
            found.append(f"It drifts with {what}: {slope['text']} ({chance}).")
    if found and not drift["separable"]:
        found.append(
            "Time and temperature changed together, so the runs do not show which of them is the cause."
        )
    tested = [
        what for name, what in (("per_day", "time"), ("per_c", "temperature")) if drift[name] is not None
    ]
    return found or ([f"No significant drift with {' or '.join(tested)}."] if tested else [])


def _span_days(group: Finding) -> float:
    first, last = (datetime.fromisoformat(group["runs"][place]["begun_utc"]) for place in (0, -1))
    return (last - first).total_seconds() / 86400.0


def _named(places: Sequence[int], group: Finding) -> str:
    names = [group["runs"][place]["run"] for place in places[:_NAMED]]
    return ", ".join(names) + (", ..." if len(places) > _NAMED else "")


def group_title(group: Finding) -> str:
    """Return the heading of a group."""
    camera = f"Camera {group['serial'] or 'without a serial number'}, {group['camera_type']}"
    if group["level"] == "type":
        camera = f"Camera type {group['camera_type']}, {counted(group['cameras'], 'camera')}"
    kind = "" if group["kind"] == "measured" else f"{group['kind'].upper()}: "
    return f"{kind}{camera}: {counted(len(group['runs']), 'run')}"


def group_place(group: Finding) -> str:
    """Return where and how the runs of a group were made."""
    parts = [f"Station {group['station'] or 'without a name'}"]
    parts += [group["bench"]] if group["bench"] else []
    parts += [f"collimator {group['collimator']}"] if group["collimator"] else []
    parts += [f"target {group['target']}"] if group["target"] else []
    return ", ".join([*parts, f"model {group['model']}"])


def group_verdict(group: Finding) -> str:
    """Say in one or two sentences what the charts of a group show."""
    charts = group["parameters"]
    if group["state"] == "too few":
        return f"{counted(len(group['runs']), 'run')}: too few for a verdict (at least 5 are needed)."
    wrong = [c["name"] for c in charts if c["state"] == "out of control"]
    check = [c["name"] for c in charts if c["state"] == "check"]
    drifting = [
        c["name"] for c in charts if any((c["drift"][s] or {}).get("seen") for s in ("per_day", "per_c"))
    ]
    sentences = []
    if wrong:
        sentences.append(f"Out of control: {', '.join(wrong)}.")
    if check:
        sentences.append(f"Beyond a limit, perhaps by chance: {', '.join(check)}.")
    if drifting:
        sentences.append(f"Significant drift: {', '.join(drifting)}.")
    if not wrong and not check:
        sentences.insert(0, "In control.")
    if not drifting:
        sentences.append("No significant drift.")
    return " ".join(sentences)


SCHEMA = "starbench/charts/1"
LEAST_RUNS = 5
"""Fewest runs for control limits."""
ENOUGH_RUNS = 20
"""With fewer runs, limits are provisional (Montgomery, section 6.2, advises 20 to 25)."""
_SLOPES = ("per_day", "per_c")

Json = dict[str, Any]


def find_charts(
    groups: Iterable[ChartGroup], *, parameter: str | None = None, baseline: int | None = None
) -> Json:
    """Compute all charts (None: of all parameters), and judge them together: ``schema level groups``.

    Limits come from each group's first ``baseline`` runs, all where None.
    """
    found = [_group(group, parameter, baseline) for group in groups]
    charts = [chart for group in found for chart in group["parameters"]]
    _judge_drift(charts)
    judged = sum(chart["lower"] is not None for chart in charts)
    for group in found:
        group |= {"title": group_title(group), "place": group_place(group)}
        for chart in group["parameters"]:
            name_slopes(chart, group)
            chart["state"] = _state(chart, judged)
            chart["verdict"] = parameter_verdict(chart, group)
        group["state"] = _worst([chart["state"] for chart in group["parameters"]])
        group["verdict"] = group_verdict(group)
    return {"schema": SCHEMA, "level": LEVEL, "groups": found}


def _group(group: ChartGroup, parameter: str | None, baseline: int | None) -> Json:
    names = [name for name in group.key.parameters if parameter in {None, name}]
    facts = {name: value for name, value in group.key._asdict().items() if name != "parameters"}
    return {
        **facts,
        "cameras": len({run.serial for run in group.runs}),
        "runs": [
            {"run": r.run, "serial": r.serial, "begun_utc": r.begun.isoformat(), "temperature_c": r.temperature_c}
            for r in group.runs
        ],
        "parameters": [_parameter(name, group.runs, baseline) for name in names],
    }  # fmt: skip


def _parameter(name: str, runs: Sequence[ChartRun], baseline: int | None) -> Json:
    found = [run.parameters[name] for run in runs]
    values, sigmas = [one.value for one in found], [one.sigma for one in found]
    chart: Json = {
        "name": name,
        "unit": parameter_unit(name),
        "meaning": meaning_of(name),
        "values": values,
        "sigmas": sigmas,
        "expanded": [one.expanded for one in found],
        "lower": None,
        "upper": None,
        "ewma": None,
        "provisional": min(baseline or len(runs), len(runs)) < ENOUGH_RUNS,
    }
    if len(runs) < LEAST_RUNS:
        return chart | {"drift": _drift_facts(None)}
    limits = individuals(values, baseline)
    days = [(run.begun - runs[0].begun).total_seconds() / 86400.0 for run in runs]
    drift = find_drift(days, [run.temperature_c for run in runs], values, sigmas)
    averages = ewma(values, limits.centre, limits.sigma)
    return {
        **chart,
        **vars(limits),
        "ranges": limits.ranges.tolist(),
        "ewma": _ewma_facts(averages),
        "drift": _drift_facts(drift),
    }


def _ewma_facts(averages: Ewma) -> Json:
    return {
        "lambda": averages.weight,
        "limit": averages.limit,
        "values": averages.averages.tolist(),
        "lower": averages.lower.tolist(),
        "upper": averages.upper.tolist(),
        "beyond": list(averages.beyond),
    }


def _drift_facts(drift: Drift | None) -> Json:
    found = drift or Drift(None, None, joint=False, separable=True, between_runs=None, scatter=None)
    slopes = {name: None if (one := getattr(found, name)) is None else one.to_dict() for name in _SLOPES}
    return {**vars(found), **slopes}


def _judge_drift(charts: Sequence[Json]) -> None:
    """Adjust the chances of all slopes of a page for their number; ``seen`` says whether a slope is significant."""
    slopes = [
        chart["drift"][name] for chart in charts for name in _SLOPES if chart["drift"][name] is not None
    ]
    for slope, adjusted in zip(slopes, holm([slope["p"] for slope in slopes]), strict=True):
        slope["p_adjusted"], slope["seen"] = adjusted, adjusted < LEVEL


def _state(chart: Json, judged: int) -> str:
    """Judge a chart: ``too few``, ``in control``, ``out of control``, or ``check``, which chance can explain."""
    if chart["lower"] is None:
        return "too few"
    if not chart["beyond"] and not chart["ewma"]["beyond"]:
        return "in control"
    level = LEVEL / (3.0 * judged)
    return "out of control" if min(_chances(chart)) < level else "check"


def _chances(chart: Json) -> tuple[float, float, float]:
    """Return the chances of what lies beyond the limits, for a parameter in control.

    They are: of so many values (Poisson), of the farthest average, and of the farthest value by its own stated
    uncertainty (both normal, times the number of runs).
    """
    runs, beyond = len(chart["values"]), chart["beyond"]
    farthest = max(
        (abs(chart["values"][i] - chart["centre"]) / chart["sigmas"][i] for i in beyond), default=0.0
    )
    averages = chart["ewma"]
    reach = max((_reach(averages, chart, i) for i in averages["beyond"]), default=0.0)
    return (
        float(stats.poisson.sf(len(beyond) - 1, SHEWHART_CHANCE * runs)),
        min(1.0, runs * float(2.0 * stats.norm.sf(reach))),
        min(1.0, runs * float(2.0 * stats.norm.sf(farthest))),
    )


def _reach(averages: Json, chart: Json, place: int) -> float:
    """Return the distance of an average from the centre, in its standard deviations."""
    half = averages["upper"][place] - chart["centre"]
    distance = abs(averages["values"][place] - chart["centre"])
    return float(averages["limit"] * distance / half) if half > 0 else float("inf")


def _worst(states: Sequence[str]) -> str:
    order = ("out of control", "check", "in control", "too few")
    return next((state for state in order if state in states), "too few")


def drifts(chart: Mapping[str, Any]) -> bool:
    """Return whether a parameter has a significant drift."""
    return any((chart["drift"][name] or {}).get("seen") for name in _SLOPES)


def needs_attention(group: Mapping[str, Any]) -> bool:
    """Return whether a group is out of control, or one of its parameters drifts; False with too few runs."""
    return group["state"] == "out of control" or any(drifts(chart) for chart in group["parameters"])


# The check standard of a station: one camera that is measured again and again, so that its chart watches the bench.


def standard_problem(station: Station, home: Path, now: datetime) -> str:
    """Return why the check standard says that the bench must be looked at; empty if it does not."""
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
