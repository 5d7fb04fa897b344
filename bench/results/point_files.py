"""Point files: stars found by another program, one file a view, as text.

A line a star: image x, y (px), target X, Y (mm), star id, separated by blanks or commas. Image coordinates have
their origin at the corner of the first pixel, as the published star detectors write them, unless told otherwise.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np

from bench.base.errors import BenchError, StorageError
from calib.errors import InputMismatch
from calib.view import View

Origin = Literal["corner", "centre"]
_COLUMNS = 5
_MOST_STARS = 100_000
_MOST_ID = 2**53
_CORNER_PX = 0.5
_SLACK_PX = 1.0  # points told with the other origin are off by half a pixel: no reason to refuse them
_SPLIT = re.compile(r"[,;\s]+")


def read_point_file(path: Path, *, image_size: tuple[int, int] | None, origin: Origin = "corner") -> View:
    """Read one view.

    Parameters
    ----------
    path
        The file; its name without ending becomes the view's.
    image_size
        Width and height, px; None: the smallest that holds the points (a start for the principal point only).
    origin
        Whether (0, 0) is the corner or the centre of the first pixel.

    Returns
    -------
    View
        With OpenCV's pixel convention and unit covariances: such files do not tell how sure a point is.

    Raises
    ------
    BenchError
        When a line is not five numbers, naming file and line; two lines share an id; or a point lies outside of the
        image.
    StorageError
        When the file cannot be read.
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
        raise BenchError(error.what, where=str(path), remedy="Each star may stand in a view once.") from error


def _refuse_outside(points: np.ndarray, image_size: tuple[int, int] | None, path: Path) -> None:
    """Refuse points beside the image: of another camera, or the image's sides are told in the other order."""
    most = np.array(image_size or (np.inf, np.inf))
    outside = ((points < -_SLACK_PX) | (points > most + _SLACK_PX)).any(axis=1)
    if not outside.any():
        return
    x, y = points[outside][0]
    told = f"of {image_size[0]} x {image_size[1]} px" if image_size else "whose first pixel lies at 0"
    raise BenchError(
        f"{int(outside.sum())} of {len(points)} points lie outside of an image {told}, one at ({x:g}, {y:g}).",
        where=str(path),
        remedy="Give --image-size as width x height, and points in px.",
    )


def _rows(path: Path) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise StorageError(f"It cannot be read: {error.strerror}.", where=str(path)) from error
    except UnicodeDecodeError as error:
        raise BenchError(
            "It is not text.", where=str(path), remedy="Point files hold lines x y X Y id."
        ) from error
    rows = [_row(line, f"{path}:{number}") for number, line in enumerate(lines, 1) if _is_data(line)]
    if not rows:
        raise BenchError("It holds no points.", where=str(path), remedy="Point files hold lines x y X Y id.")
    if len(rows) > _MOST_STARS:
        raise BenchError(f"{len(rows)} points: no target has so many stars.", where=str(path))
    return np.array(rows, np.float64)


def _is_data(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _row(line: str, where: str) -> list[float]:
    remedy = "Point files hold lines x y X Y id: px, px, mm, mm, a whole number."
    words = _SPLIT.split(line.strip())
    if len(words) != _COLUMNS:
        raise BenchError(f"{len(words)} columns, not {_COLUMNS}.", where=where, remedy=remedy)
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise BenchError(f"Not a number: {error}.", where=where, remedy=remedy) from error
    if not np.isfinite(numbers).all() or numbers[4] != int(numbers[4]) or abs(numbers[4]) > _MOST_ID:
        raise BenchError("A number is not finite, or the id is not a whole one.", where=where, remedy=remedy)
    return numbers
