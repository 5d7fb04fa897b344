"""The page of a comparison: one HTML file without scripts and without files beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from bench import __version__
from bench.compare.plots import direction_plot, focal_plot
from bench.compare.summary import PARAMETERS
from bench.compare.table import HEADS, parameter_rows, table_rows
from bench.report.html import environment

#: The numbers that the paper prints for its one real camera, without a truth (arXiv:2512.16092, Table 1) are not
#: repeated here; docs/comparison.md discusses them.


def render_page(
    summary: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], true: Mapping[str, float]
) -> str:
    """Render the page of a comparison.

    Parameters
    ----------
    summary
        From `bench.compare.summary.summarise`.
    rows
        All rows.
    true
        True values of the camera.

    Returns
    -------
    str
        HTML.
    """
    names = [column["settings"]["name"] for column in summary["columns"]]
    solved = [name for name in names if any(row["column"] == name and "error" not in row for row in rows)]
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
            table=table_rows(summary),
            parameters=PARAMETERS,
            values=parameter_rows(summary, PARAMETERS),
            truth=[f"{true[name]:g}" if name in true else "-" for name in PARAMETERS],
            failures=failures,
            direction=Markup(direction_plot(solved, rows)) if solved else "",  # noqa: S704 - our own SVG
            focal=Markup(focal_plot(solved, rows)) if solved else "",  # noqa: S704 - our own SVG
            software=__version__,
        )
    )
