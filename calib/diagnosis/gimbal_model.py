"""Model of a gimbal: what its readings and its errors say about the rotation of its head.

The head turns by Rz(roll) Rx(tilt) Rz(squareness) Ry(pan). Each axis can have a scale, and the gimbal can have faults.

The angle of a relative rotation does not depend on how the camera is mounted or where the gimbal stands. So pairs of
poses show about what the scales are without any other estimate.

The fit to the rotations that a camera saw has more unknowns: the camera is mounted on the gimbal's head with a rotation
A, and the gimbal's base stands before the target with a rotation B, R = A Rz(roll) Rx(tilt) Rz(squareness) Ry(pan) B.
This is the rotation part of the robot-world and hand-eye problem (Tsai and Lenz, 1989; Zhuang, Roth and Sudhakar,
1994). The sum of squares can have more than one minimum. So several starts are refined and the lowest one is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy import linalg

from calib.arrays import Array, Bools
from calib.model.gimbal import Gimbal, mountings
from calib.model.rotation import exp_map, log_map

#: Pairs with a smaller reading have no useful ratio, degrees.
_MOVED_DEG = 0.5
#: Above this angle the direction of a turn is uncertain, degrees.
_LARGEST_TURN_DEG = 170.0
_RATIO_STEPS = 10  # Of reweighting: a start for a search needs no more
#: Squares of angles below this are rounding, rad^2.
_TINY = 1e-14
#: Standard deviation over median absolute deviation, of a Gaussian.
_MAD = 1.4826


FaultKind = Literal["slip", "mount", "pose", "squareness"]
#: A direction of the parameters is determined if its singular value exceeds this share of the largest.
_DETERMINED = 1e-7
_STEPS = 60
#: Starts whose elements differ by less than this lead to the same minimum.
_SAME = 1e-3


@dataclass(frozen=True)
class Fault:
    """A fault that a gimbal can have.

    ``slip``: the readings of an axis are off by a constant from a pose on. ``mount``: the camera turned in its mount
    before a pose. ``pose``: one pose does not fit. ``squareness``: the axes of pan and tilt are not at right angles.
    """

    kind: FaultKind
    axis: int = 0  # Index of the axis that slipped
    pose: int = 0  # Index of the first pose after slip or turn, or of the pose that does not fit

    @property
    def size(self) -> int:
        """Number of its parameters, rad: a turned camera and a wrong pose have a rotation vector."""
        return 3 if self.kind in {"mount", "pose"} else 1

    def poses(self, count: int) -> Bools:
        """Return (count,) which poses have it: all from the first one on, or the one that does not fit."""
        numbers = np.arange(count)
        return numbers == self.pose if self.kind == "pose" else numbers >= self.pose

    def columns(self, motors: Array, leaning: Array) -> Array:
        """Return (n, 3, size) derivatives of the rotations, from the axes as `Gimbal.turned` returns them."""
        if self.kind == "squareness":
            return leaning[:, :, None]
        turned = motors[:, :, [self.axis]] if self.kind == "slip" else np.eye(3)
        return np.asarray(turned * self.poses(len(motors))[:, None, None])


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
        first = len(self.free) + sum(earlier_fault.size for earlier_fault in self.faults[:at])
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
        """Return (n, 3) rotation vectors, rad, about the camera's axes by which it has turned or poses do not fit."""
        errors = np.zeros((len(self.angles), 3))
        for fault in self.faults:
            if fault.size > 1:
                errors[fault.poses(len(errors))] += self.of(fault, values)
        return errors


@dataclass(frozen=True)
class PairRatios:
    """Angle seen over angle read, from all pairs of poses: median, and robust standard deviation."""

    ratio: float
    spread: float
    count: int


def pair_ratios(rotations: Array, model: GimbalModel, values: Array) -> PairRatios | None:
    """Compare seen and read angles of all pairs of poses that fit; None if none turned by half a degree or more.

    Rotations are camera <- target. Of the (p,) values of the model, the scales do not matter.
    """
    fits = [pose for pose in range(len(rotations)) if Fault("pose", pose=pose) not in model.faults]
    unit = np.append(model.start[: len(model.free)], values[len(model.free) :])
    seen, read = _pairs(rotations[fits]), _pairs(model.turned(unit)[0][fits])
    used = (read > np.deg2rad(_MOVED_DEG)) & (np.maximum(seen, read) < np.deg2rad(_LARGEST_TURN_DEG))
    used &= seen > 0
    if not used.any():
        return None
    ratios, read = seen[used] / read[used], read[used]
    middle = weighted_median(ratios, read)
    spread = _MAD * weighted_median(np.abs(ratios - middle), read)
    return PairRatios(middle, spread, len(ratios))


