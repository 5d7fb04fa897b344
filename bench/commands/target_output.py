"""Print what a target is good for; write its drawing."""

from __future__ import annotations

from pathlib import Path

import click

from bench.commands.output import print_json


def write_drawing(station_name: str, path: Path) -> int:
    """Write the drawing of a station's target, never over an existing file.

    station_name: Station file, or the name of a station that is included.
    Returns: Exit status, 0.
    """
    from bench.records.storage import write_atomic
    from bench.stations.station import load_station
    from bench.stations.target.draw import drawing_file
    from bench.stations.target.shapes import title_of

    target = load_station(station_name).value.target
    write_atomic(path, drawing_file(target, path))
    width, height = target.size_mm
    opaque = "black" if target.polarity == "positive" else "white"
    click.echo(
        f"Written: {path}. {title_of(target)}; {width:.6g} x {height:.6g} mm; {target.polarity}: the {opaque} parts of"
        " the pattern are filled, and what is filled is opaque."
    )
    if target.drawing.mirrored:
        click.echo("Mirrored: the camera sees the pattern through the glass.")
    if path.suffix.lower() == ".pdf":
        click.echo("Print it at 100 % (actual size), and measure the scale bars.")
    return 0


def show_target(
    station_name: str,
    *,
    focal_length_mm: float | None,
    r_mm: float | None,
    pixel_um: float | None,
    as_json: bool,
) -> int:
    """Print what a station's target is good for.

    station_name: Station file, or the name of a station that is included.
    focal_length_mm: Focal length of the lens; None: that of the station.
    r_mm: Focal length of the collimator; None: that of the station.
    pixel_um: Side of a pixel; None: that of the IMX636.
    as_json: Whether to print JSON.
    Returns: Exit status, 0.
    """
    from dataclasses import asdict

    from bench.stations.station import load_station
    from bench.stations.target.use import optics_of, use_of

    station = load_station(station_name).value
    optics = optics_of(station, focal_length_mm=focal_length_mm, r_mm=r_mm, pixel_um=pixel_um)
    found, target = use_of(station.target, optics), station.target
    if as_json:
        described = target.model_dump(mode="json") | {"size_mm": list(target.size_mm)}
        print_json({"target": described, "optics": asdict(optics), **found.to_dict()})
        return 0
    columns, rows = target.squares
    width, height = optics.image_size
    left, right, up, down = found.target_deg
    beam = "not known" if found.beam_deg is None else f"{found.beam_deg:.1f} degrees, full angle"
    lines = {
        "target": f"{columns} x {rows} squares of {target.pitch_mm:.6g} mm, {found.stars} stars of {target.segments}"
        f" segments, {target.polarity}",
        "tag": f"family {target.tag_family}, number {target.tag_id}, {found.tag_px:.0f} px wide",
        "optics": f"lens {optics.focal_px:.0f} px, collimator {optics.r_mm:g} mm, image {width} x {height} px",
        "pitch": f"{found.pitch_px:.1f} px; a segment is {found.segment_px:.1f} px wide at 0.4 pitches",
        "stars in view": f"{found.stars_in_view}, when the camera looks at the tag",
        "camera's field": f"{found.camera_deg[0]:.1f} x {found.camera_deg[1]:.1f} degrees",
        "target's field": f"{left:.1f} degrees left of the tag, {right:.1f} right, {up:.1f} up, {down:.1f} down",
        "beam": beam,
    }
    for name, text in lines.items():
        click.echo(f"{name:<15} {text}")
    for warning in found.warnings:
        click.echo(f"{'warning':<15} {warning}")
    if not found.warnings:
        click.echo(f"{'verdict':<15} Nothing speaks against this target.")
    return 0
