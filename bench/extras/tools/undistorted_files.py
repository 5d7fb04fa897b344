"""Files of `starbench undistort`: the tables, the camera for ROS, and a preview."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.base.errors import UsageError
from bench.solve.exports import CAMERA_INFO, NOT_WRITTEN, FormatCannotCarry, camera_info, opencv_coefficients
from bench.solve.view_sources import picture_of
from calib.events.grey_image import to_uint8
from calib.model.camera import CameraModel, Undistortion

_TABLES, _PREVIEW = "undistort.npz", "preview.png"
_GAP_PX = 8  # A visible line between two pictures


def undistorted_files(
    camera: CameraModel, undistortion: Undistortion, preview: NDArray[Any] | None
) -> Mapping[str, bytes]:
    """Return the files by name; the preview is an (H, W) picture of the camera."""
    matrix = undistortion.camera.matrix
    tables = BytesIO()
    np.savez_compressed(
        tables,
        rays=undistortion.rays,
        rectified_px=undistortion.rectified_px,
        map_x=undistortion.map_px[..., 0],
        map_y=undistortion.map_px[..., 1],
        camera_matrix=camera.matrix,
        distortion=opencv_coefficients(camera),
        new_camera_matrix=matrix,
        projection_matrix=np.column_stack([matrix, np.zeros(3)]),
    )
    files = {_TABLES: tables.getvalue()}
    try:
        files[CAMERA_INFO] = camera_info(camera, "camera", matrix)
    except FormatCannotCarry as refusal:
        files[NOT_WRITTEN] = f"{CAMERA_INFO}: {refusal}\n".encode()
    if preview is not None:
        files[_PREVIEW] = cv2.imencode(".png", _side_by_side(preview, undistortion))[1].tobytes()
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


def _side_by_side(picture: NDArray[Any], undistortion: Undistortion) -> NDArray[np.uint8]:
    """Return the picture before and after, side by side."""
    before = to_uint8(picture)
    map_x, map_y = np.moveaxis(undistortion.map_px, 2, 0)
    after = cv2.remap(before, map_x, map_y, cv2.INTER_LINEAR, borderValue=0)
    gap = np.full((len(before), _GAP_PX), 255, np.uint8)
    return np.hstack([before, gap, np.asarray(after, np.uint8)])
