"""The opaque areas of a reticle as polygons: stars, tag and margin, exact to the last digit.

One rule holds for every drawing: **what is filled is opaque**: the black parts of a positive reticle; the white ones of
a negative, and its margin but for the marks. Polygons are convex or rectangles, without holes or overlap. The frame: mm
from the middle of the glass, X right and Y down as the camera sees it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.base.errors import UsageError
from bench.stations.station_fields import TargetConfig
from calib.target import StarTarget

_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_PLAIN, 1.0
"""Letters of OpenCV, about a dozen pixels high."""
Array = NDArray[np.float64]
Rectangle = tuple[float, float, float, float]
"""Left, top, right, bottom."""

_CLEAR_PITCHES = 1.5
"""Distance of the marks in the margin from the stars' cells, pitches. The star finder sees white there."""
_LETTER_PITCHES = 0.8  # Letters stay within a row of the margin
_BAR_PITCHES = 0.25  # Thick enough to be seen beside the letters
_LONGEST_BAR = 0.5
"""Longest scale bar that is chosen, as a share of the shorter side of the pattern: its label stands beside it."""
_MOST_POLYGONS = 1_000_000  # Bounds the memory and the size of the file


def text_rectangles(text: str) -> NDArray[np.float64]:
    """Return a text in the letters of OpenCV as rectangles, (N, 4): left, top, right, bottom; 1 high, Y down."""
    (width, above), below = cv2.getTextSize(text, _FONT, _FONT_SCALE, 1)
    picture = np.zeros((above + 3 * below, width + 2 * below), np.uint8)
    cv2.putText(picture, text, (below, above + below), _FONT, _FONT_SCALE, 255, 1)
    rows, columns = np.nonzero(picture > 127)
    ink = picture[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] > 127
    edges = np.diff(np.pad(ink, ((0, 0), (1, 1))).astype(np.int8))
    (top, left), (_, right) = np.nonzero(edges > 0), np.nonzero(edges < 0)
    return np.column_stack([left, top, right, top + 1]) / len(ink)


class Shapes(NamedTuple):
    """Polygons of one part of a drawing."""

    name: str  # Part: "stars", "tag" or "margin"
    polygons: list[Array]  # (K, 2) float64 each, mm, corners in order, not repeated at the end
    # Number of polygons in a row that belong together, such as the segments of a star; 0: all of them.
    joined: int = 0


@dataclass(frozen=True)
class Drawing:
    """A reticle as areas."""

    width_mm: float
    height_mm: float
    parts: tuple[Shapes, ...]
    outline: bool  # Whether the edge of the glass is to be drawn
    title: str
    # Node (0, 0) of the pattern in the frame of the drawing, before any mirroring.
    offset_mm: tuple[float, float]

    @property
    def polygons(self) -> list[Array]:
        """All polygons."""
        return [polygon for part in self.parts for polygon in part.polygons]


