"""Model of a gimbal: what its readings and its errors say about the rotation of its head.

The head turns by Rz(roll) Rx(tilt) Rz(squareness) Ry(pan). Each axis can have a scale, and the gimbal can have faults.

The angle of a relative rotation does not depend on how the camera is mounted or where the gimbal stands. So pairs of
poses show the scale of each axis without any other estimate, and a robust estimator survives single bad poses.

The fit to the rotations that a camera saw has more unknowns: the camera is mounted on the gimbal's head with a rotation
A, and the gimbal's base stands before the target with a rotation B, R = A Rz(roll) Rx(tilt) Rz(squareness) Ry(pan) B.
This is the rotation part of the robot-world and hand-eye problem (Tsai and Lenz, 1989; Zhuang, Roth and Sudhakar,
1994). The sum of squares can have more than one minimum. So several starts are refined and the lowest one is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array
from calib.model.gimbal import Gimbal, mountings
from calib.model.rotation import exp_map, log_map

#: Pairs with a smaller reading have no useful ratio, degrees.
_MOVED_DEG = 0.5
#: Above this angle the direction of a turn is uncertain, degrees.
_LARGEST_TURN_DEG = 170.0
#: An axis has its own ratio if the pairs separate it from the other axes this well (1 is best, 0 is not at all).
_SEPARATED = 0.1
_RATIO_STEPS = 40
#: Standard deviation over median absolute deviation, of a Gaussian.
_MAD = 1.4826


FaultKind = Literal["slip", "pose", "squareness"]


@dataclass(frozen=True)
class Fault:
    """A fault that a gimbal can have.

    ``slip``: the readings of an axis are off by a constant from a pose on. ``pose``: one pose does not fit.
    ``squareness``: the axes of pan and tilt are not at right angles.
    """

    kind: FaultKind
    axis: int = 0  # Index of the axis that slipped
    pose: int = 0  # Index of the first pose after the slip, or of the pose that does not fit

    @property
    def size(self) -> int:
        """Number of its parameters, rad: a wrong pose has a rotation vector."""
        return 3 if self.kind == "pose" else 1

    def columns(self, motors: Array, leaning: Array) -> Array:
        """Return (n, 3, size) derivatives of the rotations, from the axes as `Gimbal.turned` returns them."""
        if self.kind == "squareness":
            return leaning[:, :, None]
        if self.kind == "slip":
            return np.asarray(
                motors[:, :, [self.axis]] * (np.arange(len(motors)) >= self.pose)[:, None, None]
            )
        return np.asarray(np.eye(3) * (np.arange(len(motors)) == self.pose)[:, None, None])


@dataclass(frozen=True, eq=False)
class GimbalModel:
    """The readings of a gimbal, (n, 3) degrees of pan, tilt and roll, axes with a free scale, and faults."""

    angles: Array
    free: tuple[int, ...]
    faults: tuple[Fault, ...] = ()

    @property
    def start(self) -> Array:
        """(p,) float64 values of an ideal gimbal: scales, then the parameters of each fault, rad."""
        return np.append(np.ones(len(self.free)), np.zeros(sum(fault.size for fault in self.faults)))

    def of(self, fault: Fault, values: Array) -> Array:
        """Return the (size,) part of (p, ...) values that belongs to a fault."""
        at = self.faults.index(fault)
        first = len(self.free) + sum(one.size for one in self.faults[:at])
        return values[first : first + fault.size]

    def turned(self, values: Array) -> tuple[Array, Array, Array]:
        """Return (n, 3, 3) rotations, head <- base, and the axes that turn them, as `Gimbal.turned`, at (p,) values."""
        read, square = np.deg2rad(self.angles), 0.0
        read[:, list(self.free)] *= values[: len(self.free)]
        for fault in self.faults:
            if fault.kind == "slip":
                read[fault.pose :, fault.axis] += self.of(fault, values)[0]
            elif fault.kind == "squareness":
                square = float(self.of(fault, values)[0])
        return Gimbal(non_orthogonality=square).turned(np.rad2deg(read))

    def errors(self, values: Array) -> Array:
        """Return (n, 3) rotation vectors, rad, about the camera's axes by which poses do not fit."""
        errors = np.zeros((len(self.angles), 3))
        for fault in self.faults:
            if fault.kind == "pose":
                errors[fault.pose] = self.of(fault, values)
        return errors


