"""The report as HTML: joins results, tables, plots and images in one page.

`text` formats numbers; modules that end in `_tables` make the rows of the tables. No text from
a results file can become markup: the template escapes all of it.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser
from typing import Any

import jinja2
from markupsafe import Markup

from bench.records.estimates import coverage_factor
from bench.records.results import Results
from bench.report import budget_tables, calibration_tables, device_tables, pose_tables, run_tables, text
from bench.report.bench_knowledge import source_rows
from bench.report.calibration_tables import amplitude_rows, witness_rows
from bench.report.change_rows import change
from bench.report.choice import PLOTS, pictured_poses
from bench.report.course import courses
from bench.report.target_words import TargetWords, words_of
from bench.report.verdict import verdict
from bench.report.view_picture import ViewPicture, thinned
from bench.report.walk import state_diagram

_GRAPHIC_TAGS = frozenset({"section", "svg", "style"})
"""Elements whose text belongs to images and plots; in the template, sections contain nothing else."""


@dataclass(frozen=True)
class ReportData:
    """The data of a report."""

    results: Results
    # The poses that entered the calibration; without them the report has no images and no plots. All of them
    # are plotted. Images show the poses that `pictured_poses` selects, and only these need an image.
    views: Sequence[ViewPicture] = field(default_factory=tuple)
    # Hash of the journal's last line when the report was made. It identifies the whole journal.
    journal_head: str = ""


def render_report(data: ReportData, *, draw: bool = True) -> str:
    """Render the report.

    draw: Whether to draw plots and images; without them the report holds the same text (`printed_text`).
    Returns: A complete HTML document that depends on ``data`` alone.
    Raises KeyError: When the results lack ``run`` or ``calibration``.
    """
    results, words = data.results, words_of(data.results)
    parts = _result_parts(results, words) | _run_parts(results, words) | _graphics(data, words, draw=draw)
    return (
        environment()
        .get_template("report.html.j2")
        .render(
            run=results["run"],
            words=words,
            takes_pictures=results["run"].get("camera") == "frame",
            verdict=verdict(results),
            journal_head=data.journal_head,
            **parts,
        )
    )


def _result_parts(results: Results, words: TargetWords) -> dict[str, Any]:
    """Return what the template prints about the calibration."""
    calibration, halves = results["calibration"], results.get("halves")
    k = coverage_factor(calibration)
    return {
        "calibration": calibration,
        "k": text.exact(round(k, 2)),
        "passport": results.get("passport"),
        "inputs": run_tables.inputs(results),
        "change": change(results),
        "values": calibration_tables.values(calibration),
        "fit_statistics": calibration_tables.fit_statistics(calibration, words),
        "correlation": calibration_tables.correlation(calibration),
        "planar": calibration_tables.planar_comparison(calibration, results.get("planar")),
        "candidates": calibration_tables.candidates(calibration),
        "budget": calibration_tables.budget(calibration, words),
        "budget_rows": budget_tables.budget_rows(calibration, words),
        "combined": budget_tables.combined(calibration),
        "overlap": budget_tables.overlap(calibration),
        "own_factors": bool(calibration.get("coverage_factors")),
        "witnesses": witness_rows(calibration),
        "amplitudes": amplitude_rows(calibration),
        "not_included": budget_tables.not_included(calibration),
        "checks": calibration_tables.checks(results),
        "halves": bool(halves and halves.get("cameras")),
        "comparison": calibration_tables.comparison(results.get("comparison") or [], calibration),
    }


def _run_parts(results: Results, words: TargetWords) -> dict[str, Any]:
    """Return what the template prints about the run: its devices, poses, gates and files."""
    devices, poses = results.get("devices") or {}, results.get("poses") or []
    return {
        "identification": run_tables.identification(results),
        "software": run_tables.software(results),
        "conditions": device_tables.conditions(results.get("conditions") or {}),
        "devices": device_tables.devices(devices),
        "connections": device_tables.connections(devices),
        "devices_left": device_tables.left(results.get("devices_left") or []),
        "poses": pose_tables.poses(poses),
        "recordings": pose_tables.recordings(poses, words),
        "gates": pose_tables.gates(results.get("gates") or [], words),
        "deviations": run_tables.deviations(results),
        "holds": [str(hold) for hold in results.get("holds") or ()],
        "sources": source_rows(results.get("sources") or []),
        "walk": _markup(state_diagram(results["states"])) if results.get("states") else "",
    }


def _graphics(data: ReportData, words: TargetWords, *, draw: bool) -> dict[str, Any]:
    """Return the plots and images; without ``draw``, the same parts without them."""
    pictured = pictured_poses(data.results)
    plots: dict[str, str] = dict.fromkeys(PLOTS, "")
    pictures: list[tuple[str, str]] = []
    if draw:
        from bench.report.figures import report_plots
        from bench.report.pictures import pose_pictures

        plots = report_plots(data.results, data.views)
        pictures = pose_pictures([view for view in data.views if view.name in pictured.names], words)
    found = courses(data.results.get("untils") or [], draw=draw)
    return {
        "plots": {name: _markup(svg) for name, svg in plots.items()},
        "stars": _star_counts(data.views),
        "pictured": (text.number(pictured.shown), text.number(pictured.total)),
        "pictures": [(_markup(svg), name) for svg, name in pictures],
        "courses": [replace(course, plot=_markup(course.plot)) for course in found],
    }


def printed_text(html: str) -> list[str]:
    """Extract the texts and numbers of a report, without those in images and plots.

    Two reports of the same results have the same texts, even if another version of a library encoded their images.

    Returns: Its texts in order, with spaces normalised.
    """
    reader = _TextReader()
    reader.feed(html)
    reader.close()
    return reader.texts


class _TextReader(HTMLParser):
    """Collects the text outside of images, plots and styles."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []
        self._open_graphics: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Enter an element; the text of a graphic element is ignored."""
        del attrs
        if tag in _GRAPHIC_TAGS:
            self._open_graphics.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Leave an element."""
        if self._open_graphics and self._open_graphics[-1] == tag:
            self._open_graphics.pop()

    def handle_data(self, data: str) -> None:
        """Collect a text."""
        shown = " ".join(data.split())
        if shown and not self._open_graphics:
            self.texts.append(shown)


@functools.cache
def environment() -> jinja2.Environment:
    """Return the environment of the templates: it escapes every value, and an undefined name is an error.

    Returns: Made once in a process.
    """
    made = jinja2.Environment(
        loader=jinja2.PackageLoader("bench.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["css_text"] = _css_text
    return made


def _star_counts(views: Sequence[ViewPicture]) -> tuple[str, str]:
    """Return the number of stars that the plots show, and the number of all stars."""
    drawn, every = (sum(len(view.ids) for view in some) for some in (thinned(views), views))
    return text.number(drawn), text.number(every)


def _markup(svg: str) -> Markup:
    """Mark one of our own drawings as safe markup; the names in it were escaped when it was drawn."""
    return Markup(svg)  # noqa: S704


def _css_text(value: object) -> str:
    """Replace every character that has a meaning in a CSS string."""
    return re.sub(r"[^A-Za-z0-9 ._-]", "?", str(value))
