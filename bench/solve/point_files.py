"""Point files: stars detected by another program, as text, one file for each view.

Each line is a star: image x, y (px), target X, Y (mm), star id, separated by blanks or commas. The origin
of the image coordinates is the corner of the first pixel, as the published star detectors write them,
unless `Origin` says centre.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np

from bench.base.errors import BenchError, StorageError
from calib.errors import InputMismatch
from calib.view import View
from drivers.camera.raw_check import require_regular

Origin = Literal["corner", "centre"]
_COLUMNS = 5
_MOST_STARS = 100_000
_MOST_BYTES = 20_000_000
_MOST_ID = 2**53
_CORNER_PX = 0.5
_MOST_PX = 100_000.0
_MOST_MM = 1e6
_LONGEST_QUOTE = 100
_SLACK_PX = 1.0  # points with the other origin are shifted by half a pixel: no reason to refuse them
_SPLIT = re.compile(r"[,;\s]+")


def read_point_file(path: Path, *, image_size: tuple[int, int] | None, origin: Origin = "corner") -> View:
    """Read one view, in OpenCV's pixel convention and with unit covariances, from a point file of five numbers a line.

    ``image_size`` None is the smallest that holds the points; ``origin`` is the corner or centre of the first pixel.
    """
    rows = _rows(path)
    _refuse_outside(rows[:, :2], image_size, path)
    points = rows[:, :2] - (_CORNER_PX if origin == "corner" else 0.0)
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
        raise BenchError(error.what, where=str(path), remedy="Each star may occur once in a view.") from error


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
        lines = data.decode("utf-8-sig").splitlines()
    except OSError as error:
        raise StorageError(f"The file cannot be read: {error.strerror}.", where=str(path)) from error
    except UnicodeDecodeError as error:
        raise BenchError(
            "The file is not UTF-8 text.", where=str(path), remedy="Point files have lines x y X Y id."
        ) from error
    rows = [_row(line, f"{path}:{number}") for number, line in enumerate(lines, 1) if _is_data(line)]
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
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _row(line: str, where: str) -> list[float]:
    remedy = "Point files have lines x y X Y id: px, px, mm, mm, an integer."
    fields = _SPLIT.split(line.strip())
    if len(fields) != _COLUMNS:
        raise BenchError(
            f"The line has {len(fields)} columns instead of {_COLUMNS}.", where=where, remedy=remedy
        )
    try:
        numbers = [float(text) for text in fields]
    except ValueError as error:
        raise BenchError(
            f"Not a number: {str(error)[:_LONGEST_QUOTE]}.", where=where, remedy=remedy
        ) from error
    if "_" in line:  # Python reads 6_0 as 60
        raise BenchError("A number has an underscore.", where=where, remedy=remedy)
    if max(map(abs, numbers[2:4])) > _MOST_MM:
        raise BenchError(f"A target coordinate is above {_MOST_MM:g} mm.", where=where, remedy=remedy)
    if not np.isfinite(numbers).all() or numbers[4] != int(numbers[4]) or abs(numbers[4]) > _MOST_ID:
        raise BenchError("A number is not finite, or the id is not an integer.", where=where, remedy=remedy)
    return numbers
