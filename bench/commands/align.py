"""The command `starbench align`: arguments and options only; `bench.align` does the work."""

from __future__ import annotations

from pathlib import Path

import click

from bench.commands.options import SEED, STATION, epilog, page_options


@click.command(
    epilog=epilog(
        "starbench align --station my_bench.yaml",
        "starbench align --station simulated --port 8800 --no-browser",
        status="0 ended, every device confirmed a safe state, 1 a device did not, 2 invalid argument or file.",
    )
)
@STATION
@page_options
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
    no_token: bool,
    no_browser: bool,
    seed: int,
    settings: tuple[str, ...],
) -> int:
    """Aim and focus the camera, and set light and biases, on a page with the live picture.

    The first line printed is the address of the page, with a token: keep it to yourself. Nothing moves and no light
    goes on until you ask for it. Ctrl-C stops the stage at once, switches the light off, and ends.
    """
    from bench.align.serve import align_on_page
    from bench.web.tokens import page_token

    token = page_token(token_file, none=no_token)
    return align_on_page(
        station, settings, seed=seed, host=host, port=port, token=token, open_browser=not no_browser
    )
