"""Reads one calibrated camera from a file: a run's, an export of ours, or one of another program.

A file is recognised by its content, and every camera goes one way: names without case and punctuation, the model of the
lens as the file states it, one rule for the number of coefficients. Nothing is dropped in silence; what a file does not
state, such as a covariance, stays unknown.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from bench.base.errors import UsageError
from bench.plan.camera_layouts import cameras_of, chosen
from bench.plan.camera_text import OtherForm, values_of
from bench.plan.camera_values import Array, LensFamily, camera_of_values
from bench.plan.possible_camera import LARGEST, is_far_from_middle, require_possible_camera
from bench.plan.stated_values import OF_OTHER_FORM, Values, numbers_of, size_of_values
from bench.record.results import CameraData
from bench.record.run_folder import RESULTS
from bench.record.storage import read_bounded
from bench.record.stored_calibration import camera_covariance, camera_of
from calib.model.camera import CameraModel

_MOST_BYTES = 20_000_000
_NEGATIVE = 1e-6
"""Least eigenvalue of a covariance, as a share of the largest: rounding."""
_REGION = ("x_offset", "y_offset", "width", "height")
_KNOWN = (
    "Known are results.json of a run, and files of OpenCV (YAML, XML, JSON), ROS (camera_info, ost.txt), Kalibr, mrcal,"
    " COLMAP, Metavision, DV, Basalt, ORB-SLAM, VINS, MATLAB, Metashape and others (docs/check.md)."
)

#: What a file is, in words: the first whose syntax and names it has.
_KINDS = (
    ("OpenCV's XML", {"XML"}),
    ("COLMAP's cameras", {"COLMAP"}),
    ("ROS's ost.txt", {"INI", "cameramatrix", "rectification"}),
    ("mrcal's cameramodel", {"lensmodel"}),
    ("EuRoC's sensor.yaml", {"sensortype"}),
    ("Metavision's intrinsics.json", {"nkeptviews"}),
    ("Metavision's camera-geometry.json", {"type", "k", "JSON"}),
    ("Kalibr's camchain", {"distortioncoeffs", "distortionmodel", "intrinsics", "YAML"}),
    ("ROS's camera_info", {"distortionmodel", "cameramatrix", "cameraname"}),
    ("ROS's camera_info", {"distortionmodel", "k", "d", "p"}),
    ("OpenCV's YAML", {"cameramatrix", "distortioncoefficients", "YAML"}),
    ("OpenCV's JSON", {"cameramatrix", "distortioncoefficients", "JSON"}),
)
_Found = tuple[str, CameraModel, Array | None, tuple[str, ...]]


class NotACamera(UsageError):
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
    remarks: tuple[str, ...] = ()  # What a user must know about how the file was read, a sentence each


def read_camera_file(path: Path, name: str | None = None, lens: LensFamily | None = None) -> CameraFile:
    """Read the camera of a run folder or of a file.

    ``name`` is that of the camera if the file holds several; ``lens`` the family of the coefficients if it states none.
    """
    file = path / RESULTS if path.is_dir() else path
    if file != path and not file.is_file():
        raise NotACamera(
            f"This folder holds no {RESULTS}.", where=str(path), remedy="Name a run folder or a file in it."
        )
    if file.is_file() and file.stat().st_size > _MOST_BYTES:
        raise NotACamera(f"A calibration has at most {_MOST_BYTES} bytes.", where=str(file), remedy=_KNOWN)
    return parse_camera(read_bounded(file, _MOST_BYTES), file, name, lens)


def parse_camera(
    data: bytes, file: Path, name: str | None = None, lens: LensFamily | None = None
) -> CameraFile:
    """Read the camera that the bytes of a file hold, as `read_camera_file`."""
    try:
        kind, camera, covariance, remarks = _recognised(data, name, lens)
        _require_possible(camera, covariance)
    except OF_OTHER_FORM as error:
        raise NotACamera(
            (isinstance(error, OtherForm) and error.what)
            or f"This file does not hold a calibrated camera that can be read: {form_text(error)}.",
            where=str(file),
            remedy=(isinstance(error, OtherForm) and error.remedy) or _KNOWN,
        ) from error
    return CameraFile(file, data, kind, camera, covariance, (*remarks, *_remarks_about(camera)))


def form_text(error: Exception) -> str:
    """Return what one of `OF_OTHER_FORM` says of a file, as a part of a sentence."""
    if isinstance(error, KeyError):
        return f"it has no {error}"
    return str(error) if isinstance(error, OtherForm) else "a value has another form"


def _require_possible(camera: CameraModel, covariance: Array | None) -> None:
    """Raise OtherForm if camera or covariance are not possible."""
    require_possible_camera(camera)
    if covariance is None:
        return
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    if not (np.abs(covariance) < LARGEST).all() or (np.diag(covariance) < 0).any():
        raise OtherForm("a variance is not possible")
    if np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0] < -_NEGATIVE * len(covariance):
        raise OtherForm("the covariance matrix is not positive")


def _remarks_about(camera: CameraModel) -> Iterator[str]:
    """Yield what is remarkable about a camera."""
    if camera.skew:
        yield f"The skew K[0,1] = {camera.skew:g} px is used; OpenCV and ROS ignore it."
    if is_far_from_middle(camera, camera.image_size):
        x, y = (100.0 * np.array([camera.cx, camera.cy]) / camera.image_size).tolist()
        yield (
            f"The principal point ({camera.cx:.0f}, {camera.cy:.0f}) lies at {x:.0f} % of the width and {y:.0f} % of"
            " the height. Does the camera matrix belong to an image of this size, without binning and cropping?"
        )


def _recognised(data: bytes, name: str | None, lens: LensFamily | None) -> _Found:
    syntax, documents = values_of(data)
    ours = documents[0].get("calibration")
    if isinstance(ours, dict) and "camera" in ours:
        camera = camera_of(ours["camera"], ours["image_size"])
        return "the result of a run", camera, camera_covariance(cast("CameraData", ours)), ()
    cameras_values = [chosen(cameras_of(document), name) for document in documents]
    cameras = [camera_of_values(values_of_camera, lens) for values_of_camera in cameras_values]
    if any(values_of_camera != cameras[0] for values_of_camera in cameras):
        raise OtherForm(
            f"{len(cameras)} different cameras follow one another", "Copy one of them to a file of its own."
        )
    values = cameras_values[0]
    kind = next((words for words, marks in _KINDS if marks <= {syntax, *values}), f"the {syntax} file")
    kind = f"the file of {values['program']}" if "program" in values else kind
    camera, covariance = _with_covariance(cameras[0], values)
    return kind, camera, covariance, tuple(_remarks_on_region(values))


def _remarks_on_region(values: Values) -> Iterator[str]:
    """Yield that the images of a ROS camera are of a part of the sensor, or binned; the camera is of the whole one."""
    binning = [float(values.get(key) or 0) for key in ("binningx", "binningy")]
    if max(binning) > 1:
        yield f"Its images are binned by {binning[0]:g} x {binning[1]:g}; this camera is that of the whole image."
    region = values.get("roi")
    parts = [float(region.get(key) or 0) for key in _REGION] if isinstance(region, Mapping) else [0.0]
    if any(parts[:2]) or (any(parts) and (parts[2], parts[3]) != size_of_values(values)):
        yield "Its images are of a region of interest; this camera is that of the whole image."


def _with_covariance(camera: CameraModel, values: Values) -> tuple[CameraModel, Array | None]:
    """Take the rows of the camera's values; a coefficient of zero that was not estimated is left out."""
    stated, names = values.get("parametercovariance"), values.get("parameternames")
    if stated is None or names is None:
        return camera, None
    names = names.split() if isinstance(names, str) else list(map(str, names))
    covariance = numbers_of("the covariance", stated)
    if len(covariance) != len(names) ** 2:
        raise OtherForm("the covariance has another size than its names")
    estimated = replace(camera, distortion={k: v for k, v in camera.distortion.items() if k in names})
    if not set(estimated.parameter_names) <= set(names):
        raise OtherForm("the covariance lacks a value of the camera")
    at = [names.index(name) for name in estimated.parameter_names]
    return estimated, np.reshape(covariance, (len(names), len(names)))[np.ix_(at, at)]
