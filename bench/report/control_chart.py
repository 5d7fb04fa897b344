"""The five pictures of one parameter: values, moving ranges, EWMA, drift with time, drift with temperature.

Draws from the object of `bench.history.chart_findings` alone. Each run shows its stated expanded uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from bench.report.chart_axes import BLUE, MANY, RED, ChartAxes
from bench.report.drawing import INK
from bench.report.scales import tick_label, ticks
from bench.report.text import with_uncertainty

_TICKS = 4

Json = Mapping[str, Any]


def pictures(chart: Json, group: Json) -> list[str]:
    """Draw one parameter of a group.

    Returns: SVG elements; with too few runs, only the values.
    """
    found = [_values(chart, group)]
    if chart["lower"] is not None:
        found += [_ranges(chart, group), _averages(chart, group)]
    if chart["drift"]["per_day"] is not None:
        found.append(_over_time(chart, group))
    if chart["drift"]["per_c"] is not None:
        found.append(_over_temperature(chart, group))
    return found


def _values(chart: Json, group: Json) -> str:
    values, runs = chart["values"], list(range(1, len(chart["values"]) + 1))
    lows, highs = _ends(chart)
    limits = [] if chart["lower"] is None else [chart["lower"], chart["upper"]]
    axes = _axes(_titled("Values", chart), [1, len(runs)], [*lows, *highs, *limits])
    if limits:
        axes.band([chart["lower"]] * 2, [chart["upper"]] * 2, [axes.x_low, axes.x_high])
    axes.bars(runs, lows, highs)
    _join(axes, runs, values)
    if limits:
        _name_limits(axes, chart["centre"], chart["lower"], chart["upper"], chart["sigma"])
        if chart["baseline"] < len(runs):
            axes.upright(chart["baseline"] + 0.5, "limits from here back")
    axes.dots(runs, values, _texts(chart, group), chart["beyond"] if limits else ())
    return axes.svg(_dates(group))


def _ranges(chart: Json, group: Json) -> str:
    places = list(range(2, len(chart["values"]) + 1))
    axes = _axes(
        _titled("Moving ranges", chart), [1, places[-1]], [0.0, *chart["ranges"], chart["range_upper"]]
    )
    _join(axes, places, chart["ranges"])
    upper, _ = with_uncertainty(chart["range_upper"], chart["sigma"] or 1.0)
    axes.rule(chart["range_upper"], f"≤ {upper}")
    axes.rule(chart["range_mean"], "mean", dashed=False)
    texts = [f"{group['runs'][p - 1]['run']}: {r:.6g}" for p, r in zip(places, chart["ranges"], strict=True)]
    axes.dots(places, chart["ranges"], texts, [place - 1 for place in chart["ranges_beyond"]])
    return axes.svg(_dates(group))


def _averages(chart: Json, group: Json) -> str:
    average, runs = chart["ewma"], list(range(1, len(chart["values"]) + 1))
    axes = _axes(
        _titled(f"EWMA, λ = {average['lambda']:g}, L = {average['limit']:g}", chart),
        [1, len(runs)],
        [*average["values"], *average["lower"], *average["upper"]],
    )
    axes.band(average["lower"], average["upper"], runs)
    for bound in ("lower", "upper"):
        axes.line(runs, average[bound], INK, width=0.9, dashed=True)
        axes.name_at_right(average[bound][-1], with_uncertainty(average[bound][-1], chart["sigma"] or 1.0)[0])
    axes.rule(chart["centre"], "centre", dashed=False)
    _join(axes, runs, average["values"])
    texts = [f"{one['run']}: {v:.8g}" for one, v in zip(group["runs"], average["values"], strict=True)]
    axes.dots(runs, average["values"], texts, average["beyond"])
    return axes.svg(_dates(group))


def _over_time(chart: Json, group: Json) -> str:
    days = _days(group)
    return _drift(chart, group, days, list(range(len(days))), "per_day", "time", _day_ticks(days, group))


def _over_temperature(chart: Json, group: Json) -> str:
    degrees = [run["temperature_c"] for run in group["runs"]]
    known = [place for place, c in enumerate(degrees) if c is not None]
    warm = [float(degrees[place]) for place in known]
    low, high = min(warm), max(warm)
    labels = [(value, f"{tick_label(value, high - low)} °C") for value in ticks(low, high, _TICKS)]
    return _drift(chart, group, warm, known, "per_c", "temperature", labels)


def _drift(
    chart: Json,
    group: Json,
    xs: Sequence[float],
    places: Sequence[int],
    slope: str,
    what: str,
    labels: Sequence[tuple[float, str]],
) -> str:
    """Draw the values over a quantity, with the fitted line; a line that is no more than chance is grey and dashed."""
    found = chart["drift"][slope]
    values = [chart["values"][place] for place in places]
    lows, highs = ([one[place] for place in places] for one in _ends(chart))
    middle_x, middle_y = sum(xs) / len(xs), sum(values) / len(values)
    ends = [min(xs), max(xs)]
    line = [middle_y + found["value"] * (x - middle_x) for x in ends]
    axes = _axes(f"Over {what}: {found['text']}", ends, [*lows, *highs, *line])
    axes.bars(xs, lows, highs)
    texts = _texts(chart, group)
    axes.dots(xs, values, [texts[place] for place in places], ())
    axes.line(ends, line, RED if found["seen"] else INK, width=1.8, dashed=not found["seen"])
    return axes.svg(labels)


def _axes(title: str, xs: Sequence[float], values: Sequence[float]) -> ChartAxes:
    low, high = min(values), max(values)
    margin = 0.05 * (high - low)
    beside = 0.02 * (max(xs) - min(xs))
    return ChartAxes(title, min(xs) - beside, max(xs) + beside, low - margin, high + margin)


def _join(axes: ChartAxes, xs: Sequence[float], values: Sequence[float]) -> None:
    """Join the dots; thousands of them would hide each other behind the lines."""
    if len(xs) <= MANY:
        axes.line(xs, values, BLUE, width=0.7)


def _titled(what: str, chart: Json) -> str:
    unit = f", {chart['unit']}" if chart["unit"] else ""
    return f"{what} of {chart['name']}{unit}"


def _name_limits(axes: ChartAxes, centre: float, lower: float, upper: float, sigma: float) -> None:
    for value, dashed in ((lower, True), (centre, False), (upper, True)):
        axes.rule(value, with_uncertainty(value, sigma)[0], dashed=dashed)


def _ends(chart: Json) -> tuple[list[float], list[float]]:
    pairs = list(zip(chart["values"], chart["expanded"], strict=True))
    return [v - u for v, u in pairs], [v + u for v, u in pairs]


def _texts(chart: Json, group: Json) -> list[str]:
    """Return what is shown for each run under the pointer."""
    unit = f" {chart['unit']}" if chart["unit"] else ""
    found = []
    for run, value, expanded in zip(group["runs"], chart["values"], chart["expanded"], strict=True):
        shown = " ± ".join(with_uncertainty(value, expanded))
        found.append(f"{run['run']}, {run['begun_utc'][:16].replace('T', ' ')} UTC: {shown}{unit}")
    return found


def _days(group: Json) -> list[float]:
    moments = [datetime.fromisoformat(run["begun_utc"]) for run in group["runs"]]
    return [(moment - moments[0]).total_seconds() / 86400.0 for moment in moments]


def _label(utc: str, span_days: float) -> str:
    moment = datetime.fromisoformat(utc)
    return f"{moment:%H:%M}" if span_days < 2.0 else f"{moment:%Y-%m-%d}"


def _dates(group: Json) -> list[tuple[float, str]]:
    """Return ticks of an axis that counts the runs, with the date of the run at each."""
    count = len(group["runs"])
    span = _days(group)[-1]
    places = sorted({round(n * (count - 1) / (_TICKS - 1)) for n in range(_TICKS)}) if count > 1 else [0]
    return [(place + 1, _label(group["runs"][place]["begun_utc"], span)) for place in places]


def _day_ticks(days: Sequence[float], group: Json) -> list[tuple[float, str]]:
    """Return ticks of an axis of days, at runs that are near to even distances."""
    wanted = [days[-1] * n / (_TICKS - 1) for n in range(_TICKS)]
    places = sorted({min(range(len(days)), key=lambda p: abs(days[p] - day)) for day in wanted})
    return [(days[place], _label(group["runs"][place]["begun_utc"], days[-1])) for place in places]
