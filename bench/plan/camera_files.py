"""Reads one calibrated camera from a file: a run's, an export of ours, OpenCV's, Kalibr's, ROS's or Metavision's.

A file is recognised by its content; what it does not state, such as a covariance, stays unknown.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.base.bounded_json import parse_json
from bench.base.errors import BenchError
from bench.records.storage import read_bounded
from bench.report.pose_plot import camera_covariance, camera_of
from calib.model.camera import CameraModel
from calib.model.lens import BROWN, FISHEYE
from sequences.yaml_text import parse

Array = NDArray[np.float64]

_MOST_BYTES = 20_000_000
_MOST_PX = 200_000_000
_LARGEST = 1e15
"""Of any value: a lens of long focal length has coefficients of 1e9."""
_NEGATIVE = 1e-6
"""Least eigenvalue of a covariance, as a share of the largest: rounding."""
OF_OTHER_FORM = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError)
"""What reading a file of another form raises."""
_RESULTS = "results.json"
_STORAGE = b"%YAML"
#: Number of coefficients of each distortion model of ROS, and of Kalibr's.
_ROS = {"plumb_bob": BROWN[:5], "rational_polynomial": BROWN[:8], "equidistant": FISHEYE, "fisheye": FISHEYE}
_KALIBR = {"radtan": BROWN[:4], "equidistant": FISHEYE, "none": ()}


def form_text(error: Exception) -> str:
    """Return what one of `OF_OTHER_FORM` says of a file, as a part of a sentence."""
    return (
        f"it has no {error}"
        if isinstance(error, KeyError)
        else str(error).strip() or "its form is another one"
    )


class NotACamera(BenchError):
    """A file does not hold one calibrated camera that can be read."""


@dataclass(frozen=True)
class CameraFile:
    """A calibrated camera as a file states it."""

    path: Path
    data: bytes
    kind: str  # What the file is, in words
    camera: CameraModel
    # (K, K) covariance in the order of `CameraModel.parameter_names`; None if the file states none.
    covariance: Array | None = None


def read_camera_file(path: Path) -> CameraFile:
    """Read the camera of a run folder or of a file; it must hold exactly one that can be represented."""
    file = path / _RESULTS if path.is_dir() else path
    return parse_camera(read_bounded(file, _MOST_BYTES), file)


def parse_camera(data: bytes, file: Path) -> CameraFile:
    """Read the camera that the bytes of a file hold, as `read_camera_file`."""
    try:
        kind, camera, covariance = _recognised(data, file)
        _require_possible(camera, covariance)
    except (*OF_OTHER_FORM, cv2.error, SystemError) as error:  # OpenCV raises SystemError at a torn file
        raise NotACamera(
            f"This file does not hold a calibrated camera: {form_text(error)}.",
            where=str(file),
            remedy="Known are results.json of a run, OpenCV's YAML, ROS's camera_info, Kalibr's camchain, and"
            " intrinsics.json and camera-geometry.json of the Metavision SDK.",
        ) from error
    return CameraFile(file, data, kind, camera, covariance)


def _require_possible(camera: CameraModel, covariance: Array | None) -> None:
    """Raise ValueError: If a value is not finite, a length is not positive, or the covariance is none."""
    lengths, sides = (camera.fx, camera.fy), camera.image_size
    if not (np.abs(camera.values) < _LARGEST).all() or min(lengths) < 1.0 or min(sides) < 1:
        raise ValueError("a value of the camera is not possible")
    if sides[0] * sides[1] > _MOST_PX:
        raise ValueError(f"an image of {sides[0]} x {sides[1]} px is not possible")
    if covariance is None:
        return
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    if not (np.abs(covariance) < _LARGEST).all() or (np.diag(covariance) < 0).any():
        raise ValueError("a variance is not possible")
    if np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0] < -_NEGATIVE * len(covariance):
        raise ValueError("the covariance matrix is not positive")


_Found = tuple[str, CameraModel, Array | None]


def _recognised(data: bytes, file: Path) -> _Found:
    if data.lstrip()[:1] == b"{":
        content = parse_json(data)
        if "calibration" in content:
            return _results(content["calibration"])
        if "type" in content:
            return "Metavision's camera-geometry.json", _geometry(content, file), None
        return _storage(data, "Metavision's intrinsics.json")
    if data.startswith(_STORAGE):
        return _storage(data, "OpenCV's YAML")
    tree = parse(data, str(file))
    if tree.faults or not isinstance(tree.value, dict):
        raise ValueError(tree.faults[0].message if tree.faults else "it is no mapping")
    if "distortion_model" in tree.value:
        return "ROS's camera_info", _ros(tree.value), None
    return "Kalibr's camchain", _kalibr(tree.value, file), None


def _results(calibration: Any) -> _Found:
    return (
        "the result of a run",
        camera_of(calibration["camera"], calibration["image_size"]),
        camera_covariance(calibration),
    )


def _storage(data: bytes, kind: str) -> _Found:
    """Read OpenCV's FileStorage, with the covariance that `exports.opencv_yaml` adds."""
    storage = cv2.FileStorage(data.decode(), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    matrix, coefficients = (_matrix(storage, name) for name in ("camera_matrix", "distortion_coefficients"))
    if matrix is None or coefficients is None or matrix.shape != (3, 3):
        raise KeyError("camera_matrix" if matrix is None else "distortion_coefficients")
    size = storage.getNode("image_size")
    if size.empty():
        sides = [int(storage.getNode(name).real()) for name in ("image_width", "image_height")]
    else:
        sides = [int(size.at(k).real()) for k in range(2)]
    fisheye = storage.getNode("fisheye_model").real() == 1
    names = FISHEYE if fisheye else BROWN
    camera = _camera(matrix, sides, dict(zip(names, coefficients.ravel().tolist(), strict=False)))
    covariance = _matrix(storage, "parameter_covariance")
    stated = storage.getNode("parameter_names")
    listed = [stated.at(k).string() for k in range(stated.size())] if covariance is not None else []
    return kind, *_with_covariance(camera, covariance, listed)


def _matrix(storage: cv2.FileStorage, name: str) -> Array | None:
    found = storage.getNode(name).mat()
    return None if found is None else np.asarray(found, np.float64)


def _with_covariance(
    camera: CameraModel, covariance: Array | None, names: Sequence[str]
) -> tuple[CameraModel, Array | None]:
    """Take the rows of the camera's values; a coefficient of zero that was not estimated is left out."""
    if covariance is None:
        return camera, None
    if covariance.shape != (len(names), len(names)):
        raise ValueError("the covariance has another size than its names")
    lens = {name: value for name, value in camera.distortion.items() if name in names}
    estimated = CameraModel(camera.fx, camera.fy, camera.cx, camera.cy, camera.image_size, lens)
    at = [names.index(name) for name in estimated.parameter_names]
    return estimated, covariance[np.ix_(at, at)]


def _geometry(content: Mapping[str, Any], file: Path) -> CameraModel:
    """Read the camera-geometry.json of Metavision SDK 5: K of 9 numbers by rows, D of 5: k1 k2 p1 p2 k3."""
    if content["type"] != "pinhole":
        raise NotACamera(
            f"The camera geometry has the type {content['type']!r}. Only `pinhole` is known: the maker does not"
            " publish how a fisheye is written.",
            where=str(file),
            remedy="Use another file of the same calibration, for example OpenCV's YAML.",
        )
    k, d = content["K"], content["D"]
    if len(k) != 9 or len(d) != 5:
        raise ValueError("K must have 9 numbers and D 5")
    matrix = np.array(k, np.float64).reshape(3, 3)
    return _camera(
        matrix, [content["width"], content["height"]], dict(zip(BROWN[:5], map(float, d), strict=True))
    )


def _ros(content: Mapping[str, Any]) -> CameraModel:
    model = content["distortion_model"]
    if model not in _ROS:
        raise ValueError(f"the distortion model {model!r} is not one of {', '.join(_ROS)}")
    coefficients = [float(number) for number in content["distortion_coefficients"]["data"]]
    if len(coefficients) > len(_ROS[model]):
        raise ValueError(f"{len(coefficients)} coefficients are too many for {model}")
    matrix = np.array(content["camera_matrix"]["data"], np.float64).reshape(3, 3)
    lens = dict(zip(_ROS[model], coefficients, strict=False))
    return _camera(matrix, [content["image_width"], content["image_height"]], lens)


def _kalibr(content: Mapping[str, Any], file: Path) -> CameraModel:
    if len(content) > 1:
        raise NotACamera(
            f"The file holds {len(content)} cameras: {', '.join(content)}.",
            where=str(file),
            remedy="Copy the one that you want to check into a file of its own.",
        )
    (one,) = content.values()
    model, lens = one["camera_model"], one["distortion_model"]
    if model != "pinhole" or lens not in _KALIBR:
        raise ValueError(f"a camera of the model {model!r} with {lens!r} distortion is not known")
    fx, fy, cx, cy = (float(number) for number in one["intrinsics"])
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    coefficients = dict(zip(_KALIBR[lens], map(float, one["distortion_coeffs"]), strict=lens != "none"))
    return _camera(matrix, one["resolution"], coefficients)


def _camera(matrix: Array, sides: Sequence[float], lens: Mapping[str, float]) -> CameraModel:
    if abs(matrix[0, 1]) > 1e-9:
        raise ValueError("the camera matrix has a skew")
    width, height = (int(side) for side in sides)
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return CameraModel(fx, fy, cx, cy, (width, height), dict(lens))
