"""Writes the reticle of a station to a file; the ending of its name tells the kind."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.base.errors import UsageError
from bench.stations.station_target import TargetConfig
from bench.stations.target.shapes import Drawing, draw_target
from bench.stations.target.vector_files import MM_PER_UNIT, TooLarge, pdf, svg

# Drawings as DXF and GDSII, for makers of masks and reticles; by ezdxf and gdstk (extra ``draw``).

OPAQUE_LAYER, OUTLINE_LAYER = "OPAQUE", "OUTLINE"
"""Layers of a DXF file."""
GDS_OPAQUE, GDS_OUTLINE = 1, 10
"""Layers of a GDSII file, each with data type 0."""
GDS_CELL = "TARGET"
GDS_STEP_M = 1e-9
"""Step of the coordinates in a GDSII file: 1 nm."""
_LARGEST_GDS_MM = 2 * 2**31 * GDS_STEP_M * 1e3
_DXF_UNITS = {"inch": 1, "mm": 4, "um": 13}
_NO_DATE = datetime(2000, 1, 1, tzinfo=UTC)


def dxf(drawing: Drawing, units: str) -> bytes:
    """Write a drawing as DXF (AutoCAD 2010), with a closed polyline for each area.

    units: Unit of the coordinates; the file states it as ``$INSUNITS``.
    Raises UsageError: If ezdxf is not installed.
    """
    ezdxf = _library("ezdxf")
    was = ezdxf.options.write_fixed_meta_data_for_testing
    ezdxf.options.write_fixed_meta_data_for_testing = True
    try:
        document = ezdxf.new("R2010", units=_DXF_UNITS[units])
        document.header["$MEASUREMENT"] = 0 if units == "inch" else 1
        document.layers.add(OPAQUE_LAYER)
        document.layers.add(OUTLINE_LAYER, color=8)
        space = document.modelspace()
        _each(drawing, units, lambda points: space.add_lwpolyline(points, close=True, dxfattribs=_ON_OPAQUE))
        if drawing.outline:
            space.add_lwpolyline(_edge(drawing, units), close=True, dxfattribs={"layer": OUTLINE_LAYER})
        text = io.StringIO()
        document.write(text)
        return text.getvalue().encode()
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = was


_ON_OPAQUE = {"layer": OPAQUE_LAYER}


def gdsii(drawing: Drawing, units: str) -> bytes:
    """Write a drawing as GDSII, with one flat cell and steps of 1 nm.

    units: Unit of the coordinates that a program shows; the steps do not depend on it.
    Raises UsageError: If gdstk is not installed.
    Raises TooLarge: If the glass is larger than steps of 1 nm can count.
    """
    gdstk = _library("gdstk")
    if max(drawing.width_mm, drawing.height_mm) >= _LARGEST_GDS_MM:
        raise TooLarge(f"A GDSII file with steps of 1 nm is at most {_LARGEST_GDS_MM:.0f} mm wide and high.")
    library = gdstk.Library("STARBENCH", unit=MM_PER_UNIT[units] * 1e-3, precision=GDS_STEP_M)
    cell = library.new_cell(GDS_CELL)
    _each(drawing, units, lambda points: cell.add(gdstk.Polygon(points, layer=GDS_OPAQUE)))
    if drawing.outline:
        cell.add(gdstk.Polygon(_edge(drawing, units), layer=GDS_OUTLINE))
    with tempfile.TemporaryDirectory(prefix="starbench-") as folder:
        path = Path(folder) / "target.gds"
        library.write_gds(path, timestamp=_NO_DATE)
        return path.read_bytes()


def _each(drawing: Drawing, units: str, add: Callable[[NDArray[np.float64]], object]) -> None:
    """Call a function with the corners of every polygon, Y up, in the unit of the file."""
    scale = np.array([1.0, -1.0]) / MM_PER_UNIT[units]
    for polygon in drawing.polygons:
        add(polygon[::-1] * scale)


def _edge(drawing: Drawing, units: str) -> NDArray[np.float64]:
    """Return the corners of the glass in the unit of the file."""
    corners = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return corners * [drawing.width_mm, drawing.height_mm] / MM_PER_UNIT[units]


def _library(name: str) -> Any:
    """Import a library of the extra ``draw``."""
    try:
        return import_module(name)
    except ImportError as error:
        raise UsageError(
            f"{name} is not installed. It writes this kind of file.",
            remedy="Install it: pip install 'starbench[draw]'. SVG and PDF need nothing.",
        ) from error


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