@dataclass(frozen=True)
class PairRatios:
    """Angle seen over angle read, from all pairs of poses."""

    ratio: float
    spread: float
    count: int
    by_axis: Mapping[int, float]
    # 1-sigma of these ratios from the stated covariance of the rotations.
    by_axis_sigma: Mapping[int, float]
    # For each of these axes (3 n,) float64 change of the ratio by a change of the rotations, 1/rad.
    estimator: Mapping[int, Array] = field(repr=False)


def pair_ratios(rotations: Array, model: GimbalModel, covariance: Array, values: Array) -> PairRatios | None:
    """Compare seen and read angles of all pairs of poses that fit; None if none turned by half a degree or more.

    The ratio of each axis minimises the sum of the absolute differences of the angles (least absolute deviations, by
    iteratively reweighted least squares; Holland and Welsch, 1977). Rotations are camera <- target, covariances of
    rotation vectors (3 n, 3 n), rad^2; of the (p,) values of the model, the scales do not matter.
    """
    fits = [pose for pose in range(len(rotations)) if Fault("pose", pose=pose) not in model.faults]
    i, j = np.array(fits)[np.array(np.triu_indices(len(fits), 1))]
    turns = log_map(rotations[i] @ np.swapaxes(rotations[j], 1, 2))
    seen = np.linalg.norm(turns, axis=1)
    read = _read(model, np.ones(len(model.free)), values, i, j)
    used = (read > np.deg2rad(_MOVED_DEG)) & (np.maximum(seen, read) < np.deg2rad(_LARGEST_TURN_DEG))
    used &= seen > 0
    if not used.any():
        return None
    i, j, turns, seen, read = i[used], j[used], turns[used], seen[used], read[used]
    ratios = seen / read
    middle = weighted_median(ratios, read)
    spread = _MAD * weighted_median(np.abs(ratios - middle), read)
    # A rotation vector d at pose i changes the angle of the pair by u d, and at pose j by -u d.
    by_pose = np.zeros((len(seen), len(rotations), 3))
    rows = np.arange(len(seen))
    directions = turns / seen[:, None]
    by_pose[rows, i] += directions
    by_pose[rows, j] -= directions
    answer = by_pose.reshape(len(seen), -1)
    by_axis, estimator = _regression(model, values, middle, (i, j, seen), answer)
    sigma = {axis: float(np.sqrt(row @ covariance @ row)) for axis, row in estimator.items()}
    return PairRatios(float(middle), float(spread), len(seen), by_axis, sigma, estimator)


