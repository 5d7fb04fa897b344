"""Reference methods on the same points: OpenCV, and the published recipe of the paper.

Their uncertainties contain star noise only. Compare residuals of left-out views, not reprojection errors.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calib.adjustment.bundle import Bundle
from calib.adjustment.initialization import initialized
from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array
from calib.calibration import Calibration, CalibrationOptions, rms_and_mean
from calib.errors import DegenerateViews, InputMismatch, NotConverged
from calib.fit import fit_model
from calib.model.camera import PINHOLE, SKEW, CameraModel
from calib.model.lens import BROWN, FISHEYE, is_fisheye
from calib.uncertainty.covariance import covariance_at_optimum, leave_one_out
from calib.view import View

#: Limit of the Huber loss: the paper does not state it.
_PUBLISHED_LIMIT_PX = 1.0
#: OpenCV's largest number of steps, and the change of its parameters at which it stops.
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
_PUBLISHED = "published recipe, spherical"


@dataclass(frozen=True)
class MethodResult:
    """Result of one method."""

    name: str
    camera: CameraModel
    sigma: Mapping[str, float]
    # rms_px, mean_px: Root mean square and mean length of its residuals, px.
    rms_px: float
    mean_px: float
    # Root mean square residual of left-out views, of which only the rotation was adjusted, px; None with
    # fewer than 3 views.
    left_out_rms_px: float | None


def starbench_result(calibration: Calibration) -> MethodResult:
    """Return a calibration of Starbench in the form of a method's result."""
    name, solved = f"Starbench, {calibration.model} model", calibration
    return MethodResult(
        name, solved.camera, solved.sigma, solved.rms_px, solved.mean_px, solved.left_out_rms_px
    )


def opencv_planar(views: Sequence[View], options: CalibrationOptions) -> MethodResult:
    """Calibrate by OpenCV's ``calibrateCamera`` (the method of Zhang, 2000), with the same distortion coefficients.

    A fisheye lens is calibrated by OpenCV's ``fisheye.calibrate``, which states no uncertainties. The mean residual and
    that of left-out views are those of Starbench's planar model, which has the same optimum.
    Raises DegenerateViews: If OpenCV fails, or its result is not finite.
    Raises InputMismatch: If the options ask for skew, which OpenCV's model does not have.
    """
    names = tuple(options.distortion)
    if SKEW in names:
        raise InputMismatch("OpenCV's camera has no skew.", remedy="Compare without skew.")
    fisheye = is_fisheye(options.distortion)
    try:
        rms, matrix, distortion, spread = (_opencv_fisheye if fisheye else _opencv_brown)(views, names)
    except cv2.error as error:
        message = " ".join(str(error).split())
        raise DegenerateViews(f"OpenCV did not find a calibration: {message}", remedy="Add views.") from error
    if not (np.isfinite(rms) and np.isfinite(matrix).all() and np.isfinite(distortion).all()):
        raise DegenerateViews("OpenCV's calibration is not finite.", remedy="Add views from other angles.")
    family = FISHEYE if fisheye else BROWN
    coefficients = dict(zip(family, np.ravel(distortion).tolist(), strict=False))
    pinhole = CameraModel.of_matrix(matrix, views[0].image_size)
    camera = replace(pinhole, distortion={name: coefficients[name] for name in names})
    spreads = dict(zip((*PINHOLE, *family), np.ravel(spread).tolist(), strict=False))
    planar = fit_model(views, CalibrationOptions("planar", names, "l2"), "planar", leave_out=True)
    return MethodResult(
        _opencv_name(options),
        camera,
        {name: spreads[name] for name in (*PINHOLE, *names) if name in spreads},
        float(rms),
        _rms_and_mean(planar.bundle, planar.parameters)[1],
        planar.left_out_rms_px,
    )


