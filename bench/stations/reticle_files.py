"""Writes the reticle of a station to a file; the ending of its name tells the kind.

Drawings as SVG and PDF are vector files with exact millimetres, written without another program. Every file is a
function of the drawing (whose letters are OpenCV's, and may change with its version): it has no date, no name of a
computer and no random identifier. Coordinates have six decimals of a millimetre. The polygons of one star, of the tag
and of the margin are one path each, so that a viewer shows no seams between areas that touch.
"""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from bench.base.encoding import plain_number
from bench.base.entry_points import extra_library
from bench.base.errors import UsageError
from bench.stations.station_fields import TargetConfig
from bench.stations.target_shapes import Drawing, Shapes, draw_target

_short = partial(plain_number, digits=6)
"""Prints a length in mm; six decimals are a nanometre."""

MM_PER_UNIT = {"mm": 1.0, "um": 1e-3, "inch": 25.4}  # By the names of the units
_POINTS_PER_MM = 72.0 / 25.4  # PDF's point is 1/72 of an inch
_LARGEST_PDF_MM = 14_400 / _POINTS_PER_MM
"""The largest page of PDF 1.7 without a unit of its own (ISO 32000-1, annex C.2)."""
_LINE_MM = 0.1
"""Width of the line for the edge of the glass."""
OPAQUE_LAYER, OUTLINE_LAYER = "OPAQUE", "OUTLINE"
"""Layers of a DXF file."""
GDS_OPAQUE, GDS_OUTLINE = 1, 10
"""Layers of a GDSII file, each with data type 0."""
GDS_CELL = "TARGET"
GDS_STEP_M = 1e-9
"""Step of the coordinates in a GDSII file: 1 nm."""
_LARGEST_GDS_MM = 2 * 2**31 * GDS_STEP_M * 1e3  # Coordinates have 32 bits, one of them the sign
_DXF_UNITS = {"inch": 1, "mm": 4, "um": 13}  # Values of $INSUNITS in DXF
_NO_DATE = datetime(2000, 1, 1, tzinfo=UTC)  # The same drawing gives the same file

_ON_OPAQUE = {"layer": OPAQUE_LAYER}


class TooLarge(ValueError):
    """The drawing is larger than the file format allows; the text says what the limit is."""


def svg(drawing: Drawing, units: str) -> bytes:
    """Write a drawing as SVG; units is a key of `MM_PER_UNIT`, and the printed size does not depend on it."""
    scale = 1.0 / MM_PER_UNIT[units]
    width, height = drawing.width_mm * scale, drawing.height_mm * scale
    view = " ".join(_short(n) for n in (-0.5 * width, -0.5 * height, width, height))
    edge = f'x="{_short(-0.5 * width)}" y="{_short(-0.5 * height)}" width="{_short(width)}" height="{_short(height)}"'
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{_short(drawing.width_mm)}mm"'
            f' height="{_short(drawing.height_mm)}mm" viewBox="{view}">'
        ),
        f"<title>{escape(drawing.title)}</title>",
        (
            "<desc>What is filled is opaque. Origin in the middle of the glass, X right, Y down, as the camera sees it."
            f" Unit of the coordinates: {units}.</desc>"
        ),
    ]
    for part in drawing.parts:
        lines.append(f'<g id="{part.name}" fill="#000">')
        lines += [f'<path d="{path}"/>' for path in _paths(part, scale, "MLZ")]
        lines.append("</g>")
    if drawing.outline:
        line = _short(_LINE_MM * scale)
        lines.append(f'<rect id="outline" {edge} fill="none" stroke="#000" stroke-width="{line}"/>')
    return ("\n".join([*lines, "</svg>"]) + "\n").encode()


