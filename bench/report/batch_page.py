"""The summary of a batch as one HTML page: runs, failures with their reasons, means of each camera, control charts.

It needs ``summary.json`` alone; the template escapes every text.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime, tzinfo
from functools import partial
from typing import Any
from zoneinfo import ZoneInfo

from bench.base.pasteable import pasteable
from bench.record.coverage import REPEATS_TEXT, factors_text
from bench.record.summaries import (
    WITHOUT_END,
    AgreedData,
    BatchSummary,
    CameraData,
    ItemData,
    newest_place,
)
from bench.report.control_chart import chart_section, choose_drawn
from bench.report.html import render_page
from bench.report.timeline import timeline
from bench.wording.numbers import NOTHING, duration, fixed, number, with_uncertainty

_SCATTER_SIGMAS = 3.0
"""A Birge ratio is significant if it exceeds 1 by more than this number of its own standard deviations: by chance, one
in 700 does."""


def render_batch(summary: BatchSummary) -> str:
    """Render a complete HTML document that loads nothing and depends on ``summary`` (summary.json) alone."""
    zone = _zone(summary)
    failures = [item for item in summary["items"] if item["how"] not in {"finished", *WITHOUT_END}]
    return render_page(
        "batch.html.j2",
        summary=summary,
        zone=_zone_name(summary, zone),
        headline=_headline(summary, zone),
        figures=_key_figures(summary),
        timeline=timeline(summary["items"], zone),
        failures=[(item["item"], item["how"], item["why"] or NOTHING, item["attempts"]) for item in failures],
        resumes=_resumes(summary, failures),
        not_begun=[item["item"] for item in summary["items"] if item["how"] == "not begun"],
        not_kept=[item["item"] for item in summary["items"] if item["conformity"] == "FAIL"],
        remarks=[
            (item["item"], text)
            for item in summary["items"]
            for text in [*item.get("causes", ()), *item["goals_missed"]]
        ],
        withdrawn=[item["item"] for item in summary["items"] if item["how"] == "withdrawn"],
        cameras=[_camera_section(camera) for camera in summary["cameras"]],
        rows=[item for item in summary["items"] if item["begun_utc"]],
        outcome_of=_outcome,
        local=partial(_local, zone=zone),
        charts=_chart_sections(summary),
        requests=summary["requests"],
        ledger=_newest_line(summary["items"]),
    )


def _resumes(summary: BatchSummary, failures: Sequence[ItemData]) -> list[str]:
    """Return the commands by which runs without a result go on, from the folder of the batch; none while it works."""
    if summary["rehearsal"] or summary["how"] != "failed":
        return []
    return [pasteable("resume", item["folder"]) for item in failures if item["begun_utc"]]


def _zone(summary: BatchSummary) -> tzinfo | None:
    """Return the time zone of the page: the queue's, otherwise this computer's at the begin of the batch."""
    if summary["zone"]:
        return ZoneInfo(summary["zone"])
    begun = summary["begun_utc"]
    return datetime.fromisoformat(begun).astimezone().tzinfo if begun else None


def _zone_name(summary: BatchSummary, zone: tzinfo | None) -> str:
    if summary["zone"]:
        return summary["zone"]
    if not summary["begun_utc"]:
        return "UTC"
    begun = datetime.fromisoformat(summary["begun_utc"]).astimezone(zone)
    return begun.strftime("UTC%z").removesuffix("+0000")


def _headline(summary: BatchSummary, zone: tzinfo | None) -> str:
    begun, ended = _local(summary["begun_utc"], zone), _local(summary["ended_utc"], zone)
    same_day = begun[:10] == ended[:10]
    return f"{begun} to {ended[11:] if same_day else ended}"


def _local(utc: str | None, zone: tzinfo | None) -> str:
    return f"{datetime.fromisoformat(utc).astimezone(zone):%Y-%m-%d %H:%M}" if utc else NOTHING


def _key_figures(summary: BatchSummary) -> list[tuple[str, str]]:
    """Return the large numbers at the top of the page, each with its meaning."""
    totals = summary["totals"]
    by_end, working = totals["by_end"], duration(3600.0 * totals["working_hours"])
    without = sum(n for how, n in by_end.items() if how not in {"finished", *WITHOUT_END})
    return [
        (f"{by_end.get('finished', 0)} of {totals['runs']}", "runs with a result"),
        (str(without), "runs without a result"),
        (str(by_end.get("not begun", 0)), "runs not begun"),
        (number(totals["poses"]), f"poses, in {number(totals['recordings'])} recordings"),
        (str(totals["deviations"]), "deviations from the sequences"),
        (duration(3600.0 * totals["hours"]), f"in total, {working} in runs"),
    ]


def _newest_line(items: Sequence[ItemData]) -> str:
    """Return the place of the newest run in the ledger as text; empty if no run is in a ledger."""
    place = newest_place(items)
    return f"run {place[0]} of this bench, line {place[1]}" if place else ""


def _outcome(item: ItemData) -> tuple[str, str]:
    """Return the colour and the words of how a run ended: as its report, green only without any reservation."""
    if item["how"] != "finished":
        colours = {"in progress": "", "aborted": "marginal", "cut off": "marginal"}
        return colours.get(item["how"], "fail"), item["how"]
    if item["conformity"] == "FAIL":
        return "fail", "FAIL"
    if item.get("causes") or item["goals_missed"]:
        return "marginal", "reservations"
    return "pass", "finished"


def _chart_sections(summary: BatchSummary) -> list[dict[str, Any]]:
    """Return the control charts of the cameras with enough runs."""
    groups = [group for group in summary["charts"]["groups"] if group["state"] != "too few"]
    drawn = choose_drawn(groups)
    return [chart_section(group, drawn.get(place, frozenset())) for place, group in enumerate(groups)]


def _camera_section(camera: CameraData) -> dict[str, Any]:
    """Return the part of the page about one camera."""
    runs, parameters = camera["runs"], camera["parameters"]
    return {
        "serial": camera["camera"] or NOTHING,
        "model": camera["model"],
        "runs": runs,
        "means": [_mean_row(agreed, runs) for agreed in parameters],
        "factors": factors_text(agreed["coverage_factor"] for agreed in parameters),
        "verdict": _verdict(parameters, runs),
    }


def _scatters(agreed: AgreedData, runs: int) -> bool:
    """Whether the runs scatter significantly more than their uncertainties predict.

    A Birge ratio has a standard deviation of about 1 / sqrt(2 (n - 1)) (Birge, Phys. Rev. 40 (1932) 207).
    """
    return agreed["birge"] > 1.0 + _SCATTER_SIGMAS / math.sqrt(2.0 * (runs - 1))


def _mean_row(agreed: AgreedData, runs: int) -> dict[str, str]:
    mean, expanded = with_uncertainty(agreed["mean"], agreed["expanded"])
    label = "scatters" if _scatters(agreed, runs) else "repeats" if agreed["repeats"] else "agrees"
    return {
        "name": agreed["name"],
        "mean": mean,
        "expanded": expanded,
        "birge": fixed(agreed["birge"], 2),
        "verdict": "pass" if label == "agrees" else "marginal",
        "label": label,
    }


def _verdict(parameters: Sequence[AgreedData], runs: int) -> str:
    """Summarise in one sentence how the results agree."""
    if not parameters:
        return "Only one run has a result, so there is no comparison."
    findings = []
    if scattered := [parameter["name"] for parameter in parameters if _scatters(parameter, runs)]:
        findings.append(f"{', '.join(scattered)} scattered more than the stated uncertainties predict")
    if repeating := [parameter["name"] for parameter in parameters if parameter["repeats"]]:
        findings.append(f"{', '.join(repeating)}: {REPEATS_TEXT.rstrip('.')}")
    if not findings:
        return f"All {runs} results agree within their uncertainties."
    return f"{'; '.join(findings)}."
