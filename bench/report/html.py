"""The report as HTML: joins results, tables, plots and images in one page, whose template escapes every text."""

from __future__ import annotations

import base64
import functools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jinja2
from markupsafe import Markup, escape

from bench.measure.view_picture import ViewPicture
from bench.record.coverage import coverage_factor
from bench.record.history import History
from bench.record.results import Results
from bench.report import calibration_tables, pose_tables, run_tables
from bench.report.calibration_tables import witness_rows
from bench.report.phone_tables import label_cells
from bench.report.pictured_poses import pictured_poses, thinned
from bench.report.pose_tables import courses
from bench.report.residual_words import direction_text, rim_text
from bench.report.run_tables import left
from bench.report.verdict import change, verdict
from bench.wording import numbers, parameters
from bench.wording.numbers import NOTHING, moment, number, value_text
from bench.wording.target_words import TargetWords, words_of

_PRINTED: tuple[Callable[..., Any], ...] = (
    number, numbers.fixed, numbers.duration, numbers.with_uncertainty, coverage_factor, parameters.meaning_of,
    parameters.unit_of, parameters.unit_text, pose_tables.status_of, pose_tables.angles, pose_tables.motion,
    pose_tables.image_text,
)  # fmt: skip
"""What prints a value of results.json, for the templates."""


@dataclass(frozen=True)
class ReportData:
    """The data of a report."""

    results: Results
    # The poses that entered the calibration; without them the report has no images and no plots. All of them
    # are plotted. Images show the poses that `pictured_poses` selects, and only these need an image.
    views: Sequence[ViewPicture] = field(default_factory=tuple)
    # Hash of the journal's last line when the report was made. It identifies the whole journal.
    journal_head: str = ""


def render_report(data: ReportData) -> str:
    """Render the report as HTML from ``data`` alone."""
    results, words = data.results, words_of(data.results)
    calibration = results["calibration"]
    rim = rim_text(data.views, calibration["camera"], words)
    direction = direction_text(data.views, calibration["image_size"])
    parts = _result_parts(results, words) | _run_parts(results) | _graphics(data, words)
    return render_page(
        "report.html.j2",
        run=results["run"],
        words=words,
        takes_pictures=results["run"].get("camera") == "frame",
        verdict=verdict(results),
        journal_head=data.journal_head,
        stands_out=[text for text in (rim, direction) if text],
        **parts,
    )


def _result_parts(results: Results, words: TargetWords) -> dict[str, Any]:
    """Return what the template prints about the calibration."""
    calibration = results["calibration"]
    k = coverage_factor(calibration)
    return {
        "calibration": calibration,
        "k": numbers.exact(round(k, 2)),
        "passport": results.get("passport"),
        "inputs": run_tables.inputs(results),
        "change": change(results),
        "values": calibration_tables.values(calibration),
        "fit_statistics": calibration_tables.fit_statistics(calibration, words),
        "correlation": calibration_tables.correlation(calibration),
        "budget": calibration_tables.budget(calibration, words),
        "budget_rows": calibration_tables.budget_rows(calibration, words),
        "combined": calibration_tables.combined(calibration),
        "overlap": calibration_tables.overlap(calibration),
        "own_factors": bool(calibration.get("coverage_factors")),
        "witnesses": witness_rows(calibration),
        "not_included": calibration_tables.not_included(calibration),
        "checks": [
            *run_tables.check_rows(results.get("check")),
            *run_tables.boresight_rows(results),
            *calibration_tables.checks(results),
        ],
        "comparison": results.get("comparison") or [],
    }


def _run_parts(results: Results) -> dict[str, Any]:
    """Return what the template prints about the run: its devices, poses, gates and files."""
    devices, poses = results.get("devices") or {}, results.get("poses") or []
    return {
        "identification": run_tables.identification(results),
        "software": run_tables.software(results),
        "conditions": run_tables.conditions(results.get("conditions") or {}),
        "devices": run_tables.devices(devices),
        "connections": run_tables.connections(devices),
        "devices_left": run_tables.left(results.get("devices_left") or []),
        "poses": poses,
        "explained": pose_tables.explained(poses),
        "recordings": [(pose["name"], attempt) for pose in poses for attempt in pose.get("attempts") or []],
        "gates": pose_tables.gates(results.get("gates") or []),
        "deviations": run_tables.deviations(results),
        "holds": [str(hold) for hold in results.get("holds") or ()],
        "sources": results.get("sources") or [],
    }


def _graphics(data: ReportData, words: TargetWords) -> dict[str, Any]:
    """Return the plots and images."""
    from bench.report.plots import report_plots
    from bench.report.pose_images import pose_pictures

    pictured = pictured_poses(data.results)
    return {
        "plots": report_plots(data.results, data.views),
        "stars": _star_counts(data.views),
        "pictured": (numbers.number(pictured.shown), numbers.number(pictured.total)),
        "pictures": pose_pictures([view for view in data.views if view.name in pictured.names], words),
        "courses": courses(data.results.get("untils") or []),
    }


def render_page(template: str, **values: Any) -> str:
    """Render a page from its template and its values; a phone shows its tables as cards."""
    return label_cells(environment().get_template(template).render(**values))


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
    made.filters["with_commands"] = _with_commands
    made.globals |= {"NOTHING": NOTHING} | {printed.__name__: printed for printed in _PRINTED}
    return made


def _star_counts(views: Sequence[ViewPicture]) -> tuple[str, str]:
    """Return the number of stars that the plots show, and the number of all stars."""
    drawn, every = (sum(len(view.ids) for view in some) for some in (thinned(views), views))
    return numbers.number(drawn), numbers.number(every)


def _with_commands(message: str) -> Markup:
    """Return a message as HTML, with what stands between backticks as code, as a terminal shows it."""
    return Markup(re.sub("`([^`]*)`", r"<code>\1</code>", str(escape(message))))  # noqa: S704 - escaped


def _css_text(value: object) -> str:
    """Replace every character that has a meaning in a CSS string."""
    return re.sub(r"[^A-Za-z0-9 ._-]", "?", str(value))


def render_ended(
    history: History,
    way_on: tuple[str, str],
    journal_head: str,
    namespace: str,
    pictures: Sequence[tuple[str, bytes]] = (),
) -> str:
    """Render the page of a run that did not finish; the hash of its last line identifies the whole journal.

    ``pictures`` are captions and images, PNG: the recording that was refused last, and a good one beside it.
    """
    failure = history.failure
    return render_page(
        "ended.html.j2",
        what=failure.what if failure else history.why,
        where=failure.where if failure else "",
        remedy=failure.remedy if failure else "",
        run=history.started,
        how="failed" if history.ended == "failed" else "was aborted",
        way_on=way_on,
        pictures=[(caption, base64.b64encode(png).decode()) for caption, png in pictures],
        identification=_identification(history),
        recordings=history.attempts,
        accepted=len(history.accepted()),
        lost=sum(history.lost.values()),
        deviations=[*history.deviations, *history.holds],
        devices_left=left(history.devices_at_end),
        journal_head=journal_head,
        namespace=namespace,
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
