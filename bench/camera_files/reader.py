"""Reads one calibrated camera from a file: a run's, an export of ours, or one of another program."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from bench.base.errors import UsageError
from bench.camera_files.camera_values import LensFamily, camera_of_form, size_of
from bench.camera_files.forms import LARGEST, LONGEST_NAME, Values, cameras_of, form_of
from bench.camera_files.possible_camera import is_far_from_middle, require_possible_camera
from bench.camera_files.texts import MOST_FILE_BYTES, OtherForm, values_of
from bench.record.run_folder import RESULTS
from bench.record.storage import read_bounded
from bench.record.stored_calibration import camera_covariance, camera_of
from calib.arrays import Array
from calib.model.camera import CameraModel

_MOST_NAMED = 10
"""Cameras that a message shows: a line or two of a terminal."""
_NEGATIVE = 1e-6
"""Least eigenvalue of a covariance, as a share of the largest: rounding."""
_OF_OTHER_FORM = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError)
"""What results of another form raise."""
READ: Final = (
    "Read are results.json of a run, and files of OpenCV (YAML, XML, JSON, or npz with mtx and dist), ROS"
    " (camera_info), Kalibr (camchain), Metavision (intrinsics.json, camera-geometry.json), COLMAP (cameras.txt) and"
    " mrcal (cameramodel): docs/extras/tools/check.md."
)


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


def read_camera_file(
    path: Path,
    name: str | None = None,
    lens: LensFamily | None = None,
    image_size: tuple[int, int] | None = None,
) -> CameraFile:
    """Read the camera of a run folder or of a file.

    ``name`` is that of the camera if the file holds several. ``lens``, the family of the coefficients, and
    ``image_size``, px, are for files that do not state them; what contradicts the file is refused.
    """
    file = path / RESULTS if path.is_dir() else path
    if file != path and not file.is_file():
        raise NotACamera(
            f"This folder holds no {RESULTS}.", where=str(path), remedy="Name a run folder or a file in it."
        )
    if file.is_file() and file.stat().st_size > MOST_FILE_BYTES:
        raise NotACamera(f"A calibration has at most {MOST_FILE_BYTES} bytes.", where=str(file), remedy=READ)
    return parse_camera(read_bounded(file, MOST_FILE_BYTES), file, name, lens, image_size)


def parse_camera(
    data: bytes,
    file: Path,
    name: str | None = None,
    lens: LensFamily | None = None,
    image_size: tuple[int, int] | None = None,
) -> CameraFile:
    """Read the camera that the bytes of a file hold, as `read_camera_file`."""
    try:
        syntax, content = values_of(data)
        ours = content.get("calibration")
        if isinstance(ours, dict) and "camera" in ours:
            size = size_of(ours["image_size"], image_size)
            camera = camera_of(ours["camera"], size)
            covariance = camera_covariance(ours["camera"], ours.get("covariance"))
            kind, remarks = "the result of a run", list[str]()
        else:
            form = form_of(syntax, _chosen(cameras_of(syntax, content), name))
            camera, covariance = camera_of_form(form, lens, image_size)
            kind, remarks = form.kind.format(syntax), form.remarks
        require_possible_camera(camera)
        _require_possible(covariance)
    except _OF_OTHER_FORM as error:
        known = error if isinstance(error, OtherForm) else OtherForm("a value has another form")
        raise NotACamera(
            f"This file does not hold a calibrated camera that can be read: {known}.",
            where=str(file),
            remedy=known.remedy or READ,
        ) from error
    return CameraFile(file, data, kind, camera, covariance, (*remarks, *_remarks_about(camera)))


def _chosen(cameras: Mapping[str, Values], name: str | None) -> Values:
    """Return the camera of a name, or the only one. Raises OtherForm if it is not clear."""
    listed = ", ".join(camera[:LONGEST_NAME] for camera in list(cameras)[:_MOST_NAMED])
    if name is None and len(cameras) == 1:
        return next(iter(cameras.values()))
    if name is None:
        raise OtherForm(
            f"it holds {len(cameras)} cameras: {listed}",
            "Name one with --camera, or copy it to a file of its own.",
        )
    if name not in cameras:
        raise OtherForm(f"it has no camera {name!r}", f"It holds {listed or 'one camera without a name'}.")
    return cameras[name]


def _require_possible(covariance: Array | None) -> None:
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
