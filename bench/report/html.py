"""The report as HTML: joins results, tables, plots and pictures in one page.

Knows the results' structure and the page's template; formats numbers by `text`, rows of tables by `run_tables` and
`calibration_tables`. Nothing a results file holds can become markup: the template escapes everything.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from bench.report import calibration_tables, run_tables, text
from bench.report.choice import pictured_poses
from bench.report.pictures import ViewPicture, pose_pictures, thinned
from bench.report.plots import (
    coverage,
    deviations_from_truth,
    residual_cloud,
    residual_vectors,
    uncertainty_contours,
)
from bench.report.walk import state_diagram
from calib.model.camera import PINHOLE, CameraModel
from calib.uncertainty.projection_uncertainty import camera_difference, projection_uncertainty

_GRAPHIC_TAGS = frozenset({"section", "svg", "style"})
"""Elements whose text comes with pictures and plots; in the template, sections hold nothing else."""


@dataclass(frozen=True)
class ReportData:
    """All that a report shows.

    Attributes
    ----------
    results
        Content of results.json.
    views
        The poses that entered the calibration; none leaves out pictures and plots. All are plotted; pictures are of
        those that `pictured_poses` names, and only these need an image.
    journal_head
        Hash of the journal's last line when the report was made: it stands for the whole journal.
    """

    results: Mapping[str, Any]
    views: Sequence[ViewPicture] = field(default_factory=tuple)
    journal_head: str = ""


def render_report(data: ReportData) -> str:
    """Render the report.

    Parameters
    ----------
    data
        What to show.

    Returns
    -------
    str
        A complete HTML document; a function of ``data`` alone.

    Raises
    ------
    KeyError
        When the results lack what every result has: ``run`` and ``calibration``.
    """
    results = data.results
    calibration = results["calibration"]
    k = calibration_tables.coverage_factor(calibration)
    pictured = pictured_poses(results)
    pictures = pose_pictures([view for view in data.views if view.name in pictured.names])
    return (
        environment()
        .get_template("report.html.j2")
        .render(
            run=results["run"],
            takes_pictures=results["run"].get("camera") == "frame",
            identification=run_tables.identification(results),
            software=run_tables.software(results),
            journal_head=data.journal_head,
            calibration=calibration,
            values=calibration_tables.values(calibration),
            fit_statistics=calibration_tables.fit_statistics(calibration),
            correlation=calibration_tables.correlation(calibration),
            planar=calibration_tables.planar_comparison(calibration, results.get("planar")),
            candidates=calibration_tables.candidates(calibration),
            budget=calibration_tables.budget(calibration),
            checks=calibration_tables.checks(results),
            halves=bool((results.get("halves") or {}).get("cameras")),
            comparison=calibration_tables.comparison(results.get("comparison") or [], k),
            conditions=run_tables.conditions(results.get("conditions") or {}),
            devices=run_tables.devices(results.get("devices") or {}),
            poses=run_tables.poses(results.get("poses") or []),
            recordings=run_tables.recordings(results.get("poses") or []),
            gates=run_tables.gates(results.get("gates") or []),
            alerts=run_tables.alerts(results),
            deviations=list(results.get("deviations") or []),
            walk=_markup(state_diagram(results["states"])) if results.get("states") else "",
            plots=_all_plots(data),
            stars=_star_counts(data.views),
            pictured=(text.number(pictured.shown), text.number(pictured.total)),
            pictures=[(_markup(svg), name) for svg, name in pictures],
            k=text.exact(round(k, 2)),
        )
    )


def printed_text(html: str) -> list[str]:
    """Give the words and numbers a reader sees in a report, without those in pictures and plots.

    Two reports of the same results print the same, whoever drew their pictures.

    Parameters
    ----------
    html
        A report.

    Returns
    -------
    list of str
        Its texts in order, spaces normalised.
    """
    reader = _TextReader()
    reader.feed(html)
    reader.close()
    return reader.texts


class _TextReader(HTMLParser):
    """Collects text outside of pictures and styles."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []
        self._open_graphics: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Begin to look away at what is drawn."""
        del attrs
        if tag in _GRAPHIC_TAGS:
            self._open_graphics.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Look again."""
        if self._open_graphics and self._open_graphics[-1] == tag:
            self._open_graphics.pop()

    def handle_data(self, data: str) -> None:
        """Take a text."""
        shown = " ".join(data.split())
        if shown and not self._open_graphics:
            self.texts.append(shown)


@functools.cache
def environment() -> jinja2.Environment:
    """Give the templates' environment: everything is escaped, and what is missing is an error."""
    made = jinja2.Environment(
        loader=jinja2.PackageLoader("bench.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["css_text"] = _css_text
    return made


def _uncertainty_plot(results: Mapping[str, Any]) -> str:
    """Draw the projection uncertainty that the camera's covariance implies; nothing where there is none.

    Beside it, where halves of the poses were calibrated apart, how differently the two project.
    """
    calibration = results["calibration"]
    values, covariance = dict(calibration["camera"]), calibration["covariance"]
    names = [name for name in values if name in covariance["names"]]
    if names != list(values):
        return ""
    at = [covariance["names"].index(name) for name in names]
    matrix = np.array(covariance["matrix"])[np.ix_(at, at)]
    size = tuple(calibration["image_size"])
    found = projection_uncertainty(_camera(values, size), matrix)
    difference = None
    if cameras := (results.get("halves") or {}).get("cameras"):
        first, second = (_camera(half, size) for half in cameras)
        difference = camera_difference(first, second)
    return uncertainty_contours(found, calibration_tables.coverage_factor(calibration), difference)


def _camera(values: Mapping[str, float], image_size: tuple[int, int]) -> CameraModel:
    """Return a camera as results keep it."""
    lens = {name: value for name, value in values.items() if name not in PINHOLE}
    fx, fy, cx, cy = (values[name] for name in PINHOLE)
    return CameraModel(fx, fy, cx, cy, image_size, lens)


def _markup(svg: str) -> Markup:
    """Let a drawing of our own through as it is; the names in it were escaped when it was drawn."""
    return Markup(svg)  # noqa: S704


def _css_text(value: object) -> str:
    """Keep of a text what can stand in a CSS string without becoming CSS."""
    return re.sub(r"[^A-Za-z0-9 ._-]", "?", str(value))


def _star_counts(views: Sequence[ViewPicture]) -> tuple[str, str]:
    """Say of how many stars how many are drawn in the plots."""
    drawn, every = (sum(len(view.ids) for view in some) for some in (thinned(views), views))
    return text.number(drawn), text.number(every)


def _all_plots(data: ReportData) -> dict[str, Markup]:
    """Draw what can be drawn, by name; nothing stands for what cannot."""
    plots = dict.fromkeys(("truth", "uncertainty", "vectors", "cloud", "coverage"), "")
    compared = data.results.get("comparison") or []
    if compared:
        names = [row["name"] for row in compared]
        plots["truth"] = deviations_from_truth(names, [row["error_sigmas"] for row in compared])
    camera = data.results["calibration"]["camera"]
    if data.views:
        plots["uncertainty"] = _uncertainty_plot(data.results)
    if any(len(view.detected) for view in data.views):
        width, height = data.results["calibration"]["image_size"]
        centre = (camera["cx"], camera["cy"])
        plots["vectors"] = residual_vectors(data.views, (width, height))
        plots["cloud"] = residual_cloud(data.views, centre)
        plots["coverage"] = coverage(data.views, (width, height), centre)
    return {name: _markup(svg) for name, svg in plots.items()}
