"""The commands `align` and `panel`: arguments and options of the pages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from bench.commands.options import STATION, ExistingFolder, command, page_options


@command(
    "starbench align --station my_bench.yaml",
    "starbench align --station simulated --port 8800 --no-browser",
    status="0 ended, every device confirmed a safe state, 1 a device did not, 2 invalid argument or file.",
)
@STATION
@page_options
def align(station: str, **page: Any) -> int:
    """Aim and focus the camera, and set light and biases, on a page with the live picture.

    The first line printed is the address of the page, with a token: keep it to yourself. Nothing moves and no light
    goes on until you ask for it. Ctrl-C stops the stage at once, switches the light off, and ends.
    """
    from bench.extras.pages.align.serve import align_on_page

    return align_on_page(station, **_served(**page))


@command(
    "starbench panel",
    "starbench panel runs/night --port 8800 --no-browser",
)
@click.argument("folder", required=False, type=ExistingFolder())
@page_options
def panel(
    folder: Path | None,
    **page: Any,
) -> int:
    """Show the runs and batches in FOLDER in a browser; without FOLDER, those in runs/.

    The first line of the output is the address of the page, with a token: keep it to yourself. The pages show each run
    as it is, also one that began before the panel. Their buttons do what `starbench tell` does: hold, release, skip,
    abort and answer. The panel uses no device: if it ends, or is killed, every run continues.
    """
    from bench.extras.pages.panel.panel_app import panel_app
    from bench.extras.pages.web.server import serve_pages

    serve_pages(panel_app(folder or Path("runs")), **_served(**page))
    return 0


def _served(*, port: int, host: str, no_token: bool, no_browser: bool) -> dict[str, Any]:
    """Return how a page is served, by the options of `page_options`."""
    from bench.extras.pages.web.token import page_token

    return {"host": host, "port": port, "token": page_token(none=no_token), "open_browser": not no_browser}