def pdf(drawing: Drawing, units: str) -> bytes:
    """Write a drawing as a PDF of one page, as large as the glass; its unit is the point, 1/72 inch."""
    del units
    if max(drawing.width_mm, drawing.height_mm) > _LARGEST_PDF_MM:
        raise TooLarge(f"A page of a PDF is at most {_LARGEST_PDF_MM:.0f} mm wide and high.")
    k, width, height = _POINTS_PER_MM, drawing.width_mm, drawing.height_mm
    middle = [_short(0.5 * side * k) for side in (width, height)]
    lines = [f"{k:.12f} 0 0 {-k:.12f} {middle[0]} {middle[1]} cm", "0 g"]
    for part in drawing.parts:
        lines += [f"{path} f" for path in _paths(part, 1.0, "mlh")]
    if drawing.outline:
        corner = f"{_short(-0.5 * width)} {_short(-0.5 * height)} {_short(width)} {_short(height)}"
        lines.append(f"0 G {_LINE_MM} w {corner} re S")
    content = ("\n".join(lines) + "\n").encode()
    title = drawing.title.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {_short(width * k)} {_short(height * k)}]"
        " /Resources << >> /Contents 4 0 R >>".encode(),
        f"<< /Length {len(content)} >>\nstream\n".encode() + content + b"endstream",
        f"<< /Title ({title}) /Producer (Starbench) >>".encode(),
    ]
    return _pdf_file(objects)


def _pdf_file(objects: list[bytes]) -> bytes:
    """Return a PDF file with numbered objects; the first is the catalogue, the last the information (ISO 32000-1)."""
    data, places = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, 1):
        places.append(len(data))
        data += f"{number} 0 obj\n".encode() + body + b"\nendobj\n"
    count = len(objects) + 1
    table = f"xref\n0 {count}\n0000000000 65535 f \n".encode()
    table += b"".join(b"%010d 00000 n \n" % place for place in places)
    tail = f"trailer\n<< /Size {count} /Root 1 0 R /Info {count - 1} 0 R >>\nstartxref\n{len(data)}\n%%EOF\n"
    return data + table + tail.encode()


def _paths(part: Shapes, scale: float, signs: str) -> Iterator[str]:
    """Yield paths of the polygons that belong together. ``signs`` begin, continue and close a polygon."""
    step = part.joined or max(1, len(part.polygons))
    for first in range(0, len(part.polygons), step):
        yield " ".join(_path(polygon * scale, signs) for polygon in part.polygons[first : first + step])


def _path(polygon: NDArray[np.float64], signs: str) -> str:
    """Return a polygon as a path: in SVG the sign stands before a point, in PDF after it."""
    begin, along, close = signs[0], signs[1], signs[2]
    points = [f"{_short(x)} {_short(y)}" for x, y in polygon.tolist()]
    if begin == "M":
        return begin + along.join(points) + close
    return " ".join([f"{points[0]} {begin}", *(f"{point} {along}" for point in points[1:]), close])


def dxf(drawing: Drawing, units: str) -> bytes:
    """Write a drawing as DXF (AutoCAD 2010): closed polylines, units in ``$INSUNITS``. It needs ezdxf."""
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
        # ezdxf would add them in the order of a set, which differs between processes.
        for kind in sorted(document.entitydb.dxf_types_in_use()):
            document.classes.add_class(kind)
        text = io.StringIO()
        document.write(text)
        return text.getvalue().encode()
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = was


def gdsii(drawing: Drawing, units: str) -> bytes:
    """Write a drawing as GDSII, with one flat cell and steps of 1 nm in any units. It needs gdstk."""
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
    remedy = "Install it: pip install 'starbench[draw]'. SVG and PDF need nothing."
    return extra_library(name, f"{name} is not installed. It writes this kind of file.", remedy=remedy)


WRITERS: Mapping[str, Callable[[Drawing, str], bytes]] = {
    ".svg": svg,
    ".pdf": pdf,
    ".dxf": dxf,
    ".gds": gdsii,
}
"""Writer of each kind of file."""


def drawing_file(target: TargetConfig, path: Path) -> bytes:
    """Return the file with the drawing of a target, of the ending of ``path``. Nothing is written."""
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
