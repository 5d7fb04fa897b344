"""Closed forms: camera matrix, collimator and poses from the homographies of the views.

In the spherical motion model, with homographies scaled to determinant 1, all views share one equation
(arXiv:2512.16092, eq. 5):
H^-1 K K^T H^-T = s [[r^2 + x^2, xy, x], [xy, r^2 + y^2, y], [x, y, 1]].
It is linear in the entries of K K^T and in those of the right side. Distortion and noise are not modelled, so the
solutions are only starting values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calib.arrays import Array
from calib.model.collimator import Collimator
from calib.model.rotation import nearest_rotation, skew

_UPPER = np.triu_indices(3)
#: Entries of K K^T that may be unknown; (2, 2) is 1.
_IMAGE = ((0, 0), (1, 1), (0, 2), (1, 2), (0, 1))


def linear_solution(
    homographies: Array, image_size: tuple[int, int], *, free_principal_point: bool
) -> tuple[Array, Collimator] | None:
    """Solve the shared equation of n views by linear least squares (arXiv:2512.16092, eq. 5) for (3, 3) K, px, and c.

    It takes (n, 3, 3) homographies of `view_homography`; n >= 2, or n >= 3 with a free principal point, which is
    otherwise the image's centre. None with too few views, or if the camera is not real (a negative square, by noise).
    """
    if len(homographies) < (3 if free_principal_point else 2):
        return None
    to_unit, plane = _image_conditioning(image_size), _plane_conditioning(homographies, image_size)
    inverses = np.linalg.inv(to_unit @ homographies @ plane)
    unknown = _IMAGE if free_principal_point else _IMAGE[:2]
    left = np.concatenate([_equations(g, unknown) for g in inverses])
    right = np.concatenate([-np.outer(g[:, 2], g[:, 2])[_UPPER] for g in inverses])
    scale = np.linalg.norm(left, axis=0)
    solution = np.linalg.lstsq(left / scale, right, rcond=None)[0] / scale
    image = dict(zip(unknown, solution, strict=False))
    return _solution_from_entries(image, solution[len(unknown) :], to_unit, plane)


def _solution_from_entries(
    image: Mapping[tuple[int, int], float], target: Array, to_unit: Array, plane: Array
) -> tuple[Array, Collimator] | None:
    """Return camera matrix and collimator by entries of K K^T, (2, 2) = 1, and of the right side; None if not real.

    Own, of arXiv:2512.16092, eq. 5: fx^2 = w11 - w13^2, fy^2 = w22 - w23^2 with W = K K^T; r^2 is the mean of two.
    """
    cx, cy = image.get((0, 2), 0.0), image.get((1, 2), 0.0)
    camera = _camera_matrix(np.array([image[0, 0] - cx**2, image[1, 1] - cy**2]), cx, cy)
    right = np.zeros((3, 3))
    right[_UPPER] = target
    if right[2, 2] == 0.0:
        return None
    x, y = right[0, 2] / right[2, 2], right[1, 2] / right[2, 2]
    r_squared = 0.5 * ((right[0, 0] + right[1, 1]) / right[2, 2] - x**2 - y**2)
    if camera is None or not r_squared > 0:
        return None
    x_mm, y_mm, _ = plane @ [x, y, 1.0]
    collimator = Collimator(float(x_mm), float(y_mm), float(np.sqrt(r_squared) * plane[0, 0]))
    return np.asarray(np.linalg.inv(to_unit) @ camera), collimator


def _camera_matrix(f_squared: Array, cx: float, cy: float) -> Array | None:
    """Return the (3, 3) camera matrix with (2,) squares of fx and fy; None if they are not positive."""
    if not (f_squared > 0).all():
        return None
    fx, fy = np.sqrt(f_squared)
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def central_matrix(focal_px: float, image_size: tuple[int, int]) -> Array:
    """Return the (3, 3) camera matrix K with the principal point at the image's centre (Hartley and Zisserman, 6.1)."""
    cx, cy = (image_size[0] - 1) / 2, (image_size[1] - 1) / 2
    return np.array([[focal_px, 0.0, cx], [0.0, focal_px, cy], [0.0, 0.0, 1.0]])


def rotations_from_centre(homographies: Array, matrix: Array, centre: Array) -> Array:
    """Return for each camera matrix, (..., 3, 3), and centre, (..., 3) mm, rotations (..., n, 3, 3), camera <- target.

    H ~ K R [e1 e2 -c] (arXiv:2512.16092, eq. 3), so R is the rotation nearest to K^-1 H [e1 e2 -c]^-1.
    """
    frame = np.broadcast_to(np.eye(3), (*centre.shape, 3)).copy()
    frame[..., 2] = -centre
    to_ray, to_target = np.linalg.inv(matrix), np.linalg.inv(frame)
    return nearest_rotation(to_ray[..., None, :, :] @ homographies @ to_target[..., None, :, :])


def camera_matrix_from_centre(homographies: Array, collimator: Collimator) -> Array | None:
    """Return the (3, 3) camera matrix, px, given the shared centre, from one view or more; None if it is not real.

    K K^T ~ H A H^T, where A is the right side of arXiv:2512.16092, eq. 5. The mean over the views is taken.
    """
    x, y, r = collimator.x, collimator.y, collimator.r
    right = np.array([[r**2 + x**2, x * y, x], [x * y, r**2 + y**2, y], [x, y, 1.0]])
    squares = homographies @ right @ np.swapaxes(homographies, 1, 2)
    square = (squares / squares[:, 2:, 2:]).mean(axis=0)
    cx, cy = square[0, 2], square[1, 2]
    return _camera_matrix(np.array([square[0, 0] - cx**2, square[1, 1] - cy**2]), cx, cy)


