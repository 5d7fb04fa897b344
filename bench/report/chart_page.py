"""The page of control charts: one HTML file that loads nothing.

Depends on the object of `bench.history.chart_findings` alone. The template escapes all text.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from bench.report.control_chart import pictures
from bench.report.html import environment
from bench.report.text import NOTHING, with_uncertainty

MOST_DRAWN = 60
"""Most parameters that are drawn; the table has all of them."""
_ORDER = ("out of control", "check", "in control", "too few")
_PILLS = {"in control": "pass", "check": "marginal", "out of control": "fail", "too few": "marginal"}

Json = Mapping[str, Any]


def render_charts(page: Json, notes: Sequence[str] = (), faults: Sequence[str] = ()) -> str:
    """Render the page.

    page: Groups with their charts, from `bench.history.chart_findings.find_charts`.
    notes, faults: What was noticed when the runs were found; sentences.
    """
    groups = page["groups"]
    drawn = choose_drawn(groups)
    sections = [chart_section(group, drawn.get(number, frozenset())) for number, group in enumerate(groups)]
    kinds = sorted({group["kind"] for group in groups} - {"measured"})
    return (
        environment()
        .get_template("charts.html.j2")
        .render(
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
    )


def choose_drawn(groups: Sequence[Json]) -> dict[int, frozenset[str]]:
    """Choose what is drawn: the parameters with findings first, then in order.

    Returns: Names of the parameters by the place of their group; at most `MOST_DRAWN` in all.
    """
    waiting = [
        (not _drifts(chart), _ORDER.index(chart["state"]), number, place, chart["name"])
        for number, group in enumerate(groups)
        for place, chart in enumerate(group["parameters"])
    ]
    waiting.sort(key=lambda one: (min(one[1], 1 if not one[0] else 9), one[2], one[3]))
    chosen: dict[int, set[str]] = {}
    for _, _, number, _, name in waiting[:MOST_DRAWN]:
        chosen.setdefault(number, set()).add(name)
    return {number: frozenset(names) for number, names in chosen.items()}


def _drifts(chart: Json) -> bool:
    return any((chart["drift"][name] or {}).get("seen") for name in ("per_day", "per_c"))


def chart_section(group: Json, drawn: frozenset[str]) -> dict[str, Any]:
    """Return the part of a page about one group.

    Returns: What the macro ``chart_section`` of the template prints.
    """
    charts = group["parameters"]
    return {
        "title": group["title"],
        "place": group["place"],
        "verdict": group["verdict"],
        "state": group["state"],
        "pill": _PILLS[group["state"]],
        "drifts": any(_drifts(chart) for chart in charts),
        "rows": [_row(chart) for chart in charts],
        "charts": [
            {
                "name": chart["name"],
                "meaning": chart["meaning"],
                "verdict": chart["verdict"],
                "state": chart["state"],
                "pill": _PILLS[chart["state"]],
                "pictures": [Markup(one) for one in pictures(chart, group)],  # noqa: S704 - escaped when drawn
            }
            for chart in charts
            if chart["name"] in drawn
        ],
    }


def _row(chart: Json) -> dict[str, Any]:
    limits = [NOTHING] * 3
    if chart["lower"] is not None:
        limits = [with_uncertainty(chart[name], chart["sigma"])[0] for name in ("lower", "centre", "upper")]
    return {
        "name": chart["name"],
        "unit": chart["unit"],
        "limits": limits,
        "beyond": len(chart["beyond"]) if chart["lower"] is not None else NOTHING,
        "averages": len(chart["ewma"]["beyond"]) if chart["lower"] is not None else NOTHING,
        "per_day": _slope(chart["drift"]["per_day"], chart["unit"]),
        "per_c": _slope(chart["drift"]["per_c"], chart["unit"]),
        "state": chart["state"],
        "pill": _PILLS[chart["state"]],
    }


def _slope(slope: Json | None, unit: str) -> tuple[str, bool]:
    if slope is None:
        return NOTHING, False
    return slope["text"].replace(f" {unit} per", " per"), bool(slope["seen"])
