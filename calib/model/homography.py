"""The homography of one view: from the target plane to the image, fitted to stars on both, without a camera.

It ignores lens distortion, so it is only a starting value. Stars that contradict their neighbours would spoil it, so
they are found here too (`gross_errors`).
"""

from __future__ import annotations

import numpy as np

from calib.arrays import Array, Bools, median
from calib.errors import DegenerateViews, InputMismatch, TooFewStars, placed
from calib.model.local_consistency import Nearest, contradicts_neighbours, nearest_stars
from calib.view import View

MIN_STARS = 4  # Eight unknowns, two numbers a point
_REWEIGHTING_ROUNDS = 15  # At most: it ends when no outlier is left
#: A residual above this multiple of the typical one is an outlier: distortion alone does not cause it.
_OUTLIER_RATIO = 4.0
#: Largest number of samples of four stars for the least median, and the probability that one of them holds right stars.
_SAMPLES, _CONFIDENCE = 2000, 1.0 - 1e-9


def fit_homography(grid: Array, points: Array) -> Array:
    """Fit the homography of (N, 2) grid positions and points, px (OpenCV's ``findHomography``), or `TooFewStars`."""
    import cv2

    h = cv2.findHomography(grid, points, 0)[0] if len(grid) >= MIN_STARS else None
    if h is None or not np.isfinite(h).all():
        raise TooFewStars(
            f"Cannot fit a homography: {len(grid)} points; at least {MIN_STARS} that are not collinear are needed.",
            remedy="Turn the camera so that more of the target is in view.",
        )
    return np.asarray(h, np.float64)


def fit_affine(grid: Array, points: Array) -> Array:
    """Fit an affine map, (3, 3) with last row 0 0 1, to N >= 3 points (Hartley and Zisserman, 2004, section 2.4)."""
    design = np.column_stack([grid, np.ones(len(grid))])
    solution = np.linalg.lstsq(design, points, rcond=None)[0]
    return np.vstack([solution.T, [0.0, 0.0, 1.0]])


def view_homography(view: View) -> Array:
    """Fit the homography H of a view: [u v 1] ~ H [X Y 1], px from mm (arXiv:2512.16092, eq. 1).

    The algorithm is the normalised direct linear transform (Hartley, 1997; Hartley and Zisserman, 2004, algorithm 4.2).
    It is repeated with lower weights for outliers (iteratively reweighted least squares). H is scaled to determinant 1.
    With this scale H = lambda K [r1 r2 -Rc] has the same lambda in all views of a collimator, because det H = lambda^3
    det(K) r. The weights 1 / (1 + (e / s)^2) are those of the Cauchy loss (Holland and Welsch, 1977). Stars with gross
    errors take no part (`gross_errors`).
    Raises TooFewStars: If the view has fewer than 4 stars.
    Raises DegenerateViews: If all stars lie on one line, on the target or in the image.
    Raises InputMismatch: If the image shows the target mirrored.
    """
    with placed(f"view {view.name}"):
        h = rough_homography(view)
        depth = view.target_mm @ h[2, :2] + h[2, 2]
        h = h * np.sign(median(depth))  # the target stands in front of the camera
        determinant = np.linalg.det(h)
        if not abs(determinant) > 0.0:
            raise DegenerateViews(
                "All its points lie on one line in the image.", remedy="Leave this view out."
            )
        if determinant < 0.0:
            raise InputMismatch(
                "The target appears mirrored.",
                remedy="Check the target's axes: seen from the camera, X goes right and Y down.",
            )
        return np.asarray(h / np.cbrt(determinant))


def gross_errors(view: View) -> Bools:
    """Return which stars of a view have a gross error: a point or an id that the neighbours on the target contradict.

    The rule is that of `calib.model.local_consistency.contradicts_neighbours`. If a star contradicts its neighbours,
    the homography is found again by the least median of squares (Rousseeuw, 1984), which up to half of the stars cannot
    spoil, and the stars are tested again. All False for fewer than 8 stars. Errors as of `rough_homography`.
    """
    return view.remembered("homography", _fit_without_gross_errors)[1]


def rough_homography(view: View) -> Array:
    """Return the homography of a view as `view_homography`, at any scale and also if the target appears mirrored.

    Raises TooFewStars: If the view has fewer than 4 stars.
    Raises DegenerateViews: If all stars lie on one line, on the target or in the image.
    """
    return view.remembered("homography", _fit_without_gross_errors)[0]


def neighbours_of(view: View) -> Nearest:
    """Return the neighbours of the at least 2 stars of a view, which are found once."""
    return view.remembered("neighbours", lambda of: nearest_stars(of.target_mm))


