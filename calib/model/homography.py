"""The homography of one view: target plane to image, from stars on both.

Knows planes and points; no camera. Lens distortion is ignored here, so the result is a start only.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.errors import DegenerateViews, InputMismatch, TooFewStars
from calib.view import View

Array = NDArray[np.float64]

MIN_STARS = 4
_REWEIGHTING_ROUNDS = 15
#: Distortion alone leaves no miss this many times the typical one.
_OUTLYING = 4.0


def fit_homography(grid: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least-squares homography from (N, 2) grid positions to (N, 2) px, (3, 3).

    Raises
    ------
    TooFewStars
        When they do not tell one: fewer than 4, or on a line.
    """
    h = cv2.findHomography(grid, points, 0)[0] if len(grid) >= 4 else None
    if h is None or not np.isfinite(h).all():
        raise TooFewStars(
            f"{len(grid)} stars tell no homography.", remedy="Turn the camera so that more stars are in view."
        )
    return np.asarray(h, np.float64)


def fit_affine(grid: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least-squares affine map from (N, 2) grid positions to (N, 2) px, as a (3, 3) homography."""
    design = np.column_stack([grid, np.ones(len(grid))])
    solution = np.linalg.lstsq(design, points, rcond=None)[0]
    return np.vstack([solution.T, [0.0, 0.0, 1.0]])


def view_homography(view: View) -> Array:
    """Return H, (3, 3), with [u v 1] ~ H [X Y 1] (px from mm), scaled to det H = 1.

    Normalised direct linear transform; stars far off are weighted down and the fit repeated. With this scale
    H = lambda K [r1 r2 -Rc] has one lambda for all views of a collimator: det H = lambda^3 det(K) r.

    Raises
    ------
    TooFewStars
        With fewer than 4 stars.
    DegenerateViews
        When the stars lie on a line, on the target or in the image.
    InputMismatch
        When the image shows the target mirrored.
    """
    where = f"view {view.name}"
    if len(view) < MIN_STARS:
        raise TooFewStars(
            f"{len(view)} stars; at least {MIN_STARS} are needed.", where=where, remedy="Leave this view out."
        )
    target, to_target = _normalised(view.target_mm, where)
    image, to_image = _normalised(view.points_px, where)
    weights = np.ones(len(view))
    for _ in range(_REWEIGHTING_ROUNDS):
        h = _direct_linear_transform(target, image, weights)
        misses = np.linalg.norm(apply_homography(h, target) - image, axis=1)
        scale = 1.5 * np.median(misses) + 1e-12
        if misses.max() < _OUTLYING * scale:
            break
        weights = 1.0 / (1.0 + (misses / scale) ** 2)
    return _oriented(np.linalg.inv(to_image) @ h @ to_target, view)


def apply_homography(h: Array, points: Array) -> Array:
    """Map points (N, 2) by a homography."""
    mapped = points @ h[:, :2].T + h[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _normalised(points: Array, where: str) -> tuple[Array, Array]:
    """Centre and scale points to mean distance sqrt 2 (Hartley); also the similarity that does it."""
    mean = points.mean(axis=0)
    spread = np.linalg.svd(points - mean, compute_uv=False)
    if not spread[1] > 1e-3 * spread[0]:
        raise DegenerateViews("Its stars lie on a line.", where=where, remedy="Leave this view out.")
    scale = np.sqrt(2.0) / np.linalg.norm(points - mean, axis=1).mean()
    similarity = np.array([[scale, 0.0, -scale * mean[0]], [0.0, scale, -scale * mean[1]], [0.0, 0.0, 1.0]])
    return (points - mean) * scale, similarity


def _direct_linear_transform(source: Array, image: Array, weights: Array) -> Array:
    """Minimise the weighted algebraic error; both point sets normalised."""
    homogeneous = np.column_stack([source, np.ones(len(source))]) * weights[:, None]
    rows = np.zeros((2, len(source), 9))
    rows[0, :, 0:3] = rows[1, :, 3:6] = homogeneous
    rows[0, :, 6:9] = -image[:, :1] * homogeneous
    rows[1, :, 6:9] = -image[:, 1:] * homogeneous
    # Four points give 8 rows, and the null vector stands in the full basis only.
    basis = np.linalg.svd(rows.reshape(-1, 9), full_matrices=len(source) == MIN_STARS)[2]
    return np.asarray(basis[-1].reshape(3, 3))


def _oriented(h: Array, view: View) -> Array:
    """Scale to determinant 1, with the target in front of the camera."""
    where = f"view {view.name}"
    depth = view.target_mm @ h[2, :2] + h[2, 2]
    h = h * np.sign(np.median(depth))
    determinant = np.linalg.det(h)
    if not abs(determinant) > 0.0:
        raise DegenerateViews("Its stars lie on a line in the image.", where=where, remedy="Leave it out.")
    if determinant < 0.0:
        raise InputMismatch(
            "It shows the target mirrored.",
            where=where,
            remedy="Check the target's axes: seen from the camera, X goes right and Y down.",
        )
    return np.asarray(h / np.cbrt(determinant))
