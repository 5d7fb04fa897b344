"""What the writers of the exports share: refusals of lenses that a format cannot carry, matrices, YAML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import yaml

from bench.base.errors import BenchError
from calib.calibration import Calibration
from calib.model.camera import BROWN, SKEW, CameraModel

PLUMB_BOB = BROWN[:5]
"""The coefficients of ROS's model plumb_bob, and of OpenCV with five coefficients."""


class FormatCannotCarry(BenchError):
    """The file format cannot represent this lens model, or these targets."""


def refuse_beyond(names: Sequence[str], camera: CameraModel, what: str) -> None:
    """Refuse a lens with other coefficients than a format has.

    Raises FormatCannotCarry: If the lens has others.
    """
    further = [name for name in camera.distortion if name not in names]
    if further:
        raise FormatCannotCarry(
            f"{what} cannot represent {', '.join(further)}.",
            remedy=f"For this format, calibrate with no other coefficients than {' '.join(names)}.",
        )


def refuse_skew(camera: CameraModel, what: str) -> None:
    """Refuse a camera with skew: the programs that read these formats ignore K[0, 1].

    Raises FormatCannotCarry: If it has skew.
    """
    if SKEW in camera.distortion:
        raise FormatCannotCarry(
            f"{what} cannot represent the skew of the camera matrix.",
            remedy="For this format, calibrate without skew. results.json has all values.",
        )


def refuse_fisheye(camera: CameraModel, what: str) -> None:
    """Refuse a fisheye lens.

    Raises FormatCannotCarry: If the lens is one.
    """
    if camera.is_fisheye:
        raise FormatCannotCarry(
            f"{what} cannot represent a fisheye lens (kb1 to kb4).",
            remedy="For this format, calibrate with k1k2k3p1p2 or rational.",
        )


def opencv_coefficients(camera: CameraModel) -> np.ndarray:
    """Return the coefficients of the lens in OpenCV's order.

    Returns: (5,) float64 k1 k2 p1 p2 k3, (8,) with k4 k5 k6 if the lens has them, or (4,) of a fisheye lens.
    """
    if camera.is_fisheye:
        return camera.fisheye_coefficients
    rational = set(camera.distortion) - set(PLUMB_BOB)
    return camera.coefficients[: 8 if rational else 5]


def target_poses(calibration: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses of the target in the camera's frame.

    Returns: (n, 3) float64 rotation vectors, rad, and (n, 3) float64 translations, mm: camera <- target.
    """
    rotations = calibration.rotations
    vectors = np.array([cv2.Rodrigues(rotation)[0].ravel() for rotation in rotations])
    return vectors, -np.einsum("nij,nj->ni", rotations, calibration.centres)


def image_size_fields(camera: CameraModel) -> dict[str, int]:
    """Return the size of the image as ROS and OpenCV name it.

    Returns: ``image_width`` and ``image_height``, px.
    """
    return {"image_width": camera.image_size[0], "image_height": camera.image_size[1]}


def ros_matrix(matrix: np.ndarray) -> dict[str, Any]:
    """Return a matrix as ROS writes it.

    matrix: (m, n) float64.
    Returns: ``rows``, ``cols`` and ``data``, row after row.
    """
    return {"rows": matrix.shape[0], "cols": matrix.shape[1], "data": matrix.ravel().tolist()}


def yaml_bytes(content: Mapping[str, Any]) -> bytes:
    """Return a YAML file with its keys in the given order.

    Returns: The file, UTF-8.
    """
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=10_000).encode()


def file_storage_bytes(extension: str, content: Mapping[str, Any]) -> bytes:
    """Return a file of ``cv::FileStorage``.

    extension: ``.yaml`` or ``.json``.
    Returns: The file; the same with OpenCV 4 and 5.
    """
    storage = cv2.FileStorage(extension, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in content.items():
        _store(storage, name, value)
    text = storage.releaseAndGetString()
    # OpenCV 4 and 5 write different first lines; both, and OpenCV 3, read this one.
    return text.replace("%YAML 1.2", "%YAML:1.0", 1).encode()


def _store(storage: cv2.FileStorage, name: str, value: Any) -> None:
    if isinstance(value, Mapping):
        storage.startWriteStruct(name, cv2.FILE_NODE_MAP)
        for key, item in value.items():
            _store(storage, key, item)
        storage.endWriteStruct()
    elif isinstance(value, list):
        storage.startWriteStruct(name, cv2.FILE_NODE_SEQ)
        for item in value:
            _store(storage, "", item)
        storage.endWriteStruct()
    else:
        storage.write(name, value if isinstance(value, int | str | float) else np.ascontiguousarray(value))