def _fit_without_gross_errors(view: View) -> tuple[Array, Bools]:
    """Return the (3, 3) homography of any scale, and which stars were left out of it, (N,) bool."""
    with placed(f"view {view.name}"):
        if len(view) < MIN_STARS:
            raise TooFewStars(
                f"{len(view)} points; at least {MIN_STARS} are needed.", remedy="Leave this view out."
            )
        h = _reweighted_homography(view.target_mm, view.points_px)
        wrong = _wrong_about(h, view)
        if not wrong.any():
            return h, wrong
        h = _least_median_homography(view.target_mm, view.points_px)
        wrong = _wrong_about(h, view)
        # The least median has no hold where more than half are wrong; such a view is refused by `calib.diagnosis`.
        if len(view) - np.count_nonzero(wrong) < max(MIN_STARS, len(view) // 2):
            return _reweighted_homography(view.target_mm, view.points_px), wrong
        return _reweighted_homography(view.target_mm[~wrong], view.points_px[~wrong]), wrong


def _wrong_about(h: Array, view: View) -> Bools:
    """Return which stars contradict their neighbours after subtraction of a homography, (N,) bool."""
    with np.errstate(divide="ignore", invalid="ignore"):
        mapped = apply_homography(h, view.target_mm)
    if not np.isfinite(mapped).all():
        # Stars on the horizon of a wrong homography: any smooth map will do.
        mapped = apply_homography(fit_affine(view.target_mm, view.points_px), view.target_mm)
    variances = np.trace(view.covariances_px2, axis1=1, axis2=2)
    stated = bool(variances.min() > 0.0 and variances.max() > variances.min())
    return contradicts_neighbours(
        view.target_mm,
        mapped,
        view.points_px,
        np.sqrt(variances) if stated else None,
        neighbours_of(view),
    )


def _reweighted_homography(target_mm: Array, points_px: Array) -> Array:
    """Return the homography of least squares, with lower weights for outliers (Holland and Welsch, 1977)."""
    target, to_target = _normalised(target_mm)
    image, to_image = _normalised(points_px)
    weights = np.ones(len(target))
    for _ in range(_REWEIGHTING_ROUNDS):
        h = _direct_linear_transform(target, image, weights)
        residuals = np.linalg.norm(apply_homography(h, target) - image, axis=1)
        # A typical star keeps two thirds of its weight; points without errors have a median of zero.
        scale = 1.5 * median(residuals) + 1e-12
        if residuals.max() < _OUTLIER_RATIO * scale:
            break
        weights = 1.0 / (1.0 + (residuals / scale) ** 2)
    return np.asarray(np.linalg.inv(to_image) @ h @ to_target)


def _least_median_homography(target_mm: Array, points_px: Array) -> Array:
    """Return the homography with the least median residual (Rousseeuw, 1984), by OpenCV."""
    import cv2

    h = cv2.findHomography(target_mm, points_px, cv2.LMEDS, maxIters=_SAMPLES, confidence=_CONFIDENCE)[0]
    return _reweighted_homography(target_mm, points_px) if h is None else np.asarray(h, np.float64)


def apply_homography(h: Array, points: Array) -> Array:
    """Map (N, 2) points by a homography (Hartley and Zisserman, 2004, section 2.3)."""
    mapped = points @ h[:, :2].T + h[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def linear_at(h: Array, grid: Array) -> Array:
    """Return the (N, 2, 2) Jacobian of a homography, px per pitch, at (N, 2) grid positions, pitches.

    Own derivation, by the quotient rule: with [p q w] = H [x y 1], du/dx = (h11 - u h31) / w, and so on.
    """
    q = grid @ h[:, :2].T + h[:, 2]
    at = apply_homography(h, grid)
    return np.asarray((h[None, :2, :2] - at[:, :, None] * h[None, 2:, :2]) / q[:, 2, None, None])


def _normalised(points: Array) -> tuple[Array, Array]:
    """Centre points and scale them to mean distance sqrt 2 (Hartley, 1997); return also the (3, 3) similarity used."""
    mean = points.mean(axis=0)
    offset = points - mean
    narrow, wide = np.linalg.eigvalsh(offset.T @ offset)
    if not narrow > 1e-6 * wide:
        raise DegenerateViews("All its points lie on one line.", remedy="Leave this view out.")
    scale = np.sqrt(2.0) / np.hypot(offset[:, 0], offset[:, 1]).mean()
    similarity = np.array([[scale, 0.0, -scale * mean[0]], [0.0, scale, -scale * mean[1]], [0.0, 0.0, 1.0]])
    return offset * scale, similarity


def _direct_linear_transform(source: Array, image: Array, weights: Array) -> Array:
    """Return the H of the least weighted algebraic error of normalised points (Hartley and Zisserman, 2004, 4.1)."""
    homogeneous = np.column_stack([source, np.ones(len(source))]) * weights[:, None]
    u, v = image.T
    zero = np.zeros_like(homogeneous)
    upper = np.hstack([homogeneous, zero, -u[:, None] * homogeneous])
    lower = np.hstack([zero, homogeneous, -v[:, None] * homogeneous])
    rows = np.concatenate([upper, lower])
    # Normalised points make the squares well-conditioned.
    return np.asarray(np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3))
