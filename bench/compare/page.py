"""The page of a comparison: one HTML file without scripts and without files beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from bench import __version__
from bench.compare.paper import PAPER_NAMES, PAPER_TABLE_1
from bench.compare.plots import direction_plot, focal_plot, images_plot
from bench.compare.spec import STAR_METHODS
from bench.compare.summary import PARAMETERS
from bench.compare.table import DATA_HEADS, HEADS, data_rows, parameter_rows, table_rows
from bench.report.html import environment

TABLE_1 = "Table 1"
"""Name of the comparison that makes the paper's Table 1 again; its page shows the paper's numbers as well."""


def render_page(
    summary: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], true: Mapping[str, float]
) -> str:
    """Render the page of a comparison.

    summary: From `bench.compare.summary.summarise`.
    true: True values of the camera.
    """
    simulated = [column for column in summary["columns"] if not column["settings"]["data"]]
    methods = {column["settings"]["name"]: column["settings"]["method"] for column in simulated}
    have = {row["column"] for row in rows if "error" not in row}
    solved = {name: method for name, method in methods.items() if name in have}
    failures = [
        (column["settings"]["name"], failed["times"], failed["why"])
        for column in summary["columns"]
        for failed in column["failed"]
    ]
    return (
        environment()
        .get_template("comparison.html.j2")
        .render(
            summary=summary,
            heads=HEADS,
            simulated=bool(simulated),
            data_heads=DATA_HEADS,
            data_table=data_rows(summary),
            paper_names=PAPER_NAMES,
            paper=PAPER_TABLE_1 if summary["name"] == TABLE_1 else (),
            by_images=Markup(images_plot(simulated)),  # noqa: S704 - our own SVG
            table=table_rows(summary),
            begins=_begins_group(simulated),
            parameters=PARAMETERS,
            values=parameter_rows(summary, PARAMETERS),
            truth=[f"{true[name]:g}" if name in true else "-" for name in PARAMETERS],
            failures=failures,
            direction=Markup(direction_plot(solved, rows)) if solved else "",  # noqa: S704 - our own SVG
            focal=Markup(focal_plot(solved, rows)) if solved else "",  # noqa: S704 - our own SVG
            software=__version__,
        )
    )


def _begins_group(columns: Sequence[Mapping[str, Any]]) -> list[bool]:
    """Return for each column whether it has another kind of target or another collimator than the one before."""
    kinds = []
    for column in columns:
        settings = column["settings"]
        stars = settings["method"] in STAR_METHODS and settings["method"] != "angles"
        kinds.append(settings["collimator"] if stars else settings["method"])
    return [number > 0 and kind != kinds[number - 1] for number, kind in enumerate(kinds)]
