"""Fit of a gimbal's readings to the rotations that a camera saw: closed-form starts, refinement, global optimum.

The camera is mounted on the gimbal's head with an unknown rotation A, and the gimbal's base stands before the target
with an unknown rotation B: R = A Rz(roll) Rx(tilt) Rz(squareness) Ry(pan) B. This is the rotation part of the
robot-world and hand-eye problem (Tsai and Lenz, 1989; Zhuang, Roth and Sudhakar, 1994). The sum of squares can have
more than one minimum. So several starts are refined and the lowest minimum is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import Array
from calib.model.gimbal import mountings
from calib.model.rotation import exp_map, log_map
from calib.studies.gimbal_model import Fault, GimbalModel

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
