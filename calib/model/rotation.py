"""Rotations: exponential and logarithm map, the nearest rotation to a matrix, and gimbal angles.

Rotation vectors are in radians. Stacks of matrices have shape (..., 3, 3), stacks of rotation vectors (..., 3).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Quaternion = tuple[float, float, float, float]


def skew(vectors: Array) -> Array:
    """Return the cross product matrices [v]x, for which [v]x w = v x w.

    Source: Hartley and Zisserman (2004), appendix 4.

    Parameters
    ----------
    vectors
        (..., 3) vectors.

    Returns
    -------
    Array
        (..., 3, 3) skew-symmetric matrices.
    """
    v = np.asarray(vectors, float)
    matrices = np.zeros((*v.shape[:-1], 3, 3))
    matrices[..., 2, 1], matrices[..., 1, 2] = v[..., 0], -v[..., 0]
    matrices[..., 0, 2], matrices[..., 2, 0] = v[..., 1], -v[..., 1]
    matrices[..., 1, 0], matrices[..., 0, 1] = v[..., 2], -v[..., 2]
    return matrices


def exp_map(vectors: Array) -> Array:
    """Return the rotation matrices of rotation vectors (Rodrigues' formula).

    Source: Diebel (2006); computed by SciPy.

    Parameters
    ----------
    vectors
        (..., 3) rotation vectors, rad.

    Returns
    -------
    Array
        (..., 3, 3) rotation matrices.
    """
    from scipy.spatial.transform import Rotation

    v = np.asarray(vectors, float)
    return np.asarray(Rotation.from_rotvec(v.reshape(-1, 3)).as_matrix()).reshape(*v.shape[:-1], 3, 3)


def log_map(matrices: Array) -> Array:
    """Return the rotation vectors of rotation matrices: the inverse of `exp_map`.

    Source: Diebel (2006); computed by SciPy.

    Parameters
    ----------
    matrices
        (..., 3, 3) rotation matrices.

    Returns
    -------
    Array
        (..., 3) rotation vectors, rad, of length at most pi.
    """
    from scipy.spatial.transform import Rotation

    m = np.asarray(matrices, float)
    return np.asarray(Rotation.from_matrix(m.reshape(-1, 3, 3)).as_rotvec()).reshape(m.shape[:-1])


def nearest_rotation(matrices: Array) -> Array:
    """Return the rotations nearest to matrices in the Frobenius norm.

    This is the orthogonal Procrustes problem (Schoenemann, 1966), restricted to proper rotations (Kabsch, 1976).

    Parameters
    ----------
    matrices
        (..., 3, 3) matrices.

    Returns
    -------
    Array
        (..., 3, 3) rotation matrices.
    """
    u, _, vt = np.linalg.svd(np.asarray(matrices, float))
    flip = np.ones((*u.shape[:-2], 3))
    flip[..., 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * flip[..., None, :]) @ vt)


def euler_zxy(pan_deg: float, tilt_deg: float, roll_deg: float = 0.0) -> Array:
    """Return the rotation Rz(roll) Rx(tilt) Ry(pan) of a gimbal.

    Parameters
    ----------
    pan_deg
        Angle about the camera's y axis (down), degrees.
    tilt_deg
        Angle about the camera's x axis, degrees.
    roll_deg
        Angle about the camera's z axis (the optical axis), degrees.

    Returns
    -------
    Array
        (3, 3) rotation matrix.

    Notes
    -----
    The product of three unit quaternions, and the matrix of the product (Diebel 2006). SciPy's ``Rotation.from_euler``
    gives the same bits; it is not used, because loading it takes longer than a whole plan.
    """
    roll, tilt, pan = (math.radians(angle) / 2.0 for angle in (roll_deg, tilt_deg, pan_deg))
    turned = _quaternion_product(
        (0.0, 0.0, math.sin(roll), math.cos(roll)), (math.sin(tilt), 0.0, 0.0, math.cos(tilt))
    )
    x, y, z, w = _quaternion_product(turned, (0.0, math.sin(pan), 0.0, math.cos(pan)))
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    return np.array(
        [
            [xx - yy - zz + ww, 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), -xx + yy - zz + ww, 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), -xx - yy + zz + ww],
        ]
    )


def _quaternion_product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return p q, the rotation q followed by p; quaternions are (x, y, z, w).

    Source: Diebel (2006).
    """
    return (
        p[3] * q[0] + q[3] * p[0] + (p[1] * q[2] - p[2] * q[1]),
        p[3] * q[1] + q[3] * p[1] + (p[2] * q[0] - p[0] * q[2]),
        p[3] * q[2] + q[3] * p[2] + (p[0] * q[1] - p[1] * q[0]),
        p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2],
    )