def draw_target(target: TargetConfig) -> Drawing:
    """Draw the reticle of a station; letters, marks or numbers of parts that do not fit are refused."""
    pattern, negative = target.pattern(), target.polarity == "negative"
    if len(pattern.ids) * pattern.segments > 2 * _MOST_POLYGONS:
        raise UsageError(
            f"The drawing would have more than {_MOST_POLYGONS} areas.",
            where="target",
            remedy="Use fewer squares or fewer segments.",
        )
    width, height = target.size_mm
    field = (pattern.columns * pattern.pitch_mm, pattern.rows * pattern.pitch_mm)
    offset = tuple(0.5 * (pattern.pitch_mm - side) for side in field)
    marks = _marks(target, field)
    cells = (-0.5 * field[0], -0.5 * field[1], 0.5 * field[0], 0.5 * field[1])
    glass = (-0.5 * width, -0.5 * height, 0.5 * width, 0.5 * height)
    parts: tuple[Shapes, ...] = (
        Shapes("stars", _stars(pattern, offset, negative=negative), pattern.segments // 2),
        Shapes("tag", _tag(pattern, offset, negative=negative)),
        Shapes("margin", _corners(_left_over(glass, [cells, *marks]) if negative else marks)),
    )
    if target.drawing.mirrored:
        turned = np.array([-1.0, 1.0])
        parts = tuple(part._replace(polygons=[p[::-1] * turned for p in part.polygons]) for part in parts)
    return Drawing(width, height, parts, target.drawing.outline, title_of(target), (offset[0], offset[1]))


def title_of(target: TargetConfig) -> str:
    """Return serial number (if any), tag family and number, squares and pitch: ``36h11-3 50/72 4.01389 mm``."""
    serial = f"{target.serial.upper()}  " if target.serial else ""
    columns, rows = target.squares
    return f"{serial}{target.tag_family.upper()}-{target.tag_id} {columns}/{rows} {target.pitch_mm:.6g} mm"


def _stars(pattern: StarTarget, offset: tuple[float, ...], *, negative: bool) -> list[Array]:
    """Return the opaque segments of all stars; a segment that reaches around a corner of its cell has 4 corners."""
    segments = [
        np.array(_segment(pattern.segments, number)) * pattern.pitch_mm
        for number in range(0 if negative else 1, pattern.segments, 2)
    ]
    nodes = pattern.positions_mm(pattern.ids) + offset
    return [node + segment for node in nodes for segment in segments]


def _segment(segments: int, number: int) -> list[tuple[float, float]]:
    """Return a star's segment, counted from +Y towards -X, in a cell of side 1: its centre and corners on the edge.

    A place on the edge is counted in eighths of a turn: corners and ends are then compared as whole numbers.
    """
    start, end = 8 * number + 2 * segments, 8 * (number + 1) + 2 * segments
    corners = [eighth * segments for eighth in range(1, 24, 2) if start < eighth * segments < end]
    return [(0.0, 0.0), *(_on_cell(place / segments) for place in (start, *corners, end))]


def _on_cell(eighths: float) -> tuple[float, float]:
    """Return the point in which a ray from the centre, so many eighths of a turn from +X, leaves a cell of side 1."""
    quarter = math.floor((eighths + 1.0) / 2.0)
    along = 0.5 * math.tan((eighths - 2.0 * quarter) * math.pi / 4.0)
    if abs(eighths - 2.0 * quarter) == 1.0:
        along = math.copysign(0.5, along)
    return ((0.5, along), (-along, 0.5), (-0.5, -along), (along, -0.5))[quarter % 4]


def _tag(pattern: StarTarget, offset: tuple[float, ...], *, negative: bool) -> list[Array]:
    """Return the opaque modules of the tag; on a negative reticle also the ring around it."""
    left, top = pattern.tag_corners_mm[0] + offset
    side = pattern.tag_squares * pattern.pitch_mm
    lines = np.arange(pattern.tag_modules + 1) / pattern.tag_modules * side
    rows, columns = np.nonzero(pattern.tag_print == 0)
    black = [
        (left + lines[c], top + lines[r], left + lines[c + 1], top + lines[r + 1])
        for r, c in zip(rows, columns, strict=True)
    ]
    ring = 0.5 * pattern.pitch_mm
    whole = (left - ring, top - ring, left + side + ring, top + side + ring)
    white = _left_over(whole, black)
    return _corners(white if negative else _left_over(whole, white))


def _marks(target: TargetConfig, field: tuple[float, float]) -> list[Rectangle]:
    """Return the marks in the margin: text above the pattern, scale bars with their length below and to the right."""
    pitch = target.pitch_mm
    room = [0.5 * (glass - cells) / pitch for glass, cells in zip(target.size_mm, field, strict=True)]
    text = title_of(target)
    if wrong := "".join(
        dict.fromkeys(letter for letter in text if not (letter.isascii() and letter.isprintable()))
    ):
        raise UsageError(
            f"The serial number has letters that cannot be drawn: {wrong}",
            where="target.serial",
            remedy="Use A to Z, 0 to 9, and signs such as - _ . / #.",
        )
    needed = _CLEAR_PITCHES + _LETTER_PITCHES
    bar_mm = scale_bar_mm(target)
    if room[1] < needed or (bar_mm and room[0] < needed):
        least = [side + 2.0 * needed * pitch for side in field]
        raise UsageError(
            "The margin is too narrow for the text and the scale bars.",
            where="target.drawing.size_mm",
            remedy=f"Give at least [{least[0]:.6g}, {least[1]:.6g}].",
        )
    letters = text_rectangles(text)
    height = min(_LETTER_PITCHES * pitch, field[0] / letters[:, 2].max())
    clear, left, low = _CLEAR_PITCHES * pitch, -0.5 * field[0], 0.5 * field[1]
    marks = _moved(letters * height, left, -low - clear - height)
    if bar_mm:
        label = f"{bar_mm:.6g} mm"
        bar = _ruler(bar_mm, label, _BAR_PITCHES * pitch, min(height, 0.3 * bar_mm))
        upright = np.column_stack([bar[:, 1], -bar[:, 2], bar[:, 3], -bar[:, 0]])
        marks = np.vstack([marks, _moved(bar, left, low + clear), _moved(upright, -left + clear, low)])
    return [(float(a), float(b), float(c), float(d)) for a, b, c, d in marks]


def _ruler(length: float, label: str, thick: float, height: float) -> Array:
    """Return a scale bar along X from the origin, with its label after it, as (N, 4) rectangles."""
    text = _moved(text_rectangles(label) * height, length + height, 0.0)
    ticks = [(0.0, thick, thick, 2 * thick), (length - thick, thick, length, 2 * thick)]
    return np.vstack([[(0.0, 0.0, length, thick), *ticks], text])


def _moved(rectangles: Array, x: float, y: float) -> Array:
    """Return (N, 4) rectangles, moved."""
    return np.asarray(rectangles + np.array([x, y, x, y]))


def scale_bar_mm(target: TargetConfig) -> float:
    """Return the length of the scale bars of a drawing, mm; 0 if there are none."""
    pattern, given = target.pattern(), target.drawing.scale_bar_mm
    shorter = min(pattern.columns, pattern.rows) * pattern.pitch_mm
    if given is None:
        power = 10.0 ** math.floor(math.log10(_LONGEST_BAR * shorter))
        return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= _LONGEST_BAR * shorter)
    letters = text_rectangles(f"{given:.6g} mm")[:, 2].max()
    label = (_LETTER_PITCHES * float(letters) + 1.0) * pattern.pitch_mm
    if given and given + label > shorter:
        raise UsageError(
            f"A scale bar of {given:g} mm with its label is longer than the pattern.",
            where="target.drawing.scale_bar_mm",
            remedy=f"Give at most {max(0.0, shorter - label):.4g}, or leave the key out.",
        )
    return given


