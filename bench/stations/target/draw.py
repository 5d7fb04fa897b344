"""Writes the reticle of a station to a file; the ending of its name tells the kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from bench.base.errors import UsageError
from bench.stations.station_target import TargetConfig
from bench.stations.target.cad_files import dxf, gdsii
from bench.stations.target.shapes import Drawing, draw_target
from bench.stations.target.vector_files import TooLarge, pdf, svg

WRITERS: Mapping[str, Callable[[Drawing, str], bytes]] = {
    ".svg": svg,
    ".pdf": pdf,
    ".dxf": dxf,
    ".gds": gdsii,
}
"""Writer of each kind of file."""


def drawing_file(target: TargetConfig, path: Path) -> bytes:
    """Return the file with the drawing of a target. Nothing is written.

    target: Section ``target`` of a station.
    path: Name of the file; its ending is one of `WRITERS`.
    Raises UsageError: If the ending is unknown, the library that writes it is missing, or the drawing does
      not fit into it.
    """
    write = WRITERS.get(path.suffix.lower())
    if write is None:
        kind = f"of a name that ends in {path.suffix!r}" if path.suffix else "of a name without an ending"
        raise UsageError(
            f"No drawing can be made {kind}.",
            where=str(path),
            remedy="End the name in .svg, .pdf, .dxf or .gds.",
        )
    try:
        return write(draw_target(target), target.drawing.units)
    except TooLarge as error:
        raise UsageError(str(error), where=str(path), remedy="Draw it as .svg or .dxf.") from error
