"""The command `panel`: pages that show runs and batches. Arguments and options only; `bench.panel` does the work."""

from __future__ import annotations

from pathlib import Path

import click

from bench.commands.options import ExistingFolder, epilog, page_options


@click.command(epilog=epilog("starbench panel", "starbench panel runs/night --port 8800 --no-browser"))
@click.argument("folder", required=False, type=ExistingFolder())
@page_options
def panel(
    folder: Path | None, port: int, host: str, token_file: Path | None, no_token: bool, no_browser: bool
) -> int:
    """Show the runs and batches in FOLDER in a browser; without FOLDER, those in runs/.

    The first line of the output is the address of the page, with a token: keep it to yourself. The pages show each run
    as it is, also one that began before the panel. Their buttons hold, release, skip, abort and answer, as `starbench
    tell` does. The panel uses no device: if it ends, or is killed, every run continues.
    """
    from bench.panel.panel_app import panel_app
    from bench.web.server import serve_pages
    from bench.web.tokens import page_token

    token = page_token(token_file, none=no_token)
    serve_pages(
        panel_app(folder or Path("runs")), host=host, port=port, token=token, open_browser=not no_browser
    )
    return 0
