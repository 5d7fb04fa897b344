"""Corners of a checkerboard as OpenCV locates them, for comparison with `calib.boards.detect`."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.boards.board import Board
from calib.boards.detect import find_board
from calib.errors import TargetNotFound
from calib.events.grey_image import to_uint8
from calib.view import View

Finder = Literal["sectors", "subpixel"]

_WINDOW_PX = 11
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)


def opencv_corners(
    image: NDArray[np.generic], board: Board, *, finder: Finder = "subpixel", name: str = "view"
) -> View:
    """Find the corners of a checkerboard by OpenCV alone.

    ``sectors``: ``findChessboardCornersSB`` (Duda and Frese, 2018); else ``findChessboardCorners``, ``cornerSubPix``.
    """
    grey = to_uint8(np.nan_to_num(np.asarray(image, np.float32)))
    corners = find_board(grey, board, name=name) if finder == "sectors" else _by_subpixel(grey, board, name)
    count = len(corners)
    return View(
        name=name,
        image_size=(grey.shape[1], grey.shape[0]),
        ids=np.arange(count, dtype=np.int64),
        points_px=corners,
        target_mm=board.points_mm,
        covariances_px2=np.tile(np.eye(2), (count, 1, 1)),
    )


def _by_subpixel(grey: NDArray[np.uint8], board: Board, name: str) -> NDArray[np.float64]:
    """Return (N, 2) px corners by ``findChessboardCorners`` and ``cornerSubPix``, for either contrast."""
    size, smooth = (board.columns, board.rows), cv2.medianBlur(grey, 3)
    for shown in (smooth, np.asarray(255 - smooth, np.uint8)):
        ok, corners = cv2.findChessboardCorners(shown, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH)
        if ok:
            window = (_WINDOW_PX, _WINDOW_PX)
            found = cv2.cornerSubPix(cv2.GaussianBlur(shown, (0, 0), 2.0), corners, window, (-1, -1), _STOP)
            return np.asarray(found, np.float64).reshape(-1, 2)
    raise TargetNotFound(
        f"No checkerboard of {board.columns} x {board.rows} inner corners was found.",
        where=f"view {name}",
        remedy="Show the whole board, in focus.",
    )
