"""The four pictures of one parameter: values, EWMA, drift with time, drift with temperature.

Each run shows its stated expanded uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from bench.record.summaries import (
    ChartData,
    ChartGroupData,
    ChartsData,
    DriftSlopeData,
    LimitedChart,
    drifts,
    has_limits,
)
from bench.report.html import render_page
from bench.report.svg_plot import INK
from bench.report.svg_scale import tick_label, ticks
from bench.report.wide_chart import BLUE, MANY, RED, Chart
from bench.wording.numbers import plus_minus, with_uncertainty

_TICKS = 4  # Their labels do not meet at the width of a chart
MOST_DRAWN = 60
"""Most parameters that are drawn, so that the page of many groups stays small; the table has all of them."""
_ORDER = ("out of control", "check", "in control", "too few")
_PILLS = {"in control": "pass", "check": "marginal", "out of control": "fail", "too few": "marginal"}


def pictures(chart: ChartData, group: ChartGroupData) -> list[str]:
    """Draw one parameter of a group as SVG elements; with too few runs, only the values."""
    drawn = [_values(chart, group)]
    if has_limits(chart):
        drawn.append(_averages(chart, group))
    if (by_day := chart["drift"]["per_day"]) is not None:
        drawn.append(_over_time(chart, group, by_day))
    if (by_c := chart["drift"]["per_c"]) is not None:
        drawn.append(_over_temperature(chart, group, by_c))
    return drawn


def _values(chart: ChartData, group: ChartGroupData) -> str:
    values, runs = chart["values"], list(range(1, len(chart["values"]) + 1))
    lows, highs = _ends(chart)
    limits = [chart["lower"], chart["upper"]] if has_limits(chart) else []
    axes = Chart(_titled("Values", chart), [1, len(runs)], [*lows, *highs, *limits], _dates(group))
    if has_limits(chart):
        axes.band([1, len(runs)], [chart["lower"]] * 2, [chart["upper"]] * 2)
    axes.bars(runs, lows, highs)
    _join(axes, runs, values)
    if has_limits(chart):
        _name_limits(axes, chart["centre"], chart["lower"], chart["upper"], chart["sigma"])
        if chart["baseline"] < len(runs):
            axes.upright(chart["baseline"] + 0.5, "limits from here back")
    axes.dots(runs, values, _texts(chart, group), chart["beyond"] if has_limits(chart) else ())
    return axes.svg()


def _averages(chart: LimitedChart, group: ChartGroupData) -> str:
    average, runs = chart["ewma"], list(range(1, len(chart["values"]) + 1))
    axes = Chart(
        _titled(f"EWMA, λ = {average['lambda']:g}, L = {average['limit']:g}", chart),
        [1, len(runs)],
        [*average["values"], *average["lower"], *average["upper"]],
        _dates(group),
    )
    axes.band(runs, average["lower"], average["upper"])
    for bound in (average["lower"], average["upper"]):
        axes.line(runs, bound, INK, dash="5 3")
        axes.name_at_right(bound[-1], with_uncertainty(bound[-1], chart["sigma"] or 1.0)[0])
    axes.rule(chart["centre"], "centre", dashed=False)
    _join(axes, runs, average["values"])
    texts = [f"{run['run']}: {v:.8g}" for run, v in zip(group["runs"], average["values"], strict=True)]
    axes.dots(runs, average["values"], texts, average["beyond"])
    return axes.svg()


def _over_time(chart: ChartData, group: ChartGroupData, slope: DriftSlopeData) -> str:
    days = _days(group)
    return _drift(chart, group, days, list(range(len(days))), slope, "time", _day_ticks(days, group))


def _over_temperature(chart: ChartData, group: ChartGroupData, slope: DriftSlopeData) -> str:
    degrees = [(place, run["temperature_c"]) for place, run in enumerate(group["runs"])]
    known = {place: c for place, c in degrees if c is not None}
    warm = list(known.values())
    low, high = min(warm), max(warm)
    labels = [(value, f"{tick_label(value, high - low)} °C") for value in ticks(low, high, _TICKS)]
    return _drift(chart, group, warm, list(known), slope, "temperature", labels)


def _drift(
    chart: ChartData,
    group: ChartGroupData,
    xs: Sequence[float],
    places: Sequence[int],
    slope: DriftSlopeData,
    what: str,
    labels: Sequence[tuple[float, str]],
) -> str:
    """Draw the values over a quantity, with the fitted line; a line that is no more than chance is grey and dashed."""
    values = [chart["values"][place] for place in places]
    lows, highs = ([end[place] for place in places] for end in _ends(chart))
    middle_x, middle_y = sum(xs) / len(xs), sum(values) / len(values)
    ends = [min(xs), max(xs)]
    line = [middle_y + slope["value"] * (x - middle_x) for x in ends]
    axes = Chart(f"Over {what}: {slope['text']}", ends, [*lows, *highs, *line], labels)
    axes.bars(xs, lows, highs)
    texts = _texts(chart, group)
    axes.dots(xs, values, [texts[place] for place in places], ())
    axes.line(ends, line, RED if slope["seen"] else INK, 1.5, "" if slope["seen"] else "5 3")
    return axes.svg()


def _join(axes: Chart, xs: Sequence[float], values: Sequence[float]) -> None:
    """Join the dots; thousands of them would hide each other behind the lines."""
    if len(xs) <= MANY:
        axes.line(xs, values, BLUE, 0.6)


def _titled(what: str, chart: ChartData) -> str:
    unit = f", {chart['unit']}" if chart["unit"] else ""
    return f"{what} of {chart['name']}{unit}"


def _name_limits(axes: Chart, centre: float, lower: float, upper: float, sigma: float) -> None:
    for value, dashed in ((lower, True), (centre, False), (upper, True)):
        axes.rule(value, with_uncertainty(value, sigma)[0], dashed=dashed)


def _ends(chart: ChartData) -> tuple[list[float], list[float]]:
    pairs = list(zip(chart["values"], chart["expanded"], strict=True))
    return [v - u for v, u in pairs], [v + u for v, u in pairs]


def _texts(chart: ChartData, group: ChartGroupData) -> list[str]:
    """Return what is shown for each run under the pointer."""
    texts = []
    for run, value, expanded in zip(group["runs"], chart["values"], chart["expanded"], strict=True):
        shown = plus_minus(value, expanded, chart["unit"])
        texts.append(f"{run['run']}, {run['begun_utc'][:16].replace('T', ' ')} UTC: {shown}")
    return texts


def _days(group: ChartGroupData) -> list[float]:
    moments = [datetime.fromisoformat(run["begun_utc"]) for run in group["runs"]]
    return [(moment - moments[0]).total_seconds() / 86400.0 for moment in moments]


def _label(utc: str, span_days: float) -> str:
    moment = datetime.fromisoformat(utc)
    return f"{moment:%H:%M}" if span_days < 2.0 else f"{moment:%Y-%m-%d}"


def _dates(group: ChartGroupData) -> list[tuple[float, str]]:
    """Return ticks of an axis that counts the runs, with the date of the run at each."""
    count = len(group["runs"])
    span = _days(group)[-1]
    places = sorted({round(n * (count - 1) / (_TICKS - 1)) for n in range(_TICKS)}) if count > 1 else [0]
    return [(place + 1, _label(group["runs"][place]["begun_utc"], span)) for place in places]


def _day_ticks(days: Sequence[float], group: ChartGroupData) -> list[tuple[float, str]]:
    """Return ticks of an axis of days, at runs that are near to even distances."""
    wanted = [days[-1] * n / (_TICKS - 1) for n in range(_TICKS)]
    places = sorted({min(range(len(days)), key=lambda p: abs(days[p] - day)) for day in wanted})
    return [(days[place], _label(group["runs"][place]["begun_utc"], days[-1])) for place in places]


def render_charts(page: ChartsData, notes: Sequence[str] = (), faults: Sequence[str] = ()) -> str:
    """Render the page of charts, with sentences about what was noticed when the runs were found."""
    groups = page["groups"]
    drawn = choose_drawn(groups)
    sections = [chart_section(group, drawn.get(number, frozenset())) for number, group in enumerate(groups)]
    kinds = sorted({group["kind"] for group in groups} - {"measured"})
    return render_page(
        "charts.html.j2",
        sections=sections,
        kinds=kinds,
        mixed=bool(kinds) and any(group["kind"] == "measured" for group in groups),
        runs=sum(len(group["runs"]) for group in groups if group["level"] == "camera"),
        begun=min((g["runs"][0]["begun_utc"][:10] for g in groups), default=""),
        ended=max((g["runs"][-1]["begun_utc"][:10] for g in groups), default=""),
        wrong=[s for s in sections if s["state"] == "out of control" or s["drifts"]],
        few=sum(section["state"] == "too few" for section in sections),
        hidden=sum(len(group["parameters"]) for group in groups) - sum(map(len, drawn.values())),
        notes=notes,
        faults=faults,
    )


def choose_drawn(groups: Sequence[ChartGroupData]) -> dict[int, frozenset[str]]:
    """Choose at most `MOST_DRAWN` parameters: those with findings first. Names by the place of their group."""
    waiting = [
        (not drifts(chart), _ORDER.index(chart["state"]), number, place, chart["name"])
        for number, group in enumerate(groups)
        for place, chart in enumerate(group["parameters"])
    ]
    waiting.sort(key=lambda point: (min(point[1], 1 if not point[0] else 9), point[2], point[3]))
    chosen: dict[int, set[str]] = {}
    for _, _, number, _, name in waiting[:MOST_DRAWN]:
        chosen.setdefault(number, set()).add(name)
    return {number: frozenset(names) for number, names in chosen.items()}


def chart_section(group: ChartGroupData, drawn: frozenset[str]) -> dict[str, Any]:
    """Return what the macros of the template print about one group: the group, its pictures, and its colours."""
    charts = group["parameters"]
    return {
        **group,
        "pills": _PILLS,
        "drifts": any(drifts(chart) for chart in charts),
        "pictures": {chart["name"]: pictures(chart, group) for chart in charts if chart["name"] in drawn},
    }
