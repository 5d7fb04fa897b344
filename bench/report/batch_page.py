"""The summary of a batch as one HTML page: what was run, what failed and why, how each parameter went.

Knows the structure of ``summary.json`` and nothing else; formats by `bench.report.text`, draws by
`bench.report.trend_plots`. Nothing a summary holds can become markup: the template escapes everything.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, tzinfo
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

from markupsafe import Markup

from bench.report.html import environment
from bench.report.text import NOTHING, duration, fixed, meaning_of, number, unit_of, with_uncertainty
from bench.report.trend_plots import Series, against_temperature, bars_of, over_time, timeline

_K = 2.0
_SCATTER_SIGMAS = 3.0
"""A Birge ratio that exceeds 1 by more than that many of its own standard deviations is more than chance."""
_LEAST_RANGE_C = 0.2
"""Temperatures that vary by less are one temperature."""
_HEADLINE = "fx"

Json = Mapping[str, Any]


class RunRow(NamedTuple):
    """A run as the table prints it."""

    item: str
    link: str
    begun: str
    took: str
    camera: str
    poses: str
    recordings: str
    attempts: str
    deviations: str
    temperature: str
    rms: str
    focal: str
    how: str
    verdict: str


class TrendRow(NamedTuple):
    """A parameter as the table of trends prints it."""

    name: str
    meaning: str
    unit: str
    mean: str
    expanded: str
    birge: str
    per_hour: str
    per_c: str
    verdict: str
    label: str


def render_batch(summary: Json) -> str:
    """Render the page.

    Parameters
    ----------
    summary
        As ``batch_summary.summarise`` gives it.

    Returns
    -------
    str
        A complete HTML document that needs nothing from anywhere else; a function of ``summary`` alone.
    """
    zone = _zone(summary)
    bars = bars_of(summary["items"])
    failures = [
        item for item in summary["items"] if item["how"] not in {"finished", "not begun", "withdrawn"}
    ]
    return (
        environment()
        .get_template("batch.html.j2")
        .render(
            summary=summary,
            zone=_zone_name(summary, zone),
            headline=_headline(summary, zone),
            figures=_key_figures(summary),
            timeline=Markup(timeline(bars, zone)) if bars else "",  # noqa: S704
            failures=[
                (item["item"], item["how"], item["why"] or NOTHING, item["attempts"]) for item in failures
            ],
            not_begun=[item["item"] for item in summary["items"] if item["how"] == "not begun"],
            withdrawn=[item["item"] for item in summary["items"] if item["how"] == "withdrawn"],
            cameras=[_camera_section(camera, place, zone) for place, camera in enumerate(summary["cameras"])],
            rows=[_run_row(item, zone) for item in summary["items"] if item["begun_utc"]],
            requests=summary["requests"],
        )
    )


def _zone(summary: Json) -> tzinfo | None:
    """Whose clocks the page shows: the queue's, else this machine's as they stood then."""
    if summary["zone"]:
        return ZoneInfo(summary["zone"])
    begun = summary["begun_utc"]
    return datetime.fromisoformat(begun).astimezone().tzinfo if begun else None


def _zone_name(summary: Json, zone: tzinfo | None) -> str:
    if summary["zone"]:
        return str(summary["zone"])
    begun = summary["begun_utc"]
    return datetime.fromisoformat(begun).astimezone(zone).strftime("UTC%z") if begun else "UTC"


def _headline(summary: Json, zone: tzinfo | None) -> str:
    begun, ended = _local(summary["begun_utc"], zone), _local(summary["ended_utc"], zone)
    same_day = begun[:10] == ended[:10]
    return f"{begun} to {ended[11:] if same_day else ended}"


def _local(utc: str | None, zone: tzinfo | None) -> str:
    return f"{datetime.fromisoformat(utc).astimezone(zone):%Y-%m-%d %H:%M}" if utc else NOTHING


def _key_figures(summary: Json) -> list[tuple[str, str]]:
    """Give the large numbers at the top of the page."""
    totals = summary["totals"]
    by_end = totals["by_end"]
    without = sum(n for how, n in by_end.items() if how not in {"finished", "not begun", "withdrawn"})
    return [
        (f"{by_end.get('finished', 0)} of {totals['runs']}", "runs with a result"),
        (str(without), "without one"),
        (str(by_end.get("not begun", 0)), "not begun"),
        (number(totals["poses"]), f"poses, by {number(totals['recordings'])} recordings"),
        (str(totals["deviations"]), "deviations from the sequences"),
        (duration(3600.0 * totals["hours"]), f"in all, {duration(3600.0 * totals['working_hours'])} at work"),
    ]


def _run_row(item: Json, zone: tzinfo | None) -> RunRow:
    found = item["parameters"].get(_HEADLINE)
    focal = " ± ".join(with_uncertainty(found["value"], _K * found["sigma"])) if found else NOTHING
    poses = "" if item["poses"] is None else f" / {item['poses']}"
    return RunRow(
        item["item"],
        item["report"] or "",
        _local(item["begun_utc"], zone)[11:],
        duration(item["took_s"]) if item["took_s"] is not None else NOTHING,
        item["camera"] or NOTHING,
        f"{item['accepted']}{poses}",
        str(item["recordings"]),
        str(item["attempts"]),
        str(item["deviations"] or NOTHING),
        fixed(item["temperature_c"], 1),
        fixed(item["rms_px"], 4),
        focal,
        item["how"],
        {"finished": "pass", "aborted": "marginal", "cut off": "marginal"}.get(item["how"], "fail"),
    )


def _camera_section(camera: Json, place: int, zone: tzinfo | None) -> dict[str, Any]:
    """Give a camera's part of the page."""
    runs, trends = camera["runs"], camera["parameters"]
    temperatures = [run["temperature_c"] for run in runs]
    warm = (
        all(t is not None for t in temperatures)
        and len(runs) > 1
        and max(temperatures) - min(temperatures) >= _LEAST_RANGE_C
    )
    moments = [datetime.fromisoformat(run["begun_utc"]) for run in runs]
    time_plot = over_time(moments, _series(runs, trends, "per_hour"), zone, f"time-{place}") if trends else ""
    warm_plot = (
        against_temperature(temperatures, _series(runs, trends, "per_c"), f"warm-{place}")
        if trends and warm
        else ""
    )
    return {
        "serial": camera["camera"] or NOTHING,
        "model": camera["model"],
        "runs": len(runs),
        "range": f"{min(temperatures):.1f} to {max(temperatures):.1f} °C" if warm else "",
        "trends": [_trend_row(trend, len(runs), warm=warm) for trend in trends],
        "time_plot": Markup(time_plot),  # noqa: S704
        "warm_plot": Markup(warm_plot),  # noqa: S704
        "verdict": _verdict(trends, len(runs)),
    }


