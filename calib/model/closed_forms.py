"""Closed forms: camera matrix, collimator and poses from the homographies of the views.

In the spherical motion model, with homographies scaled to determinant 1, all views share one equation
(arXiv:2512.16092, eq. 5):
H^-1 K K^T H^-T = s [[r^2 + x^2, xy, x], [xy, r^2 + y^2, y], [x, y, 1]].
It is linear in the entries of K K^T and in those of the right side. Distortion and noise are not modelled, so the
solutions are only starting values.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.arrays import Array
from calib.model.collimator import Collimator
from calib.model.rotation import nearest_rotation, skew

#: The six different entries of a symmetric matrix.
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
    unknown = _IMAGE if free_principal_point else _IMAGE[:2]
    basis, g = _basis(unknown), np.linalg.inv(to_unit @ homographies @ plane)[:, None]
    # The rows g W g^T - B, 6 a view, for the entries of W, of which the last one is known, then of B.
    image = (g @ basis @ np.swapaxes(g, 2, 3))[:, :, *_UPPER].swapaxes(1, 2).reshape(-1, len(basis))
    left = np.hstack([image[:, :-1], np.tile(-np.eye(6), (len(g), 1))])
    scale = np.linalg.norm(left, axis=0)
    solution = np.linalg.lstsq(left / scale, -image[:, -1], rcond=None)[0] / scale
    camera = _camera_matrix(_combined(solution[: len(unknown)], basis))
    target = np.zeros((3, 3))
    target[_UPPER] = solution[len(unknown) :]
    if camera is None or target[2, 2] == 0.0:
        return None
    # Own, of arXiv:2512.16092, eq. 5: r^2 is the mean of two.
    x, y = target[:2, 2] / target[2, 2]
    r_squared = 0.5 * ((target[0, 0] + target[1, 1]) / target[2, 2] - x**2 - y**2)
    if not r_squared > 0:
        return None
    x_mm, y_mm, _ = plane @ [x, y, 1.0]
    collimator = Collimator(float(x_mm), float(y_mm), float(np.sqrt(r_squared) * plane[0, 0]))
    return np.asarray(np.linalg.inv(to_unit) @ camera), collimator


def _basis(unknown: Sequence[tuple[int, int]]) -> Array:
    """Return for each unknown entry of a symmetric (3, 3) matrix, then for (2, 2), the matrix with a 1 there."""
    matrices = np.zeros((len(unknown) + 1, 3, 3))
    for matrix, (i, j) in zip(matrices, (*unknown, (2, 2)), strict=True):
        matrix[i, j] = matrix[j, i] = 1.0
    return matrices


def _combined(entries: Array, basis: Array) -> Array:
    """Return the symmetric (3, 3) matrix with some entries; (2, 2) is 1."""
    return np.tensordot(np.append(entries, 1.0), basis, axes=1)


def _camera_matrix(square: Array) -> Array | None:
    """Return the (3, 3) camera matrix K by K K^T, (2, 2) = 1; None if a squared focal length is not positive."""
    cx, cy = square[:2, 2]
    f_squared = np.diag(square)[:2] - square[:2, 2] ** 2
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
    return _camera_matrix((squares / squares[:, 2:, 2:]).mean(axis=0))


def _image_conditioning(image_size: tuple[int, int]) -> Array:
    """Return the similarity that maps the image's centre to 0, half its diagonal to 1 (aim: Hartley, 1997)."""
    width, height = image_size
    scale = 2.0 / np.hypot(width, height)
    x, y = scale * (width - 1) / 2, scale * (height - 1) / 2
    return np.array([[scale, 0.0, -x], [0.0, scale, -y], [0.0, 0.0, 1.0]])


def _plane_conditioning(homographies: Array, image_size: tuple[int, int]) -> Array:
    """Return the (3, 3) map from units to mm about the point that the cameras look at (aim: Hartley, 1997)."""
    centre = np.array([(image_size[0] - 1) / 2, (image_size[1] - 1) / 2, 1.0])
    looked_at = np.linalg.inv(homographies) @ centre
    middle = np.median(looked_at[:, :2] / looked_at[:, 2:], axis=0)
    right = np.linalg.inv(homographies) @ (centre + np.array([np.hypot(*image_size) / 4, 0.0, 0.0]))
    scale = np.median(np.linalg.norm(right[:, :2] / right[:, 2:] - middle, axis=1)) * 2
    return np.array([[scale, 0.0, middle[0]], [0.0, scale, middle[1]], [0.0, 0.0, 1.0]])


def zhang_matrix(
    homographies: Array, image_size: tuple[int, int], *, free_principal_point: bool
) -> Array | None:
    """Solve for the (3, 3) camera matrix, px, from the homographies of all views, with zero skew.

    With w = K^-T K^-1, each view gives h1^T w h2 = 0 and h1^T w h1 = h2^T w h2: Zhang (2000), eqs. 3 and 4 and section
    3.1. A principal point that is not free is the image's centre. None if frontal views or noise do not allow it.
    """
    to_unit, unknown = _image_conditioning(image_size), _IMAGE[: 4 if free_principal_point else 2]
    h, basis = to_unit @ homographies, _basis(unknown)
    h1, h2 = (h[:, :, column] / np.linalg.norm(h[:, :, 0], axis=1, keepdims=True) for column in (0, 1))
    pairs = (h1, h2), (h1, h1), (h2, h2)
    crossed, first, second = (np.einsum("ni,kij,nj->nk", left, basis, right) for left, right in pairs)
    rows = np.concatenate([crossed, first - second])
    solution, _, rank, _ = np.linalg.lstsq(rows[:, :-1], -rows[:, -1], rcond=1e-9)
    w = _combined(solution, basis)
    if rank < len(unknown) or np.linalg.det(w) == 0.0:
        return None
    square = np.linalg.inv(w)
    camera = _camera_matrix(square / square[2, 2])
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