def published_recipe(views: Sequence[View], options: CalibrationOptions) -> MethodResult:
    """Calibrate by arXiv:2512.16092: closed form (eq. 5), then Huber loss (eqs. 6, 7); sigmas by J^T J alone."""
    bundle, start = initialized(views, options.distortion, options.passport)
    loss = Loss("huber", _PUBLISHED_LIMIT_PX * bundle.observations.sigmas_per_px)
    refined = refine(bundle, start, loss)
    parameters = refined.parameters
    estimate = covariance_at_optimum(bundle, parameters, loss)
    if not refined.converged:
        raise NotConverged(f"It did not converge within {refined.iterations} steps.", remedy="Add views.")
    left_out = leave_one_out(bundle, parameters, loss)
    lengths = _rms_and_mean(bundle, parameters)
    sigma = replace(estimate, inconsistent=False).sigma  # not enlarged
    return MethodResult(_PUBLISHED, parameters.camera, sigma, *lengths, left_out)


def _rms_and_mean(bundle: Bundle, parameters: AdjustmentParameters) -> tuple[float, float]:
    """Return the root mean square and the mean length of the residuals, px."""
    return rms_and_mean(np.linalg.norm(bundle.residuals_px(parameters), axis=1))


def _opencv_name(options: CalibrationOptions) -> str:
    """Return the name of the OpenCV method for this lens."""
    return "OpenCV, planar (fisheye)" if is_fisheye(options.distortion) else "OpenCV, planar (Zhang)"


def _opencv_brown(views: Sequence[View], names: Sequence[str]) -> tuple[float, Array, Array, Array]:
    """Return OpenCV's rms, camera matrix, coefficients and their uncertainties, for Brown's model."""
    objects = [np.column_stack([v.target_mm, np.zeros(len(v))]).astype(np.float32)[:, None] for v in views]
    images = [v.points_px.astype(np.float32)[:, None] for v in views]
    size, flags = views[0].image_size, _brown_flags(names)
    rms, matrix, distortion, _, _, spread, _, _ = cv2.calibrateCameraExtended(
        objects, images, size, np.eye(3), np.zeros(5), flags=flags, criteria=_STOP
    )
    return float(rms), np.asarray(matrix, float), np.asarray(distortion, float), np.asarray(spread, float)


def _opencv_fisheye(views: Sequence[View], names: Sequence[str]) -> tuple[float, Array, Array, Array]:
    """Return OpenCV's rms, camera matrix and coefficients for a fisheye lens, and no uncertainties.

    It starts at our best closed form: OpenCV's own start, 180 degrees, is far from lenses that look into a collimator.
    """
    start = initialized(views, names, None, planar=True)[1].camera
    held = [f"FIX_K{name[-1]}" for name in FISHEYE if name not in names]
    rms, matrix, distortion, _, _ = cv2.fisheye.calibrate(
        [np.column_stack([v.target_mm, np.zeros(len(v))])[None] for v in views],
        [v.points_px[None].astype(float) for v in views],
        views[0].image_size,
        start.matrix,
        start.fisheye_coefficients,
        flags=sum(map(_fisheye_flag, ("RECOMPUTE_EXTRINSIC", "FIX_SKEW", "USE_INTRINSIC_GUESS", *held))),
        criteria=_STOP,
    )
    return float(rms), np.asarray(matrix, float), np.asarray(distortion, float), np.zeros(0)


def _fisheye_flag(name: str) -> int:
    """Return a flag of OpenCV's fisheye calibration, which OpenCV 5 keeps in its main module."""
    return int(getattr(cv2.fisheye if hasattr(cv2.fisheye, f"CALIB_{name}") else cv2, f"CALIB_{name}"))


def _brown_flags(names: Sequence[str]) -> int:
    """Return OpenCV's flags that estimate the named coefficients and hold all others at zero."""
    flags = 0 if {"p1", "p2"} & set(names) else cv2.CALIB_ZERO_TANGENT_DIST
    if {"k4", "k5", "k6"} & set(names):
        flags |= cv2.CALIB_RATIONAL_MODEL
    held = [name for name in BROWN if name.startswith("k") and name not in names]
    return int(flags + sum(getattr(cv2, f"CALIB_FIX_{name.upper()}") for name in held))
