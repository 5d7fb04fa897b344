"""The homography of a plane from straight lines of known place.

An image line l and a point X on the same line in space satisfy l . P X = 0 (Hartley and Zisserman, 2004, section 8.1): two
equations for each line, from two of its points. Four lines of a plane give its homography by the direct linear transform
on conditioned coordinates (Hartley, 1997).
"""

from __future__ import annotations

import numpy as np

from calib.arrays import Array
from calib.errors import DegenerateViews

_FEWEST = 4


def homography_of_lines(lines: Array, ends_mm: Array) -> Array:
    """Return the (3, 3) map from the plane Z = 0 to the image, with the sign that puts the origin before the camera.

    lines: (E, 3) image lines, l . [u v 1] = 0. ends_mm: (E, 2, 3) two points on each line in space.
    Raises DegenerateViews: With fewer than four lines.
    """
    if len(lines) < _FEWEST:
        raise DegenerateViews(f"{len(lines)} lines; {_FEWEST} are needed.", remedy="Show more edges.")
    points = ends_mm[..., :2]
    middle = points.reshape(-1, 2).mean(axis=0)
    size = np.abs(points - middle).mean()
    homogeneous = np.concatenate([(points - middle) / size, np.ones((*points.shape[:2], 1))], axis=-1)
    to_image = _image_conditioning(lines)
    conditioned = lines @ to_image
    conditioned /= np.linalg.norm(conditioned[:, :2], axis=1, keepdims=True)
    rows = np.einsum("ei,epj->epij", conditioned, homogeneous).reshape(2 * len(lines), -1)
    solved = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    to_unit = np.eye(3)
    to_unit[:-1] /= size
    to_unit[:-1, -1] = -middle / size
    homography = to_image @ solved @ to_unit
    return np.asarray(homography * np.sign(homography[2, 2]))


def _image_conditioning(lines: Array) -> Array:
    """Return the (3, 3) map from conditioned to image coordinates: about where the lines meet, and their distance."""
    across = lines[:, :2] / np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    offset = lines[:, 2] / np.linalg.norm(lines[:, :2], axis=1)
    middle = np.linalg.lstsq(across, -offset, rcond=None)[0]
    scale = max(float(np.abs(across @ middle + offset).mean()), 1e-12)
    return np.array([[scale, 0.0, middle[0]], [0.0, scale, middle[1]], [0.0, 0.0, 1.0]])
