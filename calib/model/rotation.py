"""Rotations: exponential and logarithm map, the nearest rotation to a matrix, and gimbal angles.

Rotation vectors are in radians. Stacks of matrices have shape (..., 3, 3), stacks of rotation vectors (..., 3).
"""

from __future__ import annotations

import numpy as np

from calib.arrays import Array

#: Arc seconds in a radian.
ARCSEC = 3600.0 * 180.0 / np.pi


def skew(vectors: Array) -> Array:
    """Return the (..., 3, 3) matrices [v]x, with [v]x w = v x w (Hartley and Zisserman, 2004, appendix 4)."""
    v = np.asarray(vectors, float)
    matrices = np.zeros((*v.shape[:-1], 3, 3))
    matrices[..., 2, 1], matrices[..., 1, 2] = v[..., 0], -v[..., 0]
    matrices[..., 0, 2], matrices[..., 2, 0] = v[..., 1], -v[..., 1]
    matrices[..., 1, 0], matrices[..., 0, 1] = v[..., 2], -v[..., 2]
    return matrices


def exp_map(vectors: Array) -> Array:
    """Return rotation matrices of rotation vectors, rad (Rodrigues' formula; by unit quaternions: Diebel, 2006)."""
    v = np.asarray(vectors, float)
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z = v.reshape(-1, 3).T
        angle = np.sqrt(x * x + y * y + z * z)
        half = np.full(len(angle), 0.5)
        scale = np.divide(np.sin(0.5 * angle), angle, out=half, where=angle > 0.0)
        x, y, z, w = scale * x, scale * y, scale * z, np.cos(0.5 * angle)
        xx, yy, zz, ww = x * x, y * y, z * z, w * w
        first = xx - yy - zz + ww, 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
        second = 2.0 * (x * y + z * w), -xx + yy - zz + ww, 2.0 * (y * z - x * w)
        third = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), -xx - yy + zz + ww
    elements = np.array([*first, *second, *third])
    return np.ascontiguousarray(elements.T).reshape(*v.shape, 3)


def log_map(matrices: Array) -> Array:
    """Return rotation vectors, rad, of length pi at most: the inverse of `exp_map` (Diebel, 2006; by quaternions)."""
    m = np.asarray(matrices, float)
    a, b, c, d, e, f, g, h, i = m.reshape(-1, 9).T
    xy, xz, yz, xw, yw, zw = b + d, c + g, f + h, h - f, c - g, d - b
    # The products of a quaternion's components, times 4: each row is a multiple of the quaternion, and the row of the
    # largest component is the most exact.
    products = np.array(
        [
            [1.0 + a - e - i, xy, xz, xw],
            [xy, 1.0 - a + e - i, yz, yw],
            [xz, yz, 1.0 - a - e + i, zw],
            [xw, yw, zw, 1.0 + a + e + i],
        ]
    )
    largest = np.diagonal(products).argmax(axis=1)
    q = products[largest, :, np.arange(len(largest))]
    q = q * np.where(q[:, 3] < 0.0, -1.0, 1.0)[:, None]
    length = np.sqrt(np.einsum("nk,nk->n", q[:, :3], q[:, :3]))
    turned = length > 0.0
    scale = np.where(turned, 2.0 * np.arctan2(length, q[:, 3]), 2.0) / np.where(turned, length, q[:, 3])
    return np.ascontiguousarray(q[:, :3] * scale[:, None]).reshape(m.shape[:-1])


def nearest_rotation(matrices: Array) -> Array:
    """Return the nearest rotations, (..., 3, 3): orthogonal Procrustes problem (Schoenemann, 1966; Kabsch, 1976)."""
    u, _, vt = np.linalg.svd(np.asarray(matrices, float))
    flip = np.ones((*u.shape[:-2], 3))
    flip[..., 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * flip[..., None, :]) @ vt)


def euler_zxy(pan_deg: float, tilt_deg: float, roll_deg: float = 0.0) -> Array:
    """Return the (3, 3) rotation Rz(roll) Rx(tilt) Ry(pan) of a gimbal; y is down, z the optical axis.

    The product of three rotations (Diebel, 2006). SciPy's ``Rotation.from_euler`` gives the same to rounding; it is not
    used, because loading it takes longer than a whole plan.
    """
    roll, tilt, pan = exp_map(np.radians(np.diag([tilt_deg, pan_deg, roll_deg])[[2, 0, 1]]))
    return np.asarray(roll @ tilt @ pan)
