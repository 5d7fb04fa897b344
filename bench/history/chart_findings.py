"""Control charts and drift of every parameter of groups of runs, with a verdict in plain words. Pure.

The result is one object as JSON holds it; `bench.report.chart_page` draws it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from scipy import stats

from bench.history.chart_groups import ChartGroup, ChartRun
from bench.history.control_limits import (
    SHEWHART_CHANCE,
    Ewma,
    Individuals,
    ewma,
    individuals,
)
from bench.history.drift import LEVEL, Drift, find_drift, holm
from bench.history.table_schema import parameter_unit
from bench.history.verdict_words import (
    group_place,
    group_title,
    group_verdict,
    name_slopes,
    parameter_verdict,
)
from bench.report.text import meaning_of

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
    """Compute all charts, and judge them together.

    groups: The groups, from `bench.history.chart_groups.group_runs`.
    parameter: Only this parameter; all where None.
    baseline: Number of first runs of each group from which the limits come; all where None.
    Returns: ``schema level groups``. Each group has its ``runs``, its ``parameters``, its ``verdict`` and its
      ``state``.
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
    return {**chart, **_limit_facts(limits), "ewma": _ewma_facts(averages), "drift": _drift_facts(drift)}


def _limit_facts(limits: Individuals) -> Json:
    return {
        "centre": limits.centre,
        "sigma": limits.sigma,
        "lower": limits.lower,
        "upper": limits.upper,
        "beyond": list(limits.beyond),
        "ranges": limits.ranges.tolist(),
        "range_mean": limits.range_mean,
        "range_upper": limits.range_upper,
        "ranges_beyond": list(limits.ranges_beyond),
        "baseline": limits.baseline,
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
    """Judge a chart: ``too few``, ``in control``, ``check``, or ``out of control``.

    ``check`` means values beyond the limits, as many as chance explains on a page of so many charts and runs.
    """
    if chart["lower"] is None:
        return "too few"
    if not chart["beyond"] and not chart["ewma"]["beyond"]:
        return "in control"
    level = LEVEL / (3.0 * judged)
    return "out of control" if min(_chances(chart)) < level else "check"


def _chances(chart: Json) -> tuple[float, float, float]:
    """Return the chances of what lies beyond the limits, for a parameter in control.

    They are: of so many values beyond the limits (Poisson), of the farthest average, and of the farthest value by its
    own stated uncertainty (both normal, times the number of runs).
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
    """Return whether a group is out of control, or one of its parameters drifts.

    Returns: False also with too few runs.
    """
    return group["state"] == "out of control" or any(drifts(chart) for chart in group["parameters"])
