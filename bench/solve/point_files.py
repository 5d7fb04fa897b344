"""Point files: stars detected by another program, as text, one file for each view.

Each line is a star: image x, y (px), target X, Y (mm), star id, separated by blanks, commas or semicolons. A first
line with these names may give another order, and more columns. The origin of the image coordinates is the corner of
the first pixel, as the published star detectors write them, unless `Origin` says otherwise.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from bench.base.errors import BenchError, StorageError
from calib.errors import InputMismatch
from calib.view import View
from drivers.camera.file_kinds import known_kind
from drivers.camera.raw_check import require_regular

Origin = Literal["corner", "centre", "matlab"]
_FIRST_PIXEL = {"corner": 0.5, "centre": 0.0, "matlab": 1.0}
"""Coordinate of the centre of the first pixel, px; MATLAB counts from 1."""
_COLUMNS = ("x", "y", "X", "Y", "id")
_HEIGHT_OF_TARGET = "Z"
_REMEDY = "Point files have lines x y X Y id: px, px, mm, mm, an integer."
_MOST_STARS = 100_000  # A hundred times those of a dense target
_MOST_BYTES = 20_000_000  # 200 a point
_MOST_ID = 2**53  # The largest integer that a double holds exactly
_MOST_PX = 100_000.0  # Wider than any image sensor
_MOST_MM = 1e6  # A kilometre
_LONGEST_QUOTE = 100  # Characters: a line of a terminal
_SLACK_PX = 1.0  # points with the other origin are shifted by half a pixel: no reason to refuse them
_SPLIT = re.compile(r"[,;\s]+")
_SPLIT_OF_COMMAS = re.compile(r"[;\s]+")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+(?:,\d+)?(?:[eE][-+]?\d+)?")
_QUOTED = re.compile(r'"([-+]?\d+),(\d+(?:[eE][-+]?\d+)?)"')
"""A number with a decimal comma that a spreadsheet has put between quotes."""
_NOT_COMPUTED = r"(?:DIV/0!|N/A|NV|REF!|VALUE!|WERT!|BEZUG!|NAME\?|NUM!|ZAHL!|NULL!)(?:[,;\t]|$)"
_NO_DATA = re.compile(rf"#(?!{_NOT_COMPUTED})|sep=.?$|$")
"""What is no row: a comment, but for a cell that a spreadsheet could not compute (#DIV/0!); its `sep=;`; nothing."""
_UNITS = re.compile(r"[ _]*[\[(]?(?:px|mm)[\])]?$")
_MARKS = {codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_SHARES = 1.5
"""All points so near the first pixel are shares of the image, px."""
_FEWEST_OF_GRID = 12  # Points; of fewer, columns may repeat by chance
_REPEATED, _SINGLE = 1 / 3, 0.9
"""Distinct values as a share of the points: at most so many in a column of a grid, more in one of an image."""


def read_point_file(path: Path, *, image_size: tuple[int, int] | None, origin: Origin = "corner") -> View:
    """Read one view, in OpenCV's pixel convention and with unit covariances, from a point file of five numbers a line.

    ``image_size`` None is the smallest that holds the points; ``origin`` is where the image coordinates begin.
    """
    rows = _rows(path)
    _refuse_other_quantities(rows, path)
    _refuse_outside(rows[:, :2], image_size, path)
    points = rows[:, :2] - _FIRST_PIXEL[origin]
    width, height = image_size or (int(np.ceil(a)) + 1 for a in points.max(axis=0))
    try:
        return View(
            name=path.stem,
            image_size=(width, height),
            ids=rows[:, 4].astype(np.int64),
            points_px=points,
            target_mm=rows[:, 2:4].copy(),
            covariances_px2=np.tile(np.eye(2), (len(rows), 1, 1)),
        )
    except InputMismatch as error:
        raise BenchError(
            error.what, where=str(path), remedy="Each star may occur once in a view: give a file for each."
        ) from error


def _refuse_other_quantities(rows: np.ndarray, path: Path) -> None:
    """Refuse points that are shares of the image, and columns of which the first two are the target's."""
    if len(rows) > 1 and np.abs(rows[:, :2]).max() < _SHARES:
        raise BenchError(
            f"All {len(rows)} points lie within {_SHARES:g} px of the first pixel.",
            where=str(path),
            remedy="Give x and y in px, not as shares of the image.",
        )
    *x_y, of_x, of_y = (len(np.unique(column)) / len(rows) for column in rows[:, :4].T)
    if len(rows) >= _FEWEST_OF_GRID and max(x_y) <= _REPEATED and min(of_x, of_y) > _SINGLE:
        raise BenchError(
            "The first two columns are a grid, and the next two are not: the target seems to stand before the image.",
            where=str(path),
            remedy=_REMEDY,
        )


def _refuse_outside(points: np.ndarray, image_size: tuple[int, int] | None, path: Path) -> None:
    """Refuse points outside the image: they are from another camera, or width and height are interchanged."""
    most = np.array(image_size or (_MOST_PX, _MOST_PX))
    outside = ((points < -_SLACK_PX) | (points > most + _SLACK_PX)).any(axis=1)
    if not outside.any():
        return
    x, y = points[outside][0]
    image = (
        f"an image of {image_size[0]} x {image_size[1]} px"
        if image_size
        else f"any image: x or y is negative, or above {_MOST_PX:g}"
    )
    raise BenchError(
        f"{int(outside.sum())} of {len(points)} points are outside {image}; one is at ({x:g}, {y:g}).",
        where=str(path),
        remedy="Give --image-size as width x height, and points in px.",
    )


def _rows(path: Path) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    try:
        require_regular(path)
        with path.open("rb") as file:
            data = file.read(_MOST_BYTES + 1)
        if len(data) > _MOST_BYTES:
            raise BenchError(
                f"The file has more than {_MOST_BYTES} bytes.",
                where=str(path),
                remedy="Point files have lines x y X Y id, one for each star of one view.",
            )
        if data[:2] not in _MARKS and (known := known_kind(data)):
            raise BenchError(f"The file is {known[0]}.", where=str(path), remedy=known[1])
        codec = _MARKS.get(data[:2], "utf-8-sig")
        lines = data.decode(codec).splitlines()
    except OSError as error:
        raise StorageError(f"The file cannot be read: {error.strerror}.", where=str(path)) from error
    except UnicodeDecodeError as error:
        raise BenchError(
            "The file is not UTF-8 text.", where=str(path), remedy="Save it as text in UTF-8."
        ) from error
    plain = (_QUOTED.sub(r"\1.\2", line).replace('"', "") for line in lines)
    data_lines = [(number, line.strip()) for number, line in enumerate(plain, 1) if _is_data(line)]
    names: Sequence[str] = _COLUMNS
    if data_lines and not any(map(_is_number, header := _header(data_lines[0][1]))):
        names = _names(header, f"{path}:{data_lines.pop(0)[0]}")
    rows = [_row(line, names, f"{path}:{number}") for number, line in data_lines]
    if not rows:
        raise BenchError(
            "The file has no points.", where=str(path), remedy="Point files have lines x y X Y id."
        )
    if len(rows) > _MOST_STARS:
        raise BenchError(
            f"The file has {len(rows)} points; at most {_MOST_STARS} are allowed.",
            where=str(path),
            remedy="Give one file for each view.",
        )
    return np.array(rows, np.float64)


def _is_data(line: str) -> bool:
    return _NO_DATA.match(line.strip().rstrip(",;")) is None


def _header(line: str) -> list[str]:
    """Split what may be a line of names, which may have blanks within if something else separates them."""
    return re.split("[,;\t]" if re.search("[,;\t]", line) else r"\s+", line.rstrip(",;"))


def _is_number(text: str) -> bool:
    return bool(_DECIMAL_COMMA.fullmatch(text.replace(".", ",")))


def _names(header: Sequence[str], where: str) -> list[str]:
    """Return the names of the columns as the first line has them; each of `_COLUMNS` must be there once."""
    names = [_UNITS.sub("", name.strip()) for name in header]
    names = ["id" if name.lower() == "id" else name for name in names]
    if not set(_COLUMNS) & set(names):
        raise BenchError(
            "This text is no list of points: its first line has neither numbers nor names of columns.",
            where=where,
            remedy=_REMEDY,
        )
    for name in _COLUMNS:
        if names.count(name) != 1:
            raise BenchError(
                f"The first line has {names.count(name) or 'no'} column{'s' * (name in names)} {name!r}.",
                where=where,
                remedy="Name the columns x, y (px), X, Y (mm) and id, or leave out the line.",
            )
    return names


def _fields(line: str, count: int) -> list[str]:
    """Split a line; where that gives as many fields as there are columns, a comma is the decimal one."""
    line = line.rstrip(",;")
    of_commas = _SPLIT_OF_COMMAS.split(line)
    if "," in line and len(of_commas) == count and all(map(_DECIMAL_COMMA.fullmatch, of_commas)):
        return [field.replace(",", ".") for field in of_commas]
    return _SPLIT.split(line)


def _row(line: str, names: Sequence[str], where: str) -> list[float]:
    """Return x, y (px), X, Y (mm) and id of a line whose columns have such names."""
    fields = _fields(line, len(names))
    if len(fields) != len(names):
        raise BenchError(
            f"The line has {len(fields)} columns instead of {len(names)}.", where=where, remedy=_REMEDY
        )
    of_name = dict(zip(names, fields, strict=True))
    try:
        numbers = [float(of_name[name]) for name in _COLUMNS]
        height = float(of_name.get(_HEIGHT_OF_TARGET, 0.0))
    except ValueError as error:
        raise BenchError(
            f"Not a number: {str(error)[:_LONGEST_QUOTE]}.", where=where, remedy=_REMEDY
        ) from error
    if "_" in line:  # Python reads 6_0 as 60
        raise BenchError("A number has an underscore.", where=where, remedy=_REMEDY)
    if height:
        raise BenchError("The point is not in the plane Z = 0.", where=where, remedy="Give a flat target.")
    if max(map(abs, numbers[2:4])) > _MOST_MM:
        raise BenchError(f"A target coordinate is above {_MOST_MM:g} mm.", where=where, remedy=_REMEDY)
    if not np.isfinite(numbers).all() or numbers[4] != int(numbers[4]) or abs(numbers[4]) > _MOST_ID:
        raise BenchError("A number is not finite, or the id is not an integer.", where=where, remedy=_REMEDY)
    return numbers
