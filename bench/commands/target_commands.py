"""The commands about the target of a station: draw its reticle, and show what it is good for."""

from __future__ import annotations

from pathlib import Path

import click

from bench.commands.options import JSON, NewFile, Number

_STATION = click.option(
    "--station",
    "-s",
    required=True,
    help="Station file, or the name of a station that is included (simulated).",
)


@click.group()
def target() -> None:
    """Draw the reticle of a station, or show what it is good for."""


@target.command("draw")
@_STATION
@click.option(
    "--output",
    "-o",
    type=NewFile(),
    required=True,
    help="New file; its name ends in .svg, .pdf, .dxf or .gds.",
)
def draw(station: str, output: Path) -> int:
    """Draw the reticle that the section `target` of a station describes.

    What is filled in the drawing is opaque. SVG and PDF have exact millimetres. DXF and GDSII are for makers of
    reticles; they need: pip install 'starbench[draw]'.
    """
    from bench.commands.target_output import write_drawing

    return write_drawing(station, output)


@target.command("show")
@_STATION
@click.option(
    "--focal-length-mm",
    type=Number(least=0, above=True),
    metavar="MM",
    help="Focal length of the lens.  [default: expected.focal_px of the station]",
)
@click.option(
    "--r-mm",
    type=Number(least=0, above=True),
    metavar="MM",
    help="Focal length of the collimator.  [default: that of the station]",
)
@click.option(
    "--pixel-um",
    type=Number(least=0, above=True),
    metavar="UM",
    help="Side of a pixel, with --focal-length-mm.  [default: 4.86, of the IMX636]",
)
@JSON
def show(
    station: str, focal_length_mm: float | None, r_mm: float | None, pixel_um: float | None, as_json: bool
) -> int:
    """Show what the target of a station is good for: stars in view, their size in px, the field, and warnings."""
    from bench.commands.target_output import show_target

    return show_target(
        station, focal_length_mm=focal_length_mm, r_mm=r_mm, pixel_um=pixel_um, as_json=as_json
    )


TARGET_COMMANDS = (target,)
"""Commands of this module, for the command line."""
