"""Model of a gimbal: what its readings and its errors say about the rotation of its head.

The head turns by Rz(roll) Rx(tilt) Ry(pan). Each axis can have a scale, and suspects turn the camera further.

The angle of a relative rotation does not depend on how the camera is mounted or where the gimbal stands. So pairs of
poses show about what the scales are without any other estimate.

The fit to the rotations that a camera saw has more unknowns: the camera is mounted on the gimbal's head with a rotation
A, and the gimbal's base stands before the target with a rotation B, R = A Rz(roll) Rx(tilt) Ry(pan) B.
This is the rotation part of the robot-world and hand-eye problem (Tsai and Lenz, 1989; Zhuang, Roth and Sudhakar,
1994). The sum of squares can have more than one minimum. So several starts are refined and the lowest one is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from calib.arrays import Array
from calib.diagnosis.suspects import AXIS_ORDER, TARGET_ORDER, Frames, Suspect
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


#: A direction of the parameters is determined if its singular value exceeds this share of the largest.
_DETERMINED = 1e-7
#: At most: a search ends when a step gains nothing.
_STEPS = 60
#: Starts whose elements differ by less than this lead to the same minimum.
_SAME = 1e-3


@dataclass(frozen=True, eq=False)
class GimbalModel:
    """The readings of a gimbal, axes with a free scale, and suspects."""

    angles: Array  # (n, 3) of pan, tilt and roll, degrees
    times: Array  # (n,) when they were read, 0 the first and 1 the last
    free: tuple[int, ...]
    suspects: tuple[Suspect, ...] = ()

    @property
    def start(self) -> Array:
        """(p,) float64 values of an ideal gimbal: scales, then the parameters of each suspect, rad."""
        return np.append(np.ones(len(self.free)), np.zeros(sum(suspect.size for suspect in self.suspects)))

    def of(self, suspect: Suspect, values: Array) -> Array:
        """Return the (size,) part of (p, ...) values that belongs to a suspect."""
        at = self.suspects.index(suspect)
        first = len(self.free) + sum(earlier.size for earlier in self.suspects[:at])
        return values[first : first + suspect.size]

    def read_deg(self, values: Array) -> Array:
        """Return the (n, 3) angles with the scales of (p,) values."""
        angles = self.angles.copy()
        angles[:, list(self.free)] *= values[: len(self.free)]
        return angles

    def heads(self, values: Array) -> Array:
        """Return the (n, 3, 3) rotations, head <- base, at the scales of (p,) values."""
        return Gimbal().heads(self.read_deg(values))


@dataclass(frozen=True)
class PairRatios:
    """Angle seen over angle read, from all pairs of poses: median, and robust standard deviation."""

    ratio: float
    spread: float
    count: int


def pair_ratios(rotations: Array, angles_deg: Array) -> PairRatios | None:
    """Compare angles, seen by (n, 3, 3) rotations and read, of all pairs of poses; None if none turned far enough."""
    seen, read = _pairs(rotations), _pairs(Gimbal().heads(angles_deg))
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
    ratios = pair_ratios(rotations, model.angles)
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
    errors: Array  # (n, 3, 3) turns of the camera by the suspects
    frames: Frames  # About what further suspects would turn the camera
    chi_square: float

    def columns(self, suspect: Suspect) -> Array:
        """Return (3 n, size) derivatives of the rotations by the parameters of a suspect."""
        return suspect.columns(self.frames).reshape(len(self.off), -1)

    @cached_property
    def open_directions(self) -> Array:
        """(6 + p, d) orthonormal changes of A, B and the values, in units of their effect, that turn nothing."""
        return np.asarray(linalg.null_space(_unit_columns(self.jacobian)[0], rcond=_DETERMINED))

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

    Own derivation: R = E A G B, where E is the product of the turns by all suspects in their order, each about its axes
    as they stand without the others. A turn a on the left of A, b on the left of B, or one about a motor's axis, turns
    R as seen through those suspects that come before.
    """
    a, b, values = parameters
    head, motors, leaning = Gimbal(a, b).turned(model.read_deg(values))
    frames = Frames(motors, leaning[:, :, None], head @ b, model.times)
    about = [suspect.columns(frames) for suspect in model.suspects]
    turns = [exp_map(axes @ model.of(own, values)) for own, axes in zip(model.suspects, about, strict=True)]

    def before(order: int) -> Array:
        errors = np.asarray(np.broadcast_to(np.eye(3), head.shape), np.float64)
        for k in sorted(range(len(turns)), key=lambda k: model.suspects[k].order):
            errors = errors @ turns[k] if model.suspects[k].order < order else errors
        return errors

    errors = before(TARGET_ORDER + 1)
    seen = frames.turned(errors)
    off = log_map(rotations @ np.swapaxes(seen.target, 1, 2)).reshape(-1)
    columns = [before(1), before(TARGET_ORDER) @ head]
    columns += [
        before(AXIS_ORDER[axis]) @ motors[:, :, [axis]] * np.deg2rad(model.angles)[:, None, [axis]]
        for axis in model.free
    ]
    columns += [before(own.order) @ axes for own, axes in zip(model.suspects, about, strict=True)]
    jacobian = np.concatenate(columns, axis=2).reshape(len(off), -1)
    squares = float(((whitening @ off) ** 2).sum())
    return GimbalFit(model, a, b, values, off, jacobian, errors, seen, squares)


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
    for a, b in zip(*mountings(rotations, model.heads(values)), strict=True):
        if all(np.abs(a - other).max() > _SAME for other in tried):
            tried.append(a)
            fits.append(refine(rotations, model, whitening, (a, b, values)))
    return sorted(fits, key=lambda fit: (not scales_near(fit, values), fit.chi_square))


def scales_near(fit: GimbalFit, values: Array) -> bool:
    """Return whether all scales, which come first, lie between half and twice their start, the (p,) values."""
    count = len(fit.model.free)
    ratio = fit.values[:count] / values[:count]
    return bool(((ratio > 0.5) & (ratio < 2.0)).all())


def _unit_columns(matrix: Array) -> tuple[Array, Array]:
    """Return the matrix with columns of unit length, and their lengths; zero columns stay."""
    lengths = np.linalg.norm(matrix, axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    return matrix / lengths, lengths
