"""Reference methods on the same points: OpenCV's planar calibration, and the published recipe of the paper.

The uncertainties that they state contain star noise only. A smaller reprojection error is not a better calibration:
compare the residuals of left-out views.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.calibration import Calibration, CalibrationOptions
from calib.errors import CalibrationError, DegenerateViews, InputMismatch, NotConverged
from calib.fit import fit_model
from calib.fit.starts import initialize
from calib.model.camera import PINHOLE, SKEW, CameraModel
from calib.model.lens import BROWN, FISHEYE, is_fisheye
from calib.uncertainty.covariance import covariance_at_optimum
from calib.uncertainty.cross_validation import MIN_VIEWS, leave_one_out
from calib.view import View

Array = NDArray[np.float64]

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


@dataclass(frozen=True)
class MethodFailure:
    """A method without a result."""

    name: str
    why: str


def reference_results(
    views: Sequence[View], options: CalibrationOptions, *, at_infinity: bool = True
) -> list[MethodResult | MethodFailure]:
    """Calibrate the same points by every reference method; a method that fails gives its reason.

    at_infinity: Whether a collimator puts the target at infinity. The published recipe needs this.
    Returns: The published recipe, if the target is at infinity; then OpenCV.
    """
    rows: list[MethodResult | MethodFailure] = []
    methods = ((_PUBLISHED, published_recipe), (_opencv_name(options), opencv_planar))
    for name, method in methods if at_infinity else methods[1:]:
        try:
            rows.append(method(views, options))
        except CalibrationError as error:
            rows.append(MethodFailure(name, str(error)))
    return rows


def starbench_result(calibration: Calibration) -> MethodResult:
    """Return a calibration of Starbench in the form of a method's result."""
    name = f"Starbench, {calibration.model} model"
    return MethodResult(
        name,
        calibration.camera,
        calibration.sigma,
        calibration.rms_px,
        calibration.mean_px,
        calibration.left_out_rms_px,
    )


