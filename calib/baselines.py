"""What others would answer on the same points: OpenCV's planar calibration, and the published recipe.

Knows how each is run, to stand beside our own result. None of them says how sure it is of more than noise, and
neither has a better answer for being closer to its points: see the column of views left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calib import uncertainty
from calib.calibration import Calibration, CalibrationOptions
from calib.camera import PINHOLE, CameraModel
from calib.errors import DegenerateViews, InputMismatch
from calib.fit import begin
from calib.fit import fit as fit_model
from calib.lens import BROWN, is_fisheye
from calib.refine import Loss, refine
from calib.resample import MIN_VIEWS, leave_one_out
from calib.view import View

#: The published recipe names a Huber loss without its limit.
_PUBLISHED_LIMIT_PX = 1.0
_OPENCV_STEPS = 200
_OPENCV_EPSILON = 1e-12


@dataclass(frozen=True)
class Baseline:
    """One method's answer.

    Attributes
    ----------
    name
        The method.
    camera
        Its camera.
    sigma
        The uncertainties it states, by name of the parameter.
    rms_px, mean_px
        Length of its residuals over all stars.
    left_out_rms_px
        Residual of views it has not seen, only their rotation solved; None with fewer than 3 views.
    """

    name: str
    camera: CameraModel
    sigma: Mapping[str, float]
    rms_px: float
    mean_px: float
    left_out_rms_px: float | None


def ours(calibration: Calibration) -> Baseline:
    """Put our own calibration into the same row."""
    name = f"Starbench, {calibration.model} model"
    return Baseline(
        name,
        calibration.camera,
        calibration.sigma,
        calibration.rms_px,
        calibration.mean_px,
        calibration.left_out_rms_px,
    )


def opencv_planar(views: Sequence[View], options: CalibrationOptions) -> Baseline:
    """Calibrate by OpenCV's ``calibrateCamera`` (Zhang's method), with the same distortion coefficients.

    Raises
    ------
    DegenerateViews
        When OpenCV finds no calibration.
    InputMismatch
        For a fisheye lens.
    """
    names = tuple(options.distortion)
    if is_fisheye(dict.fromkeys(names, 0.0)):
        raise InputMismatch("OpenCV's planar calibration has no fisheye lens.", remedy="Leave it out.")
    objects = [np.column_stack([v.target_mm, np.zeros(len(v))]).astype(np.float32)[:, None] for v in views]
    images = [v.points_px.astype(np.float32)[:, None] for v in views]
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _OPENCV_STEPS, _OPENCV_EPSILON)
    try:
        rms, matrix, found, _, _, spread, _, _ = cv2.calibrateCameraExtended(
            objects, images, views[0].image_size, np.eye(3), np.zeros(5), flags=_flags(names), criteria=stop
        )
    except cv2.error as error:
        raise DegenerateViews(f"OpenCV finds no calibration: {error}.", remedy="Add views.") from error
    coefficients = dict(zip(BROWN, np.ravel(found)[: len(BROWN)].tolist(), strict=False))
    fx, fy, cx, cy = (float(matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    camera = CameraModel(fx, fy, cx, cy, views[0].image_size, {name: coefficients[name] for name in names})
    spreads = dict(zip((*PINHOLE, *BROWN), np.ravel(spread).tolist(), strict=False))
    planar = fit_model(views, CalibrationOptions("planar", names, "l2"), "planar", leave_out=True)
    lengths = np.linalg.norm(planar.bundle.misses_px(planar.state), axis=1)
    return Baseline(
        "OpenCV, planar (Zhang)",
        camera,
        {name: spreads[name] for name in (*PINHOLE, *names)},
        float(rms),
        float(lengths.mean()),
        planar.left_out.total_rms_px if planar.left_out else None,
    )


def published_recipe(views: Sequence[View], options: CalibrationOptions) -> Baseline:
    """Calibrate as the paper says: linear spherical solution, then Huber, no more; sigmas from J^T J alone."""
    bundle, start = begin(views, options, "spherical")
    loss = Loss("huber", _PUBLISHED_LIMIT_PX * bundle.observations.per_px)
    state = refine(bundle, start, loss).state
    known = uncertainty.at_optimum(bundle, state, loss)
    lengths = np.linalg.norm(bundle.misses_px(state), axis=1)
    left_out = leave_one_out(bundle, state, loss).total_rms_px if len(views) >= MIN_VIEWS else None
    sigmas = np.sqrt(np.diag(known.covariance)).tolist()
    return Baseline(
        "published recipe, spherical",
        state.camera,
        dict(zip(bundle.names, sigmas, strict=True)),
        float(np.sqrt(np.mean(lengths**2))),
        float(lengths.mean()),
        left_out,
    )


def _flags(names: Sequence[str]) -> int:
    """Return OpenCV's flags that free the named coefficients and hold all others at zero."""
    flags = 0 if {"p1", "p2"} & set(names) else cv2.CALIB_ZERO_TANGENT_DIST
    if {"k4", "k5", "k6"} & set(names):
        flags |= cv2.CALIB_RATIONAL_MODEL
    held = {name: getattr(cv2, f"CALIB_FIX_{name.upper()}") for name in BROWN if name.startswith("k")}
    for name, flag in held.items():
        flags |= 0 if name in names else flag
    return int(flags)
