"""Calibration from one collimator image by angle invariance.

The angle between the rays of two stars does not depend on the pose of the camera.

Source of the constraint: Liang et al., "Flexible camera calibration using a collimator system", arXiv:2512.16113; the
solver is this project's own. Two stars at P_i and P_j on the reticle leave the collimator as parallel beams along
d = (P - C, r), with the foot C of its axis and its focal length r. The camera must see them under the same angle:

    angle(ray(p_i), ray(p_j)) = angle(d_i, d_j)

The rotation drops out. r and C must be known from elsewhere, because one image cannot tell them from the camera: a
longer collimator and a longer camera give the same image. A passport holds them; this method takes them as exact, so
its stated uncertainties hold the noise of the stars only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import csr_array

from calib.errors import NotConverged, TooFewStars
from calib.model.camera import CameraModel, distortion_names
from calib.model.homography import fit_homography
from calib.studies.reference_methods import MethodResult
from calib.view import View

Array = NDArray[np.float64]

_FEWEST_STARS = 20
#: Each star is paired with those that follow it by these shares of their number.
_STRIDES = (0.013, 0.057, 0.11, 0.19, 0.29, 0.37, 0.43, 0.5)
_STEP_PX = 1e-3


def calibrate_by_angles(
    view: View, r_mm: float, centre_mm: tuple[float, float], distortion: str = "k1k2"
) -> MethodResult:
    """Calibrate a camera from one image of a collimator that is known.

    Constraint: arXiv:2512.16113. Covariance by propagation of the stars' noise through the solution (Hartley and
    Zisserman, 2004, section 5.2).

    r_mm: Focal length of the collimator, mm.
    centre_mm: Foot of its axis on the target, mm.
    distortion: Distortion coefficients, such as ``k1k2``.
    Raises TooFewStars: If the view has fewer than 20 stars.
    Raises NotConverged: If the adjustment did not converge.
    """
    if len(view) < _FEWEST_STARS:
        raise TooFewStars(
            f"The image shows {len(view)} stars; one image needs {_FEWEST_STARS}.",
            where=f"view {view.name}",
            remedy="Use more images.",
        )
    names = distortion_names(distortion)
    beams = np.column_stack([view.target_mm - np.asarray(centre_mm), np.full(len(view), r_mm)])
    beams /= np.linalg.norm(beams, axis=1)[:, None]
    first, second = _pairs(len(view))
    known = _angles(beams, first, second)
    width, height = view.image_size

    def camera_of(parameters: Array) -> CameraModel:
        fx, fy, cx, cy, *lens = parameters.tolist()
        return CameraModel(fx, fy, cx, cy, view.image_size, dict(zip(names, lens, strict=True)))

    def misfit(parameters: Array) -> Array:
        return _angles(camera_of(parameters).rays(view.points_px), first, second) - known

    scale = np.sqrt(abs(np.linalg.det(fit_homography(view.target_mm, view.points_px)[:2, :2])))
    focal = float(scale) * r_mm
    start = np.array([focal, focal, (width - 1) / 2, (height - 1) / 2, *[0.0] * len(names)])
    steps = np.array([focal, focal, focal / 10, focal / 10, *[1.0] * len(names)])
    found = least_squares(misfit, start, x_scale=steps, method="trf", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    camera = camera_of(found.x)
    if not found.success or camera.fx <= 0 or camera.fy <= 0:
        raise NotConverged("The angles of one image did not determine the camera.", where=f"view {view.name}")
    residuals_px = found.fun * camera.fx
    spread = _spread(np.asarray(found.jac), camera, view, first, second)
    sigmas = np.sqrt(np.diag(spread)).tolist()
    stated = dict(zip(("fx", "fy", "cx", "cy", *names), sigmas, strict=True))
    rms, mean = float(np.sqrt(np.mean(residuals_px**2))), float(np.mean(np.abs(residuals_px)))
    return MethodResult("one image, angle invariance", camera, stated, rms, mean, None)


def _pairs(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the two stars of every pair that is compared."""
    every = np.arange(count)
    strides = sorted({max(1, round(share * count)) for share in _STRIDES})
    return np.tile(every, len(strides)), np.concatenate([(every + stride) % count for stride in strides])


def _angles(rays: Array, first: NDArray[np.int64], second: NDArray[np.int64]) -> Array:
    """Return the angles between pairs of rays, rad, exact for small angles (Kahan, 2006)."""
    a, b = _unit(rays)[first], _unit(rays)[second]
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1)))


def _spread(
    jacobian: Array, camera: CameraModel, view: View, first: NDArray[np.int64], second: NDArray[np.int64]
) -> Array:
    """Return the covariance of the parameters: the noise of the stars, through all pairs that share a star.

    Own derivation: with unit rays a and b, d angle = (cos(angle) a - b) . da / sin(angle).
    """
    rays = _unit(camera.rays(view.points_px))
    a, b = rays[first], rays[second]
    cosine = np.sum(a * b, axis=1)
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    to_first = (cosine[:, None] * a - b) / sine[:, None]
    to_second = (cosine[:, None] * b - a) / sine[:, None]
    rows = np.arange(len(first))
    entries = []
    for axis in range(2):
        moved = view.points_px.copy()
        moved[:, axis] += _STEP_PX
        slope = (_unit(camera.rays(moved)) - rays) / _STEP_PX
        for stars, direction in ((first, to_first), (second, to_second)):
            entries.append((np.sum(direction * slope[stars], axis=1), rows, 2 * stars + axis))
    values, at_rows, at_columns = (np.concatenate(each) for each in zip(*entries, strict=True))
    gradient = csr_array((values, (at_rows, at_columns)), shape=(len(first), 2 * len(view)))
    moved_by = (gradient.T @ np.linalg.pinv(jacobian).T).T.reshape(jacobian.shape[1], len(view), 2)
    return np.asarray(np.einsum("asi,sij,bsj->ab", moved_by, view.covariances_px2, moved_by))


def _unit(rays: Array) -> Array:
    return np.asarray(rays / np.linalg.norm(rays, axis=1)[:, None])
