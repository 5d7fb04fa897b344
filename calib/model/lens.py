"""Lens distortion of normalised image coordinates, and its derivatives.

Two lens families: the radial and tangential polynomials of Brown (1971) with OpenCV's rational denominator, and the
polynomial of the angle of Kannala and Brandt (2006), which is OpenCV's fisheye model. A camera of another program may
also have OpenCV's thin prism and tilted sensor. The functions take normalised coordinates (x / z, y / z), not pixels.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from calib.arrays import Array

#: Coefficients of Brown's model in OpenCV's order; k4 to k6 are those of the denominator (rational model).
BROWN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
#: A further term of Brown's series, r^8 in the numerator. Other programs have none, so no result states it: the joint
#: adjustment estimates it beside k1 to k3, which it changes. The name k4 is that of OpenCV's denominator.
R8 = "r8"
_SERIES = (*BROWN, R8)
#: OpenCV's thin prism, and the tilt of its sensor in rad: known from a file, not estimated by a calibration.
PRISM, TILT = ("s1", "s2", "s3", "s4"), ("tauX", "tauY")
#: All coefficients of OpenCV, in its order.
OPENCV = (*BROWN, *PRISM, *TILT)
#: Numbers of coefficients that OpenCV's functions accept.
OPENCV_LENGTHS = (4, 5, 8, 12, 14)
_TANGENTIAL = (2, 3)  # Places of p1 and p2 among OpenCV's coefficients
# Places of k1, k2, k3 and of the coefficient of r^8; the others stand in the denominator.
_NUMERATOR = (0, 1, 4, 8)
#: Power of r^2 of each radial coefficient, by its place in `_SERIES`.
_POWERS = {0: 1, 1: 2, 4: 3, 5: 1, 6: 2, 7: 3, 8: 4}
#: Coefficients of the angle's polynomial: theta (1 + kb1 theta^2 + kb2 theta^4 + ...); OpenCV's fisheye k1 to k4.
FISHEYE = ("kb1", "kb2", "kb3", "kb4")
_FISHEYE_NAMES, _PRISM_NAMES, _TILT_NAMES = frozenset(FISHEYE), frozenset(PRISM), frozenset(TILT)


def distort_with_jacobians(points: Array, coefficients: Mapping[str, float]) -> tuple[Array, Array, Array]:
    """Distort (N, 2) normalised points, and return the derivatives (own; by the product and the chain rule).

    The names of the coefficients, `OPENCV` (and `R8`) or `FISHEYE`, select the lens family: Brown (1971) with OpenCV's
    rational denominator, thin prism and tilt, or Kannala and Brandt (2006). Those not named are zero. The K
    coefficients may have other names beside, which change nothing: the skew belongs to the camera matrix.
    Returns: (N, 2) points; derivatives by the points, (N, 2, 2), and by the coefficients, (N, 2, K), 0 for others.
    """
    family = FISHEYE if is_fisheye(coefficients) else _SERIES
    evaluate = _fisheye_with_jacobians if family is FISHEYE else _brown_with_jacobians
    wanted = [family.index(name) for name in coefficients if name in family]
    k = np.array([coefficients.get(name, 0.0) for name in family])
    bent, by_points, by_coefficients = evaluate(points, k, wanted)
    if len(wanted) == len(coefficients):
        return bent, by_points, by_coefficients
    every = np.zeros((len(points), 2, len(coefficients)))
    every[:, :, [i for i, name in enumerate(coefficients) if name in family]] = by_coefficients
    if not _PRISM_NAMES.isdisjoint(coefficients):
        bent, by_points = _add_prism(points, coefficients, bent, by_points, every)
    if not _TILT_NAMES.isdisjoint(coefficients):
        bent, by_points = _tilt(coefficients, bent, by_points, every)
    return bent, by_points, every


def is_fisheye(coefficients: Iterable[str]) -> bool:
    """Tell whether any of the coefficients, by their names, is in `FISHEYE`."""
    return not _FISHEYE_NAMES.isdisjoint(coefficients)


def _brown_with_jacobians(points: Array, k: Array, wanted: Sequence[int]) -> tuple[Array, Array, Array]:
    """Distort points; return also the derivatives by the points (N, 2, 2) and by the wanted coefficients (N, 2, K).

    Brown (1971), with OpenCV's rational model (1 + k1 r^2 + k2 r^4 + k3 r^6 + r8 r^8) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
    of the radius; own derivatives. In memory each derivative is one contiguous row over the points.
    """
    x, y = np.ascontiguousarray(points.T)
    r2 = x * x + y * y
    denominator = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    radial = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * (k[4] + r2 * k[8])))) / denominator
    p1, p2 = k[2], k[3]
    numerator_slope = k[0] + r2 * (2.0 * k[1] + r2 * (3.0 * k[4] + 4.0 * k[8] * r2))
    denominator_slope = k[5] + r2 * (2.0 * k[6] + 3.0 * k[7] * r2)
    slope = (numerator_slope - radial * denominator_slope) / denominator

    by_points = np.empty((2, 2, len(x)))
    by_points[0, 0] = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    by_points[1, 1] = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    by_points[0, 1] = by_points[1, 0] = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y

    powers = r2, r2 * r2, r2 * r2 * r2, r2 * r2 * r2 * r2  # products, because a general power is slow
    by_coefficients = np.empty((len(wanted), 2, len(x)))
    for rows, at in zip(by_coefficients, wanted, strict=True):
        if at in _TANGENTIAL:
            rows[at - 2] = 2.0 * x * y
            rows[3 - at] = r2 + 2.0 * (y * y if at == _TANGENTIAL[0] else x * x)
        else:
            factor = powers[_POWERS[at] - 1] / denominator
            factor = factor if at in _NUMERATOR else -factor * radial
            rows[0], rows[1] = x * factor, y * factor
    bent = np.array([x * radial, y * radial])
    if p1 or p2:
        bent[0] += 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        bent[1] += p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return bent.T, by_points.transpose(2, 0, 1), by_coefficients.transpose(2, 1, 0)


def _add_prism(
    points: Array, coefficients: Mapping[str, float], bent: Array, by_points: Array, every: Array
) -> tuple[Array, Array]:
    """Add OpenCV's thin prism (s1 r^2 + s2 r^4, s3 r^2 + s4 r^4), and its derivatives in ``every``; own derivatives."""
    s = np.array([coefficients.get(name, 0.0) for name in PRISM]).reshape(2, 2)
    r2 = (points * points).sum(axis=1)
    powers = np.column_stack([r2, r2 * r2])
    for at, name in enumerate(coefficients):
        if name in _PRISM_NAMES:
            axis, power = divmod(PRISM.index(name), 2)
            every[:, axis, at] = powers[:, power]
    by_r2 = s[:, 0] + 2.0 * r2[:, None] * s[:, 1]
    return bent + powers @ s.T, by_points + 2.0 * by_r2[:, :, None] * points[:, None, :]