def first_scales(rotations: Array, model: GimbalModel) -> Array:
    """Return the (a,) scales of the free axes with which a search starts: squares of small angles add up.

    Least absolute deviations by iteratively reweighted least squares (Holland and Welsch, 1977), so that single wrong
    poses do not matter. An axis that pairs of poses do not show gets the median ratio of all.
    """
    i, j = np.triu_indices(len(rotations), 1)
    read = np.deg2rad(model.angles[i] - model.angles[j])[:, list(model.free)] ** 2
    seen = _pairs(rotations) ** 2
    ratios = pair_ratios(rotations, model, model.start)
    ratio = ratios.ratio if ratios else 1.0
    squares = np.full(len(model.free), ratio**2)
    for _ in range(_RATIO_STEPS):
        off = np.abs(seen - read @ squares)
        root = 1.0 / np.sqrt(np.maximum(off, max(0.1 * float(np.median(off)), _TINY)))
        squares = np.linalg.lstsq(read * root[:, None], seen * root, rcond=_DETERMINED)[0]
    return np.where(squares > 0, np.sqrt(np.maximum(squares, 0.0)), ratio)


def weighted_median(values: Array, weights: Array) -> float:
    """Return the weighted median: half of the weight, which is positive, lies below it (Edgeworth, 1888)."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, 0.5 * below[-1])])


def _pairs(rotations: Array) -> Array:
    """Return the angles between (n, 3, 3) rotations, pair by pair, rad."""
    i, j = np.triu_indices(len(rotations), 1)
    return np.asarray(np.linalg.norm(log_map(rotations[i] @ np.swapaxes(rotations[j], 1, 2)), axis=1))


@dataclass(frozen=True, eq=False)
class GimbalFit:
    """A minimum of the sum of squares."""

    model: GimbalModel
    camera_from_head: Array  # (3, 3) float64 rotation A
    base_from_target: Array  # (3, 3) float64 rotation B
    values: Array  # (p,) float64 values of the model
    off: Array  # (3 n,) float64 seen minus read, as rotation vectors about the camera's axes, rad
    jacobian: Array  # (3 n, 6 + p) float64 derivatives of the rotations by A, B and the values
    motors: Array  # (n, 3, 3) axes as `Gimbal.turned` returns them, seen from the camera
    leaning: Array  # (n, 3) axis of the lean as `Gimbal.turned` returns it, seen from the camera
    chi_square: float

    def columns(self, fault: Fault) -> Array:
        """Return (3 n, size) derivatives of the rotations by the parameters of a fault."""
        return fault.columns(self.motors, self.leaning).reshape(len(self.off), -1)

    @cached_property
    def open_directions(self) -> Array:
        """(6 + p, d) orthonormal changes of A, B and the values, in units of their effect, that turn nothing."""
        return np.asarray(linalg.null_space(_unit_columns(self.jacobian)[0], rcond=_DETERMINED))

    @property
    def degrees_of_freedom(self) -> int:
        """How many measured numbers there are more than parameters that they determine."""
        return len(self.off) - self.jacobian.shape[1] + self.open_directions.shape[1]

    @property
    def undetermined_scales(self) -> bool:
        """Whether different scales give the same rotations."""
        return bool((np.abs(self.open_directions[6 : 6 + len(self.model.free)]) > _SAME).any())

    def covariance(self, whitening: Array) -> Array:
        """Return the (6 + p, 6 + p) covariance of A, B and the values: generalised least squares (Aitken, 1936)."""
        columns, lengths = _unit_columns(whitening @ self.jacobian)
        root = np.linalg.pinv(columns, rcond=_DETERMINED) / lengths[:, None]
        return np.asarray(root @ root.T)


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
    fits = []
    for a, b in zip(*mountings(rotations, model.turned(values)[0]), strict=True):
        if all(np.abs(a - other).max() > _SAME for other in tried):
            tried.append(a)
            fits.append(refine(rotations, model, whitening, (a, b, values)))
    return sorted(fits, key=lambda fit: (not scales_near(fit, values), fit.chi_square))


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
