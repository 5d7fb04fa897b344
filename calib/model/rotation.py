"""Rotations: exponential and logarithm, the nearest rotation to a matrix, the angle of one.

Knows SO(3) only. Radians; stacks of matrices have shape (..., 3, 3), rotation vectors (..., 3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def skew(vectors: Array) -> Array:
    """Return the matrices [v]x, (..., 3, 3), for which [v]x w = v x w."""
    v = np.asarray(vectors, float)
    matrices = np.zeros((*v.shape[:-1], 3, 3))
    matrices[..., 2, 1], matrices[..., 1, 2] = v[..., 0], -v[..., 0]
    matrices[..., 0, 2], matrices[..., 2, 0] = v[..., 1], -v[..., 1]
    matrices[..., 1, 0], matrices[..., 0, 1] = v[..., 2], -v[..., 2]
    return matrices


def exp_map(vectors: Array) -> Array:
    """Return the rotation matrices of rotation vectors, radians."""
    v = np.asarray(vectors, float)
    return np.asarray(Rotation.from_rotvec(v.reshape(-1, 3)).as_matrix()).reshape(*v.shape[:-1], 3, 3)


def log_map(matrices: Array) -> Array:
    """Return the rotation vectors, radians, of length at most pi, of rotation matrices."""
    m = np.asarray(matrices, float)
    return np.asarray(Rotation.from_matrix(m.reshape(-1, 3, 3)).as_rotvec()).reshape(m.shape[:-1])


def nearest_rotation(matrices: Array) -> Array:
    """Return the rotations nearest to any matrices in the Frobenius norm (orthogonal Procrustes)."""
    u, _, vt = np.linalg.svd(np.asarray(matrices, float))
    flip = np.ones((*u.shape[:-2], 3))
    flip[..., 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * flip[..., None, :]) @ vt)


def euler_zxy(pan_deg: float, tilt_deg: float, roll_deg: float = 0.0) -> Array:
    """Return Rz(roll) Rx(tilt) Ry(pan): pan about the camera's y axis (down), tilt about x, roll about z."""
    return np.asarray(Rotation.from_euler("ZXY", [roll_deg, tilt_deg, pan_deg], degrees=True).as_matrix())