def _left_over(whole: Rectangle, taken: list[Rectangle]) -> list[Rectangle]:
    """Return a rectangle without others, as rectangles that do not overlap: rows of equal gaps are joined."""
    left, top, right, bottom = whole
    lines = sorted({top, bottom, *(y for r in taken for y in (r[1], r[3]) if top < y < bottom)})
    done: list[Rectangle] = []
    open_rows: dict[tuple[float, float], float] = {}
    for upper, lower in pairwise(lines):
        gaps = _gaps(left, right, [(r[0], r[2]) for r in taken if r[1] < lower and r[3] > upper])
        done += [(a, y, b, upper) for (a, b), y in open_rows.items() if (a, b) not in gaps]
        open_rows = {gap: open_rows.get(gap, upper) for gap in gaps}
    return done + [(a, y, b, bottom) for (a, b), y in open_rows.items()]


def _gaps(left: float, right: float, taken: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the parts of an interval that others leave free, from left to right."""
    gaps, at = [], left
    for start, end in sorted(taken):
        if start > at:
            gaps.append((at, start))
        at = max(at, end)
    return [*gaps, (at, right)] if at < right else gaps


def _corners(rectangles: list[Rectangle]) -> list[Array]:
    """Return rectangles as polygons."""
    return [np.array([[a, b], [c, b], [c, d], [a, d]]) for a, b, c, d in rectangles]
