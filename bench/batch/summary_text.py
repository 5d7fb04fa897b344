"""How a batch ended, as lines of text for terminal and mail: every run, and each camera's parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bench.records.run_facts import REPEATS_TEXT, factors_text
from bench.report.text import unit_text, with_uncertainty

_K = 2.0  # of a change per hour


def summary_lines(summary: Mapping[str, Any]) -> Iterator[str]:
    """Return the end of a batch, its runs, and means with their U; ``summary`` is the content of summary.json."""
    how = summary["how"] or "not ended"
    rehearsal = "REHEARSAL of batch" if summary["rehearsal"] else "Batch"
    yield f"{rehearsal} {summary['queue']}: {how}{': ' if summary['why'] else ''}{summary['why']}"
    for item in summary["items"]:
        why = f": {item['why']}" if item["why"] else ""
        verdict = f"  {item['conformity']}" if item.get("conformity") else ""
        attempts = f"{item['attempts']} attempt{'' if item['attempts'] == 1 else 's'}"
        yield f"  {item['item']:<30} {item['how']:<10} {attempts}{verdict}{why}"
    for camera in summary["cameras"]:
        yield from _trend_lines(camera)


def _trend_lines(camera: Mapping[str, Any]) -> list[str]:
    """Return one line per parameter of a camera, if more than one of its runs has a result."""
    lines = []
    for trend in camera["parameters"]:
        mean, expanded = with_uncertainty(trend["mean"], trend["expanded"])
        unit = unit_text(trend["name"])
        line = f"  {trend['name']:<3} {mean:>12} ± {expanded:<9} {unit:<3} Birge {trend['birge']:.2f}"
        line += "  REPEATS" if trend["repeats"] else ""
        if trend["per_hour"] is not None:
            slope, slope_u = with_uncertainty(trend["per_hour"]["value"], _K * trend["per_hour"]["sigma"])
            line += f"  {slope:>10} ± {slope_u} per hour{'  CHANGES' if trend['per_hour']['seen'] else ''}"
        lines.append(line)
    if lines:
        factors = factors_text(trend["coverage_factor"] for trend in camera["parameters"])
        head = f"Camera {camera['camera']}, {camera['model']} model, {len(camera['runs'])} results; U with {factors}:"
        lines.insert(0, head)
    if any(trend["repeats"] for trend in camera["parameters"]):
        lines.append(f"  REPEATS: {REPEATS_TEXT}")
    return lines
