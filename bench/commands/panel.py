"""The command `panel`: pages that show runs and batches. Arguments and options only; `bench.panel` does the work."""

from __future__ import annotations

from pathlib import Path

import click

from bench.commands.options import ExistingFile, ExistingFolder, epilog


@click.command(epilog=epilog("starbench panel", "starbench panel runs/night --port 8800 --no-browser"))
@click.argument("folder", required=False, type=ExistingFolder())
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    metavar="N",
    help="Port of the page.  [default: a free one]",
)
@click.option(
    "--host",
    default="127.0.0.1",
    metavar="NAME",
    help="Name or address at which to serve the page. Any other than this computer's own needs a token.  [default: "
    "127.0.0.1, this computer only]",
)
@click.option(
    "--token-file",
    type=ExistingFile(),
    help="File with the token that people must enter; only you may be able to read it.  [default: the environment "
    "variable STARBENCH_PAGE_TOKEN]",
)
@click.option("--no-browser", is_flag=True, help="Do not open the page in a browser.")
def panel(folder: Path | None, port: int, host: str, token_file: Path | None, no_browser: bool) -> int:
    """Show the runs and batches in FOLDER in a browser; without FOLDER, those in runs/.

    The first line of the output is the address of the page. The pages show each run as it is, also one that began
    before the panel. Their buttons hold, release, skip, abort and answer, as `starbench tell` does. The panel
    uses no device: if it ends, or is killed, every run continues.
    """
    from bench.panel.panel_app import panel_app
    from bench.web.server import serve_pages
    from bench.web.tokens import page_token

    token = page_token(token_file)
    serve_pages(
        panel_app(folder or Path("runs")), host=host, port=port, token=token, open_browser=not no_browser
    )
    return 0
