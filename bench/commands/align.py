"""The command `starbench align`: arguments and options only; `bench.align` does the work."""

from __future__ import annotations

from pathlib import Path

import click

from bench.commands.options import SEED, STATION, ExistingFile, epilog


@click.command(
    epilog=epilog(
        "starbench align --station my_bench.yaml",
        "starbench align --station simulated --port 8800 --no-browser",
        status="0 ended, every device confirmed a safe state, 1 a device did not, 2 invalid argument or file.",
    )
)
@STATION
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="Port of the page.  [default: a free one]"
)
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address at which the page is served. Other addresses than the default need a token.",
)
@click.option("--token-file", type=ExistingFile(), help="File with the token. Default: STARBENCH_PAGE_TOKEN.")
@click.option("--no-browser", is_flag=True, help="Do not open a browser.")
@click.option("--seed", type=SEED, metavar="N", default=1, help="Random seed of the simulated bench.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="PATH=VALUE",
    help="Override a setting of the station file, e.g. camera.biases.bias_diff_on=20. Can be given several times.",
)
def align(
    station: str,
    port: int,
    host: str,
    token_file: Path | None,
    no_browser: bool,
    seed: int,
    settings: tuple[str, ...],
) -> int:
    """Aim and focus the camera, and set light and biases, on a page with the live picture.

    The first line printed is the address of the page. Nothing moves and no light goes on until you ask for it. Ctrl-C
    stops the stage at once, switches the light off, and ends.
    """
    from bench.align.serve import align_on_page

    return align_on_page(
        station, settings, seed=seed, host=host, port=port, token_file=token_file, open_browser=not no_browser
    )