def weighted_median(values: Array, weights: Array) -> float:
    """Return the weighted median: half of the weight, which is positive, lies below it (Edgeworth, 1888)."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, 0.5 * below[-1])])


def _read(
    model: GimbalModel, scales: Array, values: Array, i: NDArray[np.int_], j: NDArray[np.int_]
) -> Array:
    """Return the angle between the heads of each pair, rad, with other scales than those of the (p,) values."""
    heads, _, _ = model.turned(np.append(scales, values[len(scales) :]))
    return np.asarray(np.linalg.norm(log_map(heads[i] @ np.swapaxes(heads[j], 1, 2)), axis=1))


def _regression(
    model: GimbalModel,
    values: Array,
    start: float,
    pairs: tuple[NDArray[np.int_], NDArray[np.int_], Array],
    answer: Array,
) -> tuple[dict[int, float], dict[int, Array]]:
    """Return the ratio of each axis, and its derivatives by the rotations (as `pair_ratios`)."""
    i, j, seen = pairs
    count = len(model.free)
    if not count or len(seen) < count:
        return {}, {}
    scales = np.full(count, start)
    weights = np.ones(len(seen))
    slopes = np.zeros((len(seen), count))
    for _ in range(_RATIO_STEPS):
        read = _read(model, scales, values, i, j)
        for k in range(count):
            shifted = scales.copy()
            shifted[k] += 1e-6
            slopes[:, k] = (_read(model, shifted, values, i, j) - read) / 1e-6
        off = seen - read
        weights = 1.0 / np.maximum(np.abs(off), max(0.1 * float(np.median(np.abs(off))), 1e-9))
        step = np.linalg.lstsq(slopes * np.sqrt(weights)[:, None], off * np.sqrt(weights), rcond=1e-9)[0]
        scales = scales + np.clip(step, -0.2, 0.2)
        if np.abs(step).max() < 1e-9:
            break
    lengths = np.linalg.norm(slopes, axis=0)
    if not (lengths > 0).all():
        return {}, {}
    # Sine of the angle between the slopes of an axis and those of the others (variance inflation; Belsley, 1980).
    products = (slopes / lengths).T @ (slopes / lengths) + 1e-12 * np.eye(count)
    separated = 1.0 / np.sqrt(np.diag(np.linalg.inv(products)))
    inverse = np.linalg.pinv(slopes * np.sqrt(weights)[:, None]) * np.sqrt(weights)
    rows = inverse @ answer
    clear = [k for k in range(count) if separated[k] > _SEPARATED]
    return (
        {model.free[k]: float(scales[k]) for k in clear},
        {model.free[k]: rows[k] for k in clear},
    )


#: A direction of the parameters is determined if its singular value exceeds this share of the largest.
_DETERMINED = 1e-7
_STEPS = 60
#: Starts whose elements differ by less than this lead to the same minimum.
_SAME = 1e-3


@dataclass(frozen=True, eq=False)
class GimbalFit:
    """A minimum of the sum of squares."""

    model: GimbalModel
    # camera_from_head, base_from_target: (3, 3) float64 rotations A and B.
    camera_from_head: Array
    base_from_target: Array
    values: Array  # (p,) float64 values of the model
    off: Array  # (3 n,) float64 seen minus read, as rotation vectors about the camera's axes, rad
    jacobian: Array  # (3 n, 6 + p) float64 derivatives of the rotations by A, B and the values
    # motors, leaning: (n, 3, 3) and (n, 3) axes as `Gimbal.turned` returns them, seen from the camera.
    motors: Array
    leaning: Array
    chi_square: float

    def columns(self, fault: Fault) -> Array:
        """Return (3 n, size) derivatives of the rotations by the parameters of a fault."""
        return fault.columns(self.motors, self.leaning).reshape(len(self.off), -1)

    def degrees_of_freedom(self) -> int:
        """Return the number of measured components minus the number of determined parameters."""
        return len(self.off) - int(np.linalg.matrix_rank(_unit_columns(self.jacobian)[0], tol=_DETERMINED))

    def undetermined_scales(self) -> bool:
        """Return whether different scales give the same rotations: an undetermined direction changes a scale."""
        columns, _ = _unit_columns(self.jacobian)
        _, singular, vt = np.linalg.svd(columns)
        null = vt[np.append(singular, np.zeros(len(vt) - len(singular))) <= _DETERMINED * singular[0]]
        return bool((np.abs(null[:, 6 : 6 + len(self.model.free)]) > _SAME).any())

    def estimator(self, whitening: Array) -> Array:
        """Return the (6 + p, 3 n) estimator of A, B and the values: generalised least squares (Aitken, 1936)."""
        columns, lengths = _unit_columns(whitening @ self.jacobian)
        return np.asarray(np.linalg.pinv(columns, rcond=_DETERMINED) @ whitening / lengths[:, None])


def fit_at(
    rotations: Array, model: GimbalModel, whitening: Array, parameters: tuple[Array, Array, Array]
) -> GimbalFit:
    """Compare the rotations with A, B and the (p,) values.

    Own derivation: with R = E A G B, a rotation vector a on the left of A turns R by E a, and b on the left of B turns
    it by E A G b. A motor turns the head about its own axis. E is the error of a pose that does not fit: its derivative
    is that at E = 1.
    """
    a, b, values = parameters
    read, errors = np.deg2rad(model.angles), exp_map(model.errors(values))
    heads, motors, leaning = model.turned(values)
    mounted = errors @ a
    head, motors, leaning = mounted @ heads, mounted @ motors, np.einsum("nij,nj->ni", mounted, leaning)
    off = log_map(rotations @ np.swapaxes(head @ b, 1, 2)).reshape(-1)
    free = list(model.free)
    columns = [errors, head, motors[:, :, free] * read[:, None, free]]
    columns += [fault.columns(motors, leaning) for fault in model.faults]
    jacobian = np.concatenate(columns, axis=2).reshape(len(off), -1)
    squares = float(((whitening @ off) ** 2).sum())
    return GimbalFit(model, a, b, values, off, jacobian, motors, leaning, squares)


def refine(
    rotations: Array, model: GimbalModel, whitening: Array, start: tuple[Array, Array, Array]
) -> GimbalFit:
    """Refine a start of A, B and the (p,) values by the method of Levenberg (1944) and Marquardt (1963).

    The (3 n, 3 n) whitening W has W^T W = inverse of the covariance of the rotations.
    """
    best, damping = fit_at(rotations, model, whitening, start), 1e-6
    for _ in range(_STEPS):
        columns, lengths = _unit_columns(whitening @ best.jacobian)
        weighted = whitening @ best.off
        u, singular, vt = np.linalg.svd(columns, full_matrices=False)
        kept = singular > _DETERMINED * singular[0]
        gains = np.where(kept, singular / (singular**2 + damping), 0.0)
        step = (vt.T @ (gains * (u.T @ weighted))) / lengths
        turned = exp_map(step[:3]) @ best.camera_from_head, exp_map(step[3:6]) @ best.base_from_target
        tried = fit_at(rotations, model, whitening, (*turned, best.values + step[6:]))
        gain = best.chi_square - tried.chi_square
        if gain < 0:
            damping = max(10.0 * damping, 1e-9)
            if damping > 1e8:
                break
            continue
        best, damping = tried, damping / 10.0
        if gain <= 1e-10 * (1.0 + best.chi_square):
            break
    return best


def global_fit(rotations: Array, model: GimbalModel, whitening: Array, values: Array) -> list[GimbalFit]:
    """Refine from all mountings that fit the rotations; return the minima that were found, by increasing chi-square.

    Minima with a scale below half or above twice its start are last, because a pan-tilt head with both A and the sign
    of an axis reversed gives the same rotations.
    """
    tried: list[Array] = []
    found = []
    for a, b in zip(*mountings(rotations, model.turned(values)[0]), strict=True):
        if all(np.abs(a - other).max() > _SAME for other in tried):
            tried.append(a)
            found.append(refine(rotations, model, whitening, (a, b, values)))
    return sorted(found, key=lambda fit: (not scales_near(fit, values), fit.chi_square))


def scales_near(fit: GimbalFit, values: Array) -> bool:
    """Return whether all scales, which come first, lie between half and twice their start, the (p,) values.

    False for a scale that is negative or absurd, and for axes half a turn away from a right angle.
    """
    model, count = fit.model, len(fit.model.free)
    ratio, square = fit.values[:count] / values[:count], Fault("squareness")
    leaning = model.of(square, fit.values)[0] if square in model.faults else 0.0
    return bool(((ratio > 0.5) & (ratio < 2.0)).all() and abs(leaning) < 1.0)


def _unit_columns(matrix: Array) -> tuple[Array, Array]:
    """Return the matrix with columns of unit length, and their lengths; zero columns stay."""
    lengths = np.linalg.norm(matrix, axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    return matrix / lengths, lengths
