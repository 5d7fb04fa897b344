"""Rotations: exponential and logarithm map, the nearest rotation to a matrix, and gimbal angles.

Rotation vectors are in radians. Stacks of matrices have shape (..., 3, 3), stacks of rotation vectors (..., 3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def skew(vectors: Array) -> Array:
    """Return the cross product matrices [v]x, for which [v]x w = v x w.

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

    Parameters
    ----------
    vectors
        (..., 3) rotation vectors, rad.

    Returns
    -------
    Array
        (..., 3, 3) rotation matrices.
    """
    v = np.asarray(vectors, float)
    return np.asarray(Rotation.from_rotvec(v.reshape(-1, 3)).as_matrix()).reshape(*v.shape[:-1], 3, 3)


def log_map(matrices: Array) -> Array:
    """Return the rotation vectors of rotation matrices: the inverse of `exp_map`.

    Parameters
    ----------
    matrices
        (..., 3, 3) rotation matrices.

    Returns
    -------
    Array
        (..., 3) rotation vectors, rad, of length at most pi.
    """
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
    """
    return np.asarray(Rotation.from_euler("ZXY", [roll_deg, tilt_deg, pan_deg], degrees=True).as_matrix())
