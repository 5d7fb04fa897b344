"""Closed forms of a camera from straight lines of known place: of a plane, or of a body.

An image line l and a point X on the same line in space satisfy l . P X = 0 (Hartley and Zisserman, 2004, section 8.1): two
equations for each line, from two of its points. Four lines of a plane give its homography, six other lines the projection
matrix, by the direct linear transform on conditioned coordinates (Hartley, 1997).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import rq

from calib.arrays import Array
from calib.errors import DegenerateViews

_OF_PLANE, _OF_BODY = 4, 6


def projection_of_lines(lines: Array, ends_mm: Array) -> Array:
    """Return the map from space to the image: (3, 3) for lines of the plane Z = 0, else (3, 4); its scale is free.

    lines: (E, 3) image lines, l . [u v 1] = 0. ends_mm: (E, 2, 3) two points on each line in space.
    Raises DegenerateViews: With fewer than four lines of a plane, or fewer than six others.
    """
    flat = bool((ends_mm[..., 2] == 0.0).all())
    fewest = _OF_PLANE if flat else _OF_BODY
    if len(lines) < fewest:
        raise DegenerateViews(f"{len(lines)} lines; {fewest} are needed.", remedy="Show more edges.")
    points = ends_mm[..., :2] if flat else ends_mm
    middle = points.reshape(-1, points.shape[-1]).mean(axis=0)
    size = np.abs(points - middle).mean()
    homogeneous = np.concatenate([(points - middle) / size, np.ones((*points.shape[:2], 1))], axis=-1)
    to_image = _image_conditioning(lines)
    conditioned = lines @ to_image
    conditioned /= np.linalg.norm(conditioned[:, :2], axis=1, keepdims=True)
    rows = np.einsum("ei,epj->epij", conditioned, homogeneous).reshape(2 * len(lines), -1)
    solved = np.linalg.svd(rows)[2][-1].reshape(3, -1)
    to_unit = np.eye(points.shape[-1] + 1)
    to_unit[:-1] /= size
    to_unit[:-1, -1] = -middle / size
    return np.asarray(to_image @ solved @ to_unit)


def _image_conditioning(lines: Array) -> Array:
    """Return the (3, 3) map from conditioned to image coordinates: about where the lines meet, and their distance."""
    across = lines[:, :2] / np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    offset = lines[:, 2] / np.linalg.norm(lines[:, :2], axis=1)
    middle = np.linalg.lstsq(across, -offset, rcond=None)[0]
    scale = max(float(np.abs(across @ middle + offset).mean()), 1e-12)
    return np.array([[scale, 0.0, middle[0]], [0.0, scale, middle[1]], [0.0, 0.0, 1.0]])


def camera_of_projection(projection: Array, inside_mm: Array) -> tuple[Array, Array, Array]:
    """Return K (3, 3) with K[2, 2] = 1, R (3, 3) and t (3,) mm of P ~ K [R t] (Hartley and Zisserman, 2004, 6.2.4).

    inside_mm: (3,) a point that the camera sees; it lies before the camera.
    """
    ahead = projection[2] @ [*inside_mm, 1.0]
    if np.linalg.det(projection[:, :3]) < 0.0:
        projection, ahead = -projection, -ahead
    if ahead <= 0.0:
        raise DegenerateViews("The lines are seen mirrored.", remedy="Check which edge is which.")
    matrix, rotation = rq(projection[:, :3])
    signs = np.diag(np.sign(np.diag(matrix)))
    matrix, rotation = matrix @ signs, signs @ rotation
    return matrix / matrix[2, 2], rotation, np.linalg.solve(matrix, projection[:, 3])
