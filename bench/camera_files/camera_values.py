"""One camera from the values of a form: OpenCV's matrix, and the coefficients in the order of their lens model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from bench.camera_files.forms import CameraForm, Lens, OpenCv
from bench.camera_files.texts import OtherForm
from calib.arrays import Array
from calib.model.camera import PINHOLE, SKEW, CameraModel
from calib.model.lens import FISHEYE, OPENCV, OPENCV_LENGTHS

LensFamily = Literal["brown", "fisheye"]

_LEAST_SKEW_PX = 1e-9  # Less is rounding
_LEAST_NAMED = 5
"""Coefficients of OpenCV that are kept by name although they are zero: k1, k2, p1, p2, k3, which it writes at least."""
_OF_MATRIX = 9  # 3 x 3


def camera_of_form(
    form: CameraForm, family: LensFamily | None, size: tuple[int, int] | None
) -> tuple[CameraModel, Array | None]:
    """Return the camera that a form states, and its covariance.

    ``family`` says what the coefficients are, and ``size`` how large the image is, px, if the file does not.
    """
    matrix = _matrix(form.matrix)
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    coefficients = _coefficients(form.coefficients, _lens(form, family))
    skew = {SKEW: float(matrix[0, 1])} if abs(matrix[0, 1]) > _LEAST_SKEW_PX else {}
    camera = CameraModel(fx, fy, cx, cy, size_of(form.image_size(), size), {**coefficients, **skew})
    return _with_covariance(camera, form) if isinstance(form, OpenCv) else (camera, None)


def size_of(stated: Sequence[int] | None, given: tuple[int, int] | None) -> tuple[int, int]:
    """Return the size of the image, px, of a file that may state it and a person who may give it."""
    if not stated and not given:
        raise OtherForm(
            "it does not state the size of the image",
            "Give --image-size WIDTHxHEIGHT to `check`, `undistort` or `rig`; a sequence needs a file that states it.",
        )
    width, height = stated or given or ()
    if given not in (None, (width, height)):
        raise OtherForm(
            f"its image has {width} x {height} px, not those of --image-size", "Leave out --image-size."
        )
    return width, height


def _lens(form: CameraForm, family: LensFamily | None) -> Lens:
    """Return the names of the coefficients."""
    stated, asked = form.lens, FISHEYE if family == "fisheye" else OPENCV
    if stated is None:
        if family is None and len(form.coefficients) == len(FISHEYE) and any(form.coefficients):
            raise OtherForm(
                "it states four coefficients and no lens model: they are k1 k2 p1 p2, or those of a fisheye lens"
                " (cv2.fisheye)",
                "Give --lens brown or --lens fisheye, or write `fisheye_model: 0` or `fisheye_model: 1` into the file.",
            )
        return asked
    if family is not None and (stated is FISHEYE) != (asked is FISHEYE):
        raise OtherForm(f"its lens is not {family}", "Leave out --lens.")
    return stated


def _coefficients(stated: Sequence[float], names: Lens) -> dict[str, float]:
    """Return the coefficients by name: the one rule for their number. Those beyond the model's must be zero."""
    beyond = [at for at, value in enumerate(stated) if value and at >= len(names)]
    if beyond:
        raise OtherForm(
            f"its lens model has {len(names)} coefficients, but coefficient {beyond[0] + 1} is {stated[beyond[0]]:g}",
            "Correct the name of the model, or the coefficients.",
        )
    lengths = (len(FISHEYE),) if names is FISHEYE else (0, *OPENCV_LENGTHS)
    if min(len(stated), len(names)) not in lengths:
        raise OtherForm(
            f"{len(stated)} distortion coefficients are no camera's: there are {', '.join(map(str, lengths))}"
        )
    last = max((at + 1 for at, value in enumerate(stated) if value), default=0)
    used = next(
        length for length in lengths if length >= min(max(last, _LEAST_NAMED), len(stated), len(names))
    )
    return dict(zip(names[:used], stated, strict=False))


def _matrix(elements: Sequence[float]) -> Array:
    if len(elements) == len(PINHOLE):
        fx, fy, cx, cy = elements
        elements = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    if len(elements) != _OF_MATRIX:
        raise OtherForm(f"the camera matrix has {len(elements)} numbers; 9 are needed, or fx, fy, cx, cy")
    matrix = np.array(elements).reshape(3, 3)
    if not matrix[:2].any():
        raise OtherForm(
            "the camera is not calibrated: its camera matrix is zero", "Calibrate the camera first."
        )
    if not np.array_equal(matrix[2], [0.0, 0.0, 1.0]) or matrix[1, 0]:
        turned = "; it is transposed, as in MATLAB" if np.array_equal(matrix[:, 2], [0.0, 0.0, 1.0]) else ""
        raise OtherForm(f"the camera matrix is not fx 0 cx, 0 fy cy, 0 0 1, row after row{turned}")
    return matrix


def _with_covariance(camera: CameraModel, form: OpenCv) -> tuple[CameraModel, Array | None]:
    """Take the rows of the camera's values; a coefficient of zero that was not estimated is left out."""
    if form.covariance is None or form.names is None:
        return camera, None
    if len(form.covariance) != len(form.names) ** 2:
        raise OtherForm("the covariance has another size than its names")
    estimated = replace(camera, distortion={k: v for k, v in camera.distortion.items() if k in form.names})
    if not set(estimated.parameter_names) <= set(form.names):
        raise OtherForm("the covariance lacks a value of the camera")
    at = [form.names.index(name) for name in estimated.parameter_names]
    whole = np.reshape(form.covariance, (len(form.names), len(form.names)))
    return estimated, whole[np.ix_(at, at)]