def _series(runs: Sequence[Json], trends: Sequence[Json], slope: str) -> list[Series]:
    return [
        Series(
            trend["name"],
            [run["parameters"][trend["name"]]["value"] for run in runs],
            [run["parameters"][trend["name"]]["sigma"] for run in runs],
            trend["mean"],
            trend["sigma"],
            (trend[slope]["value"], trend[slope]["seen"]) if trend[slope] else None,
        )
        for trend in trends
    ]


def _scatters(trend: Json, runs: int) -> bool:
    """Whether runs scatter more than their uncertainties say: the Birge ratio's own scatter is 1 / sqrt(2 (n - 1))."""
    return bool(trend["birge"] > 1.0 + _SCATTER_SIGMAS / math.sqrt(2.0 * (runs - 1)))


def _trend_row(trend: Json, runs: int, *, warm: bool) -> TrendRow:
    name = trend["name"]
    unit = "" if unit_of(name) == "1" else unit_of(name)
    mean, expanded = with_uncertainty(trend["mean"], _K * trend["sigma"])
    moves = trend["per_hour"] is not None and trend["per_hour"]["seen"]
    follows = warm and trend["per_c"] is not None and trend["per_c"]["seen"]
    scattered = _scatters(trend, runs)
    if moves or follows:
        verdict, label = "marginal", "changes" if moves else "follows temperature"
    elif scattered:
        verdict, label = "marginal", "scatters"
    else:
        verdict, label = "pass", "steady"
    return TrendRow(
        name,
        meaning_of(name),
        unit,
        mean,
        expanded,
        fixed(trend["birge"], 2),
        _slope_text(trend["per_hour"]),
        _slope_text(trend["per_c"]) if warm else NOTHING,
        verdict,
        label,
    )


def _slope_text(found: Json | None) -> str:
    if found is None:
        return NOTHING
    value, expanded = with_uncertainty(found["value"], _K * found["sigma"])
    return f"{value} ± {expanded}"


def _verdict(trends: Sequence[Json], runs: int) -> str:
    """Say in a sentence what the trends amount to."""
    if not trends:
        return "One run has a result: there is nothing to compare it with."
    moving = [t["name"] for t in trends if t["per_hour"] is not None and t["per_hour"]["seen"]]
    scattered = [t["name"] for t in trends if _scatters(t, runs) and t["name"] not in moving]
    said = []
    if moving:
        said.append(f"{', '.join(moving)} changed over the night by more than 3.5 standard uncertainties")
    if scattered:
        said.append(f"{', '.join(scattered)} scattered more than the stated uncertainties say")
    if not said:
        return f"All {runs} results agree within their uncertainties; no parameter changed over the night."
    return f"{'; '.join(said)}."