def _tilt(
    coefficients: Mapping[str, float], bent: Array, by_points: Array, every: Array
) -> tuple[Array, Array]:
    """Project to OpenCV's tilted sensor (Louhichi et al., 2007); ``every`` gets its derivatives too; own derivatives.

    The rotation R about x by tauX, then about y by tauY, takes the plane z = 1 to the sensor; the point is projected
    back along the tilted optical axis: [R22 0 -R02; 0 R22 -R12; 0 0 1] R.
    """
    x, y = (coefficients.get(name, 0.0) for name in TILT)
    about_x, by_x = _turn((1, 2), x)
    about_y, by_y = _turn((2, 0), y)
    turn = about_y @ about_x
    plane = np.column_stack([bent, np.ones(len(bent))])
    there = plane @ (_back(turn) @ turn).T
    seen = there[:, :2] / there[:, 2:]
    onto = (np.eye(2, 3) - seen[:, :, None] * [0.0, 0.0, 1.0]) / there[:, 2:, None]
    by_bent = onto @ (_back(turn) @ turn)[:, :2]
    every[:] = by_bent @ every
    held = np.diag([0.0, 0.0, 1.0])  # the part of the way back that no angle changes
    for name, by_angle in zip(TILT, (about_y @ by_x, by_y @ about_x), strict=True):
        if name in coefficients:
            slope = (_back(by_angle) - held) @ turn + _back(turn) @ by_angle
            every[:, :, list(coefficients).index(name)] = np.einsum("nij,nj->ni", onto, plane @ slope.T)
    return seen, by_bent @ by_points


def _turn(axes: tuple[int, int], angle: float) -> tuple[Array, Array]:
    """Return the rotation matrix that turns the second of two axes to the first, and its derivative by the angle."""
    turn, slope = np.eye(3), np.zeros((3, 3))
    turn[np.ix_(axes, axes)] = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    slope[np.ix_(axes, axes)] = [[-np.sin(angle), np.cos(angle)], [-np.cos(angle), -np.sin(angle)]]
    return turn, slope


def _back(turn: Array) -> Array:
    """Return the projection back to the sensor."""
    return np.array([[turn[2, 2], 0.0, -turn[0, 2]], [0.0, turn[2, 2], -turn[1, 2]], [0.0, 0.0, 1.0]])


def _fisheye_with_jacobians(points: Array, k: Array, wanted: Sequence[int]) -> tuple[Array, Array, Array]:
    """Distort points; return also the derivatives by the points (N, 2, 2) and by the wanted coefficients (N, 2, K).

    The radius becomes a polynomial of the angle (Kannala and Brandt, 2006). Own derivatives, in memory as those of
    `_brown_with_jacobians`.
    """
    r = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-12)
    theta = np.arctan(r)
    t2 = theta * theta
    bent = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    bending = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])))
    slope = bending / (1.0 + r * r)
    scale = bent / r
    ux, uy = points[:, 0] / r, points[:, 1] / r

    by_points = np.empty((2, 2, len(r)))
    by_points[0, 0] = scale + (slope - scale) * ux * ux
    by_points[1, 1] = scale + (slope - scale) * uy * uy
    by_points[0, 1] = by_points[1, 0] = (slope - scale) * ux * uy

    powers = [theta * t2]
    for _ in range(max(wanted, default=0)):
        powers.append(powers[-1] * t2)
    by_coefficients = np.array([[ux * powers[at], uy * powers[at]] for at in wanted])
    by_coefficients = by_coefficients.reshape(len(wanted), 2, len(r))
    return points * scale[:, None], by_points.transpose(2, 0, 1), by_coefficients.transpose(2, 1, 0)
