"""The report as HTML: joins results, tables, plots and images in one page, whose template escapes every text."""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jinja2
from markupsafe import Markup

from bench.records.history import Attempt, History
from bench.records.results import Results
from bench.records.run_facts import coverage_factor
from bench.report import calibration_tables, pose_tables, run_tables, text
from bench.report.calibration_tables import amplitude_rows, witness_rows
from bench.report.pose_tables import courses, state_diagram
from bench.report.run_tables import left, source_rows
from bench.report.text import NOTHING, TargetWords, moment, number, value_text, words_of
from bench.report.verdict import change, verdict
from bench.report.view_picture import PLOTS, ViewPicture, pictured_poses, thinned


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
    """Render the report as HTML from ``data`` alone; without plots and images (``draw``) the text is the same."""
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
        "budget_rows": calibration_tables.budget_rows(calibration, words),
        "combined": calibration_tables.combined(calibration),
        "overlap": calibration_tables.overlap(calibration),
        "own_factors": bool(calibration.get("coverage_factors")),
        "witnesses": witness_rows(calibration),
        "amplitudes": amplitude_rows(calibration),
        "not_included": calibration_tables.not_included(calibration),
        "checks": [
            *run_tables.check_rows(results.get("check")),
            *run_tables.boresight_rows(results),
            *calibration_tables.checks(results),
        ],
        "halves": bool(halves and halves.get("cameras")),
        "comparison": calibration_tables.comparison(results.get("comparison") or [], calibration),
    }


def _run_parts(results: Results, words: TargetWords) -> dict[str, Any]:
    """Return what the template prints about the run: its devices, poses, gates and files."""
    devices, poses = results.get("devices") or {}, results.get("poses") or []
    return {
        "identification": run_tables.identification(results),
        "software": run_tables.software(results),
        "conditions": run_tables.conditions(results.get("conditions") or {}),
        "devices": run_tables.devices(devices),
        "connections": run_tables.connections(devices),
        "devices_left": run_tables.left(results.get("devices_left") or []),
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
        from bench.report.pictures import pose_pictures
        from bench.report.plots import report_plots

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


@functools.cache
def environment() -> jinja2.Environment:
    """Return the templates' environment, made once: it escapes every value; an undefined name is an error."""
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


# The page of a run that failed or was aborted: why it ended, what to do, what was recorded.
#
# Text from the journal alone, so that a run without results has its page too.


class RecordedRow(NamedTuple):
    """A recording, as printed."""

    pose: str
    attempt: int
    verdict: str  # ``pass``, ``fail``, or ``marginal`` if it was not measured
    label: str
    stars: str
    events: str
    reasons: str
    capture: str


def render_ended(history: History, way_on: tuple[str, str], journal_head: str, namespace: str) -> str:
    """Render the page of a run that did not finish; the hash of its last line identifies the whole journal."""
    failure = history.failures[-1] if history.ended == "failed" and history.failures else None
    return (
        environment()
        .get_template("ended.html.j2")
        .render(
            run=history.started,
            how="failed" if history.ended == "failed" else "was aborted",
            what=failure["what"] if failure else history.why,
            where=failure["where"] if failure else "",
            remedy=failure["remedy"] if failure else "",
            way_on=way_on,
            identification=_identification(history),
            recordings=[_row(attempt) for attempt in history.attempts],
            accepted=len(history.accepted()),
            lost=sum(history.lost.values()),
            deviations=[*history.deviations, *history.holds],
            devices_left=left(history.devices_at_end),
            journal_head=journal_head,
            namespace=namespace,
        )
    )


def _identification(history: History) -> list[tuple[str, str]]:
    started, camera = history.started, history.devices.get("camera", {})
    place: Any = history.ledger
    return [
        ("Sequence", value_text(started.get("sequence"))),
        ("Station", value_text(started.get("station"))),
        ("Operator", value_text(started.get("operator"))),
        ("Camera", value_text(camera.get("serial"))),
        ("Begun", moment(history.started_utc)),
        ("Number of the run", value_text(place.get("number"))),
        ("Times resumed", number(history.resumed)),
    ]


def _row(attempt: Attempt) -> RecordedRow:
    checked, facts = attempt.checked, attempt.stored["facts"]
    verdict, label = ("marginal", "not measured") if checked is None else ("fail", "refused")
    if attempt.accepted:
        verdict, label = "pass", "accepted"
    return RecordedRow(
        attempt.pose_name or str(attempt.pose_index),
        attempt.attempt,
        verdict,
        label,
        NOTHING if checked is None else number(checked["stars"]),
        number(facts.get("events")),
        NOTHING
        if checked is None or not checked["reasons"]
        else "; ".join(why.removesuffix(".") for why in checked["reasons"]),
        attempt.stored["capture"],
    )
