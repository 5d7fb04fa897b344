"""Closed forms of the planar model, in which each view has its own free centre: Zhang's method.

The planar model serves as a comparison, and as a second way to start the spherical model. Reference: Zhang (2000), "A
flexible new technique for camera calibration".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.model.rotation import nearest_rotation, skew

Array = NDArray[np.float64]


def zhang_matrix(
    homographies: Array, image_size: tuple[int, int], *, free_principal_point: bool
) -> Array | None:
    """Solve for the camera matrix from the homographies of all views, with zero skew.

    With w = K^-T K^-1, each view gives h1^T w h2 = 0 and h1^T w h1 = h2^T w h2: Zhang (2000), eqs. 3 and 4 and section
    3.1.

    homographies: (n, 3, 3) homographies from target, mm, to image, px.
    image_size: Width and height, px.
    free_principal_point: Whether the principal point is unknown; otherwise it is the centre of the image.
    Returns: (3, 3) camera matrix, px; None if the views do not determine one (frontal views, noise).
    """
    width, height = image_size
    scale = 2.0 / np.hypot(width, height)
    shift = np.array([-scale * (width - 1) / 2, -scale * (height - 1) / 2])
    to_unit = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]], [0.0, 0.0, 1.0]])
    unknown = [(0, 0), (1, 1), (0, 2), (1, 2)] if free_principal_point else [(0, 0), (1, 1)]
    rows, right = [], []
    for h in to_unit @ homographies:
        h1, h2 = h[:, 0] / np.linalg.norm(h[:, 0]), h[:, 1] / np.linalg.norm(h[:, 0])
        rows.append([_entry(h1, h2, ij) for ij in unknown])
        rows.append([_entry(h1, h1, ij) - _entry(h2, h2, ij) for ij in unknown])
        right += [-h1[2] * h2[2], h2[2] ** 2 - h1[2] ** 2]
    solution, _, rank, _ = np.linalg.lstsq(np.array(rows), np.array(right), rcond=1e-9)
    if rank < len(unknown):
        return None
    w = dict(zip(unknown, solution, strict=True))
    if not min(w[0, 0], w[1, 1]) > 0:
        return None
    cx, cy = -w.get((0, 2), 0.0) / w[0, 0], -w.get((1, 2), 0.0) / w[1, 1]
    # w33 = 1 fixes the scale of w; the true one is 1 + cx^2 / fx^2 + cy^2 / fy^2.
    true_scale = 1.0 - w[0, 0] * cx**2 - w[1, 1] * cy**2
    if not true_scale > 0:
        return None
    fx, fy = np.sqrt(true_scale / np.array([w[0, 0], w[1, 1]]))
    return np.asarray(np.linalg.inv(to_unit) @ np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]))


def _entry(a: Array, b: Array, ij: tuple[int, int]) -> float:
    """Return the factor of w_ij in a^T w b.

    Source: Zhang (2000), section 3.1.
    """
    i, j = ij
    return float(a[i] * b[j] + (a[j] * b[i] if i != j else 0.0))


def poses_from_homographies(homographies: Array, matrix: Array) -> tuple[Array, Array]:
    """Return the pose of each view, given the camera matrix: H ~ K [r1 r2 t] with t = -R c (Zhang, 2000, section 3.1).

    homographies: (n, 3, 3) homographies from target, mm, to image, px.
    matrix: (..., 3, 3) camera matrices, px.
    Returns: For each camera matrix (..., n, 3, 3) rotations, camera <- target; (..., n, 3) camera centres in
      the target frame, mm.
    """
    columns = np.linalg.inv(matrix)[..., None, :, :] @ homographies
    lengths = np.sqrt((columns[..., :2] ** 2).sum(axis=-2)).mean(axis=-1)
    columns = columns / lengths[..., None, None]
    r1, r2 = columns[..., :1], columns[..., 1:2]
    rotations = nearest_rotation(np.concatenate([r1, r2, skew(r1[..., 0]) @ r2], axis=-1))
    centres = -(np.swapaxes(rotations, -1, -2) @ columns[..., 2:])[..., 0]
    return rotations, np.asarray(centres)
