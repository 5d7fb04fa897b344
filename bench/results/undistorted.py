"""The files of `starbench undistort`: rays, rectified pixels, ``cv2.remap``, preview; all calculated before writing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.base.errors import UsageError
from bench.results.exports import camera_info, refuse_skew
from bench.results.view_sources import picture_of
from calib.boards.board import Board
from calib.boards.detect import detect_board
from calib.events.grey_image import to_uint8
from calib.model.camera import CameraModel, Undistortion, straightness_px
from calib.view import View

TABLES, CAMERA_INFO, PREVIEW = "undistort.npz", "camera_info.yaml", "preview.png"
_GAP_PX = 8


@dataclass(frozen=True)
class Straightness:
    """How straight the rows and columns of a board are: RMS distance of its points from straight lines, px."""

    points: int
    before_px: float
    after_px: float


def undistorted_files(
    camera: CameraModel, found: Undistortion, preview: NDArray[Any] | None
) -> Mapping[str, bytes]:
    """Return the files by name; the preview is an (H, W) picture of the camera. FormatCannotCarry: it has skew."""
    refuse_skew(camera, CAMERA_INFO)
    matrix = found.camera.matrix
    tables = BytesIO()
    np.savez_compressed(
        tables,
        rays=found.rays,
        rectified_px=found.rectified_px,
        map_x=found.map_px[..., 0],
        map_y=found.map_px[..., 1],
        camera_matrix=matrix,
        projection_matrix=np.column_stack([matrix, np.zeros(3)]),
    )
    files = {TABLES: tables.getvalue(), CAMERA_INFO: camera_info(camera, "camera", matrix)}
    if preview is not None:
        files[PREVIEW] = cv2.imencode(".png", _side_by_side(preview, found))[1].tobytes()
    return files


def read_picture_for(path: Path, camera: CameraModel) -> NDArray[Any]:
    """Return the picture of a recording or a photograph, if it has one of this camera's size."""
    picture = picture_of(path)
    height, width = picture.shape[:2]
    if (width, height) != camera.image_size:
        raise UsageError(
            f"This picture has {width} x {height} px, the camera {camera.image_size[0]} x {camera.image_size[1]} px.",
            where=str(path),
            remedy="Give a recording of the camera that was calibrated, with the whole sensor.",
        )
    return picture


def board_straightness(
    picture: NDArray[Any], board: Board, found: Undistortion, camera: CameraModel, name: str
) -> Straightness:
    """Find a board in a picture, and return how straight its rows and columns are, before and after."""
    view = detect_board(picture, board, name=name)
    rays = camera.rays(view.points_px)
    lines = _lines(view, board)
    return Straightness(
        len(view),
        straightness_px(view.points_px, lines),
        straightness_px(found.camera.project(rays), lines),
    )


def _lines(view: View, board: Board) -> list[NDArray[np.int64]]:
    """Return the points of a view that lie on each row and each column of the board."""
    nodes = board.nodes[view.ids]
    return [np.flatnonzero(nodes[:, axis] == value) for axis in (0, 1) for value in np.unique(nodes[:, axis])]


def _side_by_side(picture: NDArray[Any], found: Undistortion) -> NDArray[np.uint8]:
    """Return the picture before and after, side by side."""
    before = to_uint8(picture)
    map_x, map_y = np.moveaxis(found.map_px, 2, 0)
    after = cv2.remap(before, map_x, map_y, cv2.INTER_LINEAR, borderValue=0)
    gap = np.full((len(before), _GAP_PX), 255, np.uint8)
    return np.hstack([before, gap, np.asarray(after, np.uint8)])
