"""Reference methods on the same points: OpenCV, and the published recipe of the paper.

Their uncertainties contain star noise only. Compare residuals of left-out views, not reprojection errors.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from opencv_planar import NO_TANGENTIAL, RADIAL_2, by_opencv

from calib.adjustment.bundle import Bundle
from calib.adjustment.initialization import initialized
from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.calibration import Calibration, CalibrationOptions, rms_and_mean
from calib.errors import DegenerateViews, NotConverged
from calib.fit import fit_model
from calib.model.camera import PINHOLE, CameraModel
from calib.model.lens import BROWN
from calib.uncertainty.covariance import covariance_at_optimum, leave_one_out
from calib.view import View

#: Limit of the Huber loss: the paper does not state it.
_PUBLISHED_LIMIT_PX = 1.0


@dataclass(frozen=True)
class MethodResult:
    """Result of one method."""

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
    solved = calibration
    return MethodResult(solved.camera, solved.sigma, solved.rms_px, solved.mean_px, solved.left_out_rms_px)


def opencv_planar(views: Sequence[View], options: CalibrationOptions) -> MethodResult:
    """Calibrate by OpenCV's ``calibrateCamera`` (the method of Zhang, 2000): ``k1k2`` or ``k1k2k3p1p2``.

    The mean residual and that of left-out views are those of Starbench's planar model, which has the same optimum.
    Raises DegenerateViews: If OpenCV fails.
    """
    names = tuple(options.distortion)
    try:
        rms, matrix, coefficients, spread = by_opencv(views, 0 if "k3" in names else RADIAL_2 | NO_TANGENTIAL)
    except cv2.error as error:
        message = " ".join(str(error).split())
        raise DegenerateViews(f"OpenCV did not find a calibration: {message}", remedy="Add views.") from error
    values = dict(zip(BROWN, coefficients.tolist(), strict=False))
    pinhole = CameraModel.of_matrix(matrix, views[0].image_size)
    camera = replace(pinhole, distortion={name: values[name] for name in names})
    spreads = dict(zip((*PINHOLE, *BROWN), spread.tolist(), strict=False))
    sigma = {name: spreads[name] for name in (*PINHOLE, *names)}
    planar = fit_model(views, CalibrationOptions("planar", names, "l2"), "planar", leave_out=True)
    mean_px = _rms_and_mean(planar.bundle, planar.parameters)[1]
    return MethodResult(camera, sigma, float(rms), mean_px, planar.left_out_rms_px)


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
    return MethodResult(parameters.camera, sigma, *lengths, left_out)


def _rms_and_mean(bundle: Bundle, parameters: AdjustmentParameters) -> tuple[float, float]:
    """Return the root mean square and the mean length of the residuals, px."""
    return rms_and_mean(np.linalg.norm(bundle.residuals_px(parameters), axis=1))