def _image_conditioning(image_size: tuple[int, int]) -> Array:
    """Return the similarity that maps the image's centre to 0, half its diagonal to 1 (aim: Hartley, 1997)."""
    width, height = image_size
    scale = 2.0 / np.hypot(width, height)
    return np.array(
        [[scale, 0.0, -scale * (width - 1) / 2], [0.0, scale, -scale * (height - 1) / 2], [0.0, 0.0, 1.0]]
    )


def _plane_conditioning(homographies: Array, image_size: tuple[int, int]) -> Array:
    """Return the (3, 3) map from units to mm about the point that the cameras look at (aim: Hartley, 1997)."""
    centre = np.array([(image_size[0] - 1) / 2, (image_size[1] - 1) / 2, 1.0])
    looked_at = np.linalg.inv(homographies) @ centre
    middle = np.median(looked_at[:, :2] / looked_at[:, 2:], axis=0)
    right = np.linalg.inv(homographies) @ (centre + np.array([np.hypot(*image_size) / 4, 0.0, 0.0]))
    scale = np.median(np.linalg.norm(right[:, :2] / right[:, 2:] - middle, axis=1)) * 2
    return np.array([[scale, 0.0, middle[0]], [0.0, scale, middle[1]], [0.0, 0.0, 1.0]])


def _symmetric(entries: Sequence[tuple[int, int]]) -> Array:
    """Return for each of K entries the symmetric (3, 3) matrix with a 1 there, (K, 3, 3)."""
    matrices = np.zeros((len(entries), 3, 3))
    for one, (i, j) in zip(matrices, entries, strict=True):
        one[i, j] = one[j, i] = 1.0
    return matrices


def _equations(g: Array, unknown: Sequence[tuple[int, int]]) -> Array:
    """Return the rows g W g^T - B, 6 a view, for chosen entries of W, then B (arXiv:2512.16092, eq. 5)."""
    columns = (g @ _symmetric(unknown) @ g.T)[:, _UPPER[0], _UPPER[1]]
    return np.hstack([columns.T, -np.eye(6)])


# The planar model, in which each view has its own free centre (Zhang, 2000): a comparison, and a second way to start
# the spherical model.


def zhang_matrix(
    homographies: Array, image_size: tuple[int, int], *, free_principal_point: bool
) -> Array | None:
    """Solve for the (3, 3) camera matrix, px, from the homographies of all views, with zero skew.

    With w = K^-T K^-1, each view gives h1^T w h2 = 0 and h1^T w h1 = h2^T w h2: Zhang (2000), eqs. 3 and 4 and section
    3.1. A principal point that is not free is the image's centre. None if frontal views or noise do not allow it.
    """
    to_unit, unknown = _image_conditioning(image_size), _IMAGE[: 4 if free_principal_point else 2]
    h = to_unit @ homographies
    h1, h2 = (h[:, :, column] / np.linalg.norm(h[:, :, :1], axis=1) for column in (0, 1))
    # The last entry, w33 = 1, is known.
    crossed, first, second = (
        np.einsum("ni,kij,nj->nk", one, _symmetric((*unknown, (2, 2))), other)
        for one, other in ((h1, h2), (h1, h1), (h2, h2))
    )
    rows = np.concatenate([crossed, first - second])
    solution, _, rank, _ = np.linalg.lstsq(rows[:, :-1], -rows[:, -1], rcond=1e-9)
    if rank < len(unknown):
        return None
    w = dict(zip(unknown, solution, strict=True))
    if not min(w[0, 0], w[1, 1]) > 0:
        return None
    cx, cy = -w.get((0, 2), 0.0) / w[0, 0], -w.get((1, 2), 0.0) / w[1, 1]
    # w33 = 1 fixes the scale of w; the true one is 1 + cx^2 / fx^2 + cy^2 / fy^2.
    true_scale = 1.0 - w[0, 0] * cx**2 - w[1, 1] * cy**2
    camera = _camera_matrix(true_scale / np.array([w[0, 0], w[1, 1]]), cx, cy)
    return None if camera is None else np.asarray(np.linalg.inv(to_unit) @ camera)


def poses_from_homographies(homographies: Array, matrix: Array) -> tuple[Array, Array]:
    """Return the pose of each view, given the camera matrix: H ~ K [r1 r2 t] with t = -R c (Zhang, 2000, section 3.1).

    matrix: (..., 3, 3). Returns (..., n, 3, 3) rotations, camera <- target, and (..., n, 3) camera centres in the frame
    of the target, mm.
    """
    columns = np.linalg.inv(matrix)[..., None, :, :] @ homographies
    lengths = np.sqrt((columns[..., :2] ** 2).sum(axis=-2)).mean(axis=-1)
    columns = columns / lengths[..., None, None]
    r1, r2 = columns[..., :1], columns[..., 1:2]
    rotations = nearest_rotation(np.concatenate([r1, r2, skew(r1[..., 0]) @ r2], axis=-1))
    centres = -(np.swapaxes(rotations, -1, -2) @ columns[..., 2:])[..., 0]
    return rotations, np.asarray(centres)
