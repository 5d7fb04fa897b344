"""Control charts and drift of every parameter of groups of runs, with a verdict in plain words.

A station's check standard is one camera that is measured again and again, so that its chart watches the bench
(NIST/SEMATECH e-Handbook, 2.2.2 and 2.3.5).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

from scipy import stats

from bench.base.encoding import counted
from bench.charts.chart_groups import ChartGroup, ChartKey, ChartRun, Level
from bench.charts.statistics import (
    LEVEL,
    SHEWHART_CHANCE,
    Drift,
    ewma,
    find_drift,
    holm,
    individuals,
)
from bench.record.as_data import as_data
from bench.record.coverage import Estimate
from bench.record.summaries import (
    ChartData,
    ChartGroupData,
    ChartJudgement,
    ChartOfFew,
    ChartsData,
    ChartState,
    ChartValues,
    DriftData,
    DriftSlopeData,
    EwmaData,
    LimitedChart,
    LimitsData,
    TestedSlope,
    drifts,
)
from bench.wording.numbers import number, plus_minus, with_uncertainty
from bench.wording.parameters import meaning_of, unit_text

_DAYS_A_YEAR = 365.25  # A Julian year
_NAMED = 3  # More runs make a sentence that nobody reads
_SCATTER_SIGMAS = 3.5  # By chance, one parameter in 4000 exceeds it: a page has many
SCHEMA = "starbench/charts/1"
LEAST_RUNS = 5
"""Fewest runs for control limits: of fewer, at most three ranges would tell the scatter."""
ENOUGH_RUNS = 20
"""With fewer runs, limits are provisional (Montgomery, section 6.2, advises 20 to 25)."""
_UNTESTED = Drift(None, None, joint=False, separable=True, between_runs=None, scatter=None)


def slope_text(value: float, expanded: float, unit: str, per: str) -> str:
    """Return a slope per day or °C, in a unit (or empty) per ``day``, ``hour``, ``year`` or ``°C``.

    >>> slope_text(0.5, 0.1, "px", "day")
    '+0.50 ± 0.10 px per day'
    """
    factor = {"hour": 1.0 / 24.0, "year": _DAYS_A_YEAR}.get(per, 1.0)
    sign = "+" if value > 0 else ""
    return f"{sign}{plus_minus(value * factor, expanded * factor, unit)} per {per}"


def time_unit(span_days: float) -> str:
    """Return the unit in which to state a slope of so many days: ``hour``, ``day`` or ``year``."""
    return "hour" if span_days < 2.0 else "day" if span_days < 120.0 else "year"


def _parameter_verdict(computed: _Computed, level: Level, state: ChartState, drift: DriftData) -> str:
    runs = len(computed.runs)
    if computed.control is None:
        return f"{counted(runs, 'run')}: too few for limits (at least 5 are needed)."
    sentences = [_control(computed, computed.control, state), *_drifts(drift)]
    if level == "camera" and (ratio := _excess_scatter(computed.drift, runs)):
        sentences.append(
            f"The runs scatter {number(ratio, 2)} times as much as their stated uncertainties predict."
        )
    if computed.provisional:
        baseline = computed.control.limits["baseline"]
        sentences.append(f"The limits come from {baseline} runs: provisional until there are 20.")
    return " ".join(sentences)


def _excess_scatter(drift: Drift, runs: int) -> float | None:
    """Return a parameter's Birge ratio if 3.5 of its standard deviations above 1; else None.

    That is about 1 / sqrt(2 n) if the uncertainties are right (Birge, Phys. Rev. 40 (1932) 207).
    """
    least = 1.0 + _SCATTER_SIGMAS / math.sqrt(2.0 * max(runs - 2, 1))
    return drift.scatter if drift.scatter is not None and drift.scatter > least else None


def _control(computed: _Computed, control: _Control, state: ChartState) -> str:
    limits, averages, runs = control.limits, control.averages["beyond"], len(computed.runs)
    low, high = (with_uncertainty(limits[end], limits["sigma"])[0] for end in ("lower", "upper"))
    within = f"{low} to {high}{' ' if computed.unit else ''}{computed.unit}"
    if state == "in control":
        return f"In control: all {runs} runs lie within {within}."
    parts = []
    if beyond := limits["beyond"]:
        expected = number(SHEWHART_CHANCE * runs, 2)
        lie = f"{counted(len(beyond), 'run')} of {runs} {'lies' if len(beyond) == 1 else 'lie'} outside {within}"
        parts.append(f"{lie} ({_named(beyond, computed.runs)}); about {expected} by chance")
    if averages:
        named = _named(averages[:1], computed.runs)
        parts.append(f"the moving average (EWMA) left its limits at {named}: the mean may have shifted")
    lead = "Out of control" if state == "out of control" else "Check, it may be chance"
    return f"{lead}: {'; '.join(parts)}."


def _drifts(drift: DriftData) -> list[str]:
    slopes = (("time", drift["per_day"]), ("temperature", drift["per_c"]))
    tested = [(what, slope) for what, slope in slopes if slope is not None]
    sentences = []
    for what, slope in tested:
        if slope["seen"]:
            p = slope["p_adjusted"]
            chance = f"p = {number(p, 1)}" if p >= 1e-6 else "p < 0.000001"
            sentences.append(f"It drifts with {what}: {slope['text']} ({chance}).")
    if sentences and not drift["separable"]:
        sentences.append(
            "Time and temperature changed together, so the runs do not show which of them is the cause."
        )
    names = " or ".join(what for what, _ in tested)
    return sentences or ([f"No significant drift with {names}."] if tested else [])


def _named(places: Sequence[int], runs: Sequence[ChartRun]) -> str:
    names = [runs[place].run for place in places[:_NAMED]]
    return ", ".join(names) + (", ..." if len(places) > _NAMED else "")


def _title(key: ChartKey, cameras: int, runs: int) -> str:
    """Return the heading of a group."""
    camera = f"Camera {key.serial or 'without a serial number'}, {key.camera_type}"
    if key.level == "type":
        camera = f"Camera type {key.camera_type}, {counted(cameras, 'camera')}"
    kind = "" if key.kind == "measured" else f"{key.kind.upper()}: "
    return f"{kind}{camera}: {counted(runs, 'run')}"


def _place(key: ChartKey) -> str:
    """Return where and how the runs of a group were made."""
    parts = [f"Station {key.station or 'without a name'}"]
    parts += [key.bench] if key.bench else []
    parts += [f"collimator {key.collimator}"] if key.collimator else []
    parts += [f"target {key.target}"] if key.target else []
    return ", ".join([*parts, f"model {key.model}"])


def _group_verdict(charts: Sequence[ChartData], state: ChartState, runs: int) -> str:
    """Say in one or two sentences what the charts of a group show."""
    if state == "too few":
        return f"{counted(runs, 'run')}: too few for a verdict (at least 5 are needed)."
    wrong = [c["name"] for c in charts if c["state"] == "out of control"]
    check = [c["name"] for c in charts if c["state"] == "check"]
    drifting = [c["name"] for c in charts if drifts(c)]
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


@dataclass(frozen=True)
class _Control:
    """The limits of a parameter."""

    limits: LimitsData
    averages: EwmaData


@dataclass(frozen=True)
class _Computed:
    """The numbers of a chart, before all charts of a page are judged together."""

    name: str
    runs: Sequence[ChartRun]
    provisional: bool
    control: _Control | None  # None with too few runs
    drift: Drift

    @property
    def estimates(self) -> list[Estimate]:
        """The parameter in each run."""
        return [run.parameters[self.name] for run in self.runs]

    @property
    def unit(self) -> str:
        """Unit of the parameter; empty for a pure number."""
        return unit_text(self.name)

    @property
    def slopes(self) -> list[TestedSlope]:
        """The slopes that could be tested."""
        return [slope for slope in (self.drift.per_day, self.drift.per_c) if slope is not None]


@dataclass(frozen=True)
class _Judge:
    """Judges each chart by the number of all tests of the page."""

    limited: int  # Number of charts with limits
    adjusted: Mapping[float, float]  # The adjusted chance of each slope by its own: equal ones stay equal


def find_charts(groups: Iterable[ChartGroup], *, baseline: int | None = None) -> ChartsData:
    """Compute the charts of all parameters, and judge them together.

    Limits come from each group's first ``baseline`` runs, all where None.
    """
    charts_of_group = [
        (group, [_computed(name, group, baseline) for name in group.key.parameters]) for group in groups
    ]
    every = [chart for _, charts in charts_of_group for chart in charts]
    chances = [slope["p"] for each_chart in every for slope in each_chart.slopes]
    judge = _Judge(
        limited=sum(each_chart.control is not None for each_chart in every),
        adjusted=dict(zip(chances, holm(chances), strict=True)),
    )
    groups_data = [_group_data(group, charts, judge) for group, charts in charts_of_group]
    return {"schema": SCHEMA, "level": LEVEL, "groups": groups_data}


def _computed(name: str, group: ChartGroup, baseline: int | None) -> _Computed:
    runs = group.runs
    provisional = min(baseline or len(runs), len(runs)) < ENOUGH_RUNS
    if len(runs) < LEAST_RUNS:
        return _Computed(name, runs, provisional, None, _UNTESTED)
    estimates = [run.parameters[name] for run in runs]
    values, sigmas = [estimate.value for estimate in estimates], [estimate.sigma for estimate in estimates]
    limits = individuals(values, baseline)
    drift = find_drift(group.days, [run.temperature_c for run in runs], values, sigmas)
    control = _Control(limits, ewma(values, limits["centre"], limits["sigma"]))
    return _Computed(name, runs, provisional, control, drift)


def _group_data(group: ChartGroup, computed: Sequence[_Computed], judge: _Judge) -> ChartGroupData:
    key, runs = group.key, group.runs
    per = time_unit(group.days[-1])
    charts = [_chart_data(parameter, key.level, per, judge) for parameter in computed]
    states: list[ChartState] = [chart["state"] for chart in charts]
    state: ChartState = min(states, key=get_args(ChartState).index, default="too few")  # the worst
    cameras = len({run.serial for run in runs})
    return {
        "level": key.level,
        "kind": key.kind,
        "bench": key.bench,
        "station": key.station,
        "camera_type": key.camera_type,
        "serial": key.serial,
        "collimator": key.collimator,
        "target": key.target,
        "model": key.model,
        "cameras": cameras,
        "runs": [
            {"run": r.run, "serial": r.serial, "begun_utc": r.begun.isoformat(), "temperature_c": r.temperature_c}
            for r in runs
        ],
        "parameters": charts,
        "title": _title(key, cameras, len(runs)),
        "place": _place(key),
        "state": state,
        "verdict": _group_verdict(charts, state, len(runs)),
    }  # fmt: skip


def _chart_data(computed: _Computed, level: Level, per: str, judge: _Judge) -> ChartData:
    state, drift = _state(computed, judge.limited), _drift_data(computed, per, judge)
    values: ChartValues = {
        "name": computed.name,
        "unit": computed.unit,
        "meaning": meaning_of(computed.name),
        "values": [run.value for run in computed.estimates],
        "sigmas": [run.sigma for run in computed.estimates],
        "expanded": [run.expanded for run in computed.estimates],
    }
    judgement: ChartJudgement = {
        "drift": drift,
        "state": state,
        "verdict": _parameter_verdict(computed, level, state, drift),
    }
    if computed.control is None:
        none: ChartOfFew = {
            **values, "lower": None, "upper": None, "ewma": None, "provisional": computed.provisional, **judgement
        }  # fmt: skip
        return none
    limits, averages = computed.control.limits, computed.control.averages
    made: LimitedChart = {
        **values,
        "ewma": averages,
        "provisional": computed.provisional,
        **limits,
        **judgement,
    }
    return made


def _drift_data(computed: _Computed, per: str, judge: _Judge) -> DriftData:
    drift = computed.drift
    return {
        **as_data(drift, DriftData),
        "per_day": _slope_data(drift.per_day, computed.unit, per, judge) if drift.per_day else None,
        "per_c": _slope_data(drift.per_c, computed.unit, "°C", judge) if drift.per_c else None,
    }


def _slope_data(slope: TestedSlope, unit: str, per: str, judge: _Judge) -> DriftSlopeData:
    adjusted = judge.adjusted[slope["p"]]
    return {
        **slope,
        "p_adjusted": adjusted,
        "seen": adjusted < LEVEL,
        "text": slope_text(slope["value"], slope["expanded"], unit, per),
        "per": per,
    }


def _state(computed: _Computed, limited: int) -> ChartState:
    """Judge a chart; ``check`` is what chance can explain where so many charts have limits."""
    if computed.control is None:
        return "too few"
    if not computed.control.limits["beyond"] and not computed.control.averages["beyond"]:
        return "in control"
    level = LEVEL / (3.0 * limited)
    return "out of control" if min(_chances(computed, computed.control)) < level else "check"


def _chances(computed: _Computed, control: _Control) -> tuple[float, float, float]:
    """Return the chances of what lies beyond the limits, for a parameter in control.

    They are: of so many values (Poisson), of the farthest average, and of the farthest value by its own stated
    uncertainty (both normal, times the number of runs).
    """
    runs, estimates = len(computed.runs), computed.estimates
    centre, beyond = control.limits["centre"], control.limits["beyond"]
    farthest = max((abs(estimates[i].value - centre) / estimates[i].sigma for i in beyond), default=0.0)
    reach = max((_reach(control, i) for i in control.averages["beyond"]), default=0.0)
    return (
        float(stats.poisson.sf(len(beyond) - 1, SHEWHART_CHANCE * runs)),
        min(1.0, runs * float(2.0 * stats.norm.sf(reach))),
        min(1.0, runs * float(2.0 * stats.norm.sf(farthest))),
    )


def _reach(control: _Control, place: int) -> float:
    """Return the distance of an average from the centre, in its standard deviations."""
    averages, centre = control.averages, control.limits["centre"]
    half = averages["upper"][place] - centre
    distance = abs(averages["values"][place] - centre)
    return averages["limit"] * distance / half if half > 0 else float("inf")


def needs_attention(group: ChartGroupData) -> bool:
    """Return whether a group is out of control, or one of its parameters drifts; False with too few runs."""
    return group["state"] == "out of control" or any(drifts(chart) for chart in group["parameters"])