def opencv_planar(views: Sequence[View], options: CalibrationOptions) -> MethodResult:
    """Calibrate by OpenCV's ``calibrateCamera`` (the method of Zhang, 2000), with the same distortion coefficients.

    A fisheye lens is calibrated by OpenCV's ``fisheye.calibrate``, which states no uncertainties.

    Returns: OpenCV's result. The mean residual and that of left-out views are those of Starbench's planar
      model, which has the same optimum.
    Raises DegenerateViews: If OpenCV fails, or its result is not finite.
    Raises InputMismatch: If the options ask for skew, which OpenCV's model does not have.
    """
    names = tuple(options.distortion)
    if SKEW in names:
        raise InputMismatch("OpenCV's camera has no skew.", remedy="Compare without skew.")
    fisheye = _fisheye(options)
    try:
        rms, matrix, found, spread = (_opencv_fisheye if fisheye else _opencv_brown)(views, names)
    except cv2.error as error:
        message = " ".join(str(error).split())
        raise DegenerateViews(f"OpenCV did not find a calibration: {message}", remedy="Add views.") from error
    if not (np.isfinite(rms) and np.isfinite(matrix).all() and np.isfinite(found).all()):
        raise DegenerateViews("OpenCV's calibration is not finite.", remedy="Add views from other angles.")
    family = FISHEYE if fisheye else BROWN
    coefficients = dict(zip(family, np.ravel(found).tolist(), strict=False))
    fx, fy, cx, cy = (float(matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    camera = CameraModel(fx, fy, cx, cy, views[0].image_size, {name: coefficients[name] for name in names})
    spreads = dict(zip((*PINHOLE, *family), np.ravel(spread).tolist(), strict=False))
    planar = fit_model(views, CalibrationOptions("planar", names, "l2"), "planar", leave_out=True)
    lengths = np.linalg.norm(planar.bundle.residuals_px(planar.parameters), axis=1)
    return MethodResult(
        _opencv_name(options),
        camera,
        {name: spreads[name] for name in (*PINHOLE, *names) if name in spreads},
        float(rms),
        float(lengths.mean()),
        planar.cross_validation.total_rms_px if planar.cross_validation else None,
    )


def published_recipe(views: Sequence[View], options: CalibrationOptions) -> MethodResult:
    """Calibrate by the published recipe of arXiv:2512.16092: closed form (eq. 5), then Huber loss (eqs. 6 and 7).

    The uncertainties come from J^T J alone.

    Raises DegenerateViews: If the views do not constrain a parameter.
    Raises NotConverged: If the adjustment did not reach an optimum.
    """
    bundle, start = initialize(views, options, "spherical")
    loss = Loss("huber", _PUBLISHED_LIMIT_PX * bundle.observations.sigmas_per_px)
    refined = refine(bundle, start, loss)
    parameters = refined.parameters
    estimate = covariance_at_optimum(bundle, parameters, loss)
    if not refined.converged:
        raise NotConverged(
            f"The adjustment did not converge within {refined.iterations} steps.", remedy="Add views."
        )
    lengths = np.linalg.norm(bundle.residuals_px(parameters), axis=1)
    left_out = leave_one_out(bundle, parameters, loss).total_rms_px if len(views) >= MIN_VIEWS else None
    sigmas = np.sqrt(np.diag(estimate.covariance)).tolist()
    return MethodResult(
        _PUBLISHED,
        parameters.camera,
        dict(zip(bundle.names, sigmas, strict=True)),
        float(np.sqrt(np.mean(lengths**2))),
        float(lengths.mean()),
        left_out,
    )


def _fisheye(options: CalibrationOptions) -> bool:
    """Tell whether the options ask for a fisheye lens."""
    return is_fisheye(dict.fromkeys(tuple(options.distortion), 0.0))


def _opencv_name(options: CalibrationOptions) -> str:
    """Return the name of the OpenCV method for this lens."""
    return "OpenCV, planar (fisheye)" if _fisheye(options) else "OpenCV, planar (Zhang)"


def _opencv_brown(views: Sequence[View], names: Sequence[str]) -> tuple[float, Array, Array, Array]:
    """Return OpenCV's rms, camera matrix, coefficients and their uncertainties, for Brown's model."""
    objects = [np.column_stack([v.target_mm, np.zeros(len(v))]).astype(np.float32)[:, None] for v in views]
    images = [v.points_px.astype(np.float32)[:, None] for v in views]
    rms, matrix, found, _, _, spread, _, _ = cv2.calibrateCameraExtended(
        objects,
        images,
        views[0].image_size,
        np.eye(3),
        np.zeros(5),
        flags=_brown_flags(names),
        criteria=_STOP,
    )
    return float(rms), np.asarray(matrix, float), np.asarray(found, float), np.asarray(spread, float)


def _opencv_fisheye(views: Sequence[View], names: Sequence[str]) -> tuple[float, Array, Array, Array]:
    """Return OpenCV's rms, camera matrix and coefficients for a fisheye lens, and no uncertainties.

    OpenCV starts with a field of view of 180 degrees, far from lenses that look into a collimator. The best of our
    closed forms is used as start instead.
    """
    start = initialize(views, CalibrationOptions("planar", names, "l2"), "planar")[1].camera
    held = [f"FIX_K{name[-1]}" for name in FISHEYE if name not in names]
    rms, matrix, found, _, _ = cv2.fisheye.calibrate(
        [np.column_stack([v.target_mm, np.zeros(len(v))])[None] for v in views],
        [v.points_px[None].astype(float) for v in views],
        views[0].image_size,
        start.matrix,
        start.fisheye_coefficients,
        flags=sum(map(_fisheye_flag, ("RECOMPUTE_EXTRINSIC", "FIX_SKEW", "USE_INTRINSIC_GUESS", *held))),
        criteria=_STOP,
    )
    return float(rms), np.asarray(matrix, float), np.asarray(found, float), np.zeros(0)


def _fisheye_flag(name: str) -> int:
    """Return a flag of OpenCV's fisheye calibration, which OpenCV 5 keeps in its main module."""
    return int(getattr(cv2.fisheye if hasattr(cv2.fisheye, f"CALIB_{name}") else cv2, f"CALIB_{name}"))


def _brown_flags(names: Sequence[str]) -> int:
    """Return OpenCV's flags that estimate the named coefficients and hold all others at zero."""
    flags = 0 if {"p1", "p2"} & set(names) else cv2.CALIB_ZERO_TANGENT_DIST
    if {"k4", "k5", "k6"} & set(names):
        flags |= cv2.CALIB_RATIONAL_MODEL
    held = {name: getattr(cv2, f"CALIB_FIX_{name.upper()}") for name in BROWN if name.startswith("k")}
    for name, flag in held.items():
        flags |= 0 if name in names else flag
    return int(flags)
