"""Model of a gimbal: what its readings and its errors say about the rotation of its head.

The head turns by Rz(roll) Rx(tilt) Rz(squareness) Ry(pan). Each axis can have a scale and slips.

The angle of a relative rotation does not depend on how the camera is mounted or where the gimbal stands. So pairs of
poses show the scale of each axis without any other estimate, and a robust estimator survives single bad poses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.model.gimbal import Gimbal
from calib.model.rotation import log_map

Array = NDArray[np.float64]

#: Pairs with a smaller reading have no useful ratio, degrees.
_MOVED_DEG = 0.5
#: Above this angle the direction of a turn is uncertain, degrees.
_LARGEST_TURN_DEG = 170.0
#: An axis has its own ratio if the pairs separate it from the other axes this well (1 is best, 0 is not at all).
_SEPARATED = 0.1
_STEPS = 40
#: Standard deviation over median absolute deviation, of a Gaussian.
_MAD = 1.4826


@dataclass(frozen=True, eq=False)
class GimbalModel:
    """The readings of a gimbal, (n, 3) degrees of pan, tilt and roll, and the errors of it that are estimated.

    A slip has the index of its axis and of the first pose after it; squareness is the error of the right angle of pan
    and tilt; smooth is an error of the rotations that is quadratic in the angles.
    """

    angles: Array
    free: tuple[int, ...]
    slips: tuple[tuple[int, int], ...] = ()
    squareness: bool = False
    smooth: bool = False

    @property
    def parameter_count(self) -> int:
        """Number of parameters beside the rotations A and B."""
        return len(self.free) + len(self.slips) + self.squareness + self.bends.shape[2]

    @property
    def start(self) -> Array:
        """(p,) float64 values of an ideal gimbal."""
        values = np.zeros(self.parameter_count)
        values[: len(self.free)] = 1.0
        return values

    @cached_property
    def bends(self) -> Array:
        """(n, 3, m) float64 quadratic functions of the angles, as rotation vectors; m is 0 or 3 a function."""
        if not self.smooth:
            return np.zeros((len(self.angles), 3, 0))
        x = self.angles - self.angles.mean(axis=0)
        x = x / np.maximum(np.abs(x).max(axis=0), 1e-9)
        moved = [i for i in range(3) if np.ptp(self.angles[:, i]) > 0]
        products = [x[:, i] * x[:, j] for k, i in enumerate(moved) for j in moved[k:]]
        return np.concatenate([column[:, None, None] * np.eye(3) for column in products], axis=2)

    def subset(self, kept: NDArray[np.int64]) -> GimbalModel:
        """Return the model of (k,) poses, increasing; a slip begins at the first kept pose after it."""
        slips = tuple((axis, int(np.searchsorted(kept, first))) for axis, first in self.slips)
        return replace(self, angles=self.angles[kept], slips=slips)

    def heads(self, values: Array) -> tuple[Array, Array]:
        """Return the (n, 3, 3) rotations, head <- base, by readings and errors, and their (n, 3, d) derivatives.

        The derivatives are rotation vectors about the head's axes. The (p,) values are scales, slips, squareness and
        coefficients of the bends (rad); derivatives are by those before these.
        """
        read, count = np.deg2rad(self.angles), len(self.free)
        turned = read.copy()
        turned[:, list(self.free)] *= values[:count]
        after = [np.arange(len(read)) >= first for _, first in self.slips]
        for (axis, _), later, slip in zip(self.slips, after, values[count:], strict=False):
            turned[later, axis] += slip
        square = values[count + len(self.slips)] if self.squareness else 0.0
        heads, motors, leaning = Gimbal(non_orthogonality=float(square)).turned(np.rad2deg(turned))
        columns = [motors[:, :, axis] * read[:, axis, None] for axis in self.free]
        columns += [
            motors[:, :, axis] * later[:, None] for (axis, _), later in zip(self.slips, after, strict=True)
        ]
        if self.squareness:
            columns.append(leaning)
        return heads, np.stack(columns, axis=2) if columns else np.zeros((len(read), 3, 0))


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


def pair_ratios(
    rotations: Array, model: GimbalModel, covariance: Array, offsets: Array | None = None
) -> PairRatios | None:
    """Compare seen and read angles of all pairs of poses; None if no pair turned by half a degree or more.

    The ratio of each axis minimises the sum of the absolute differences of the angles (least absolute deviations, by
    iteratively reweighted least squares; Holland and Welsch, 1977). Rotations are camera <- target, covariances of
    rotation vectors (3 n, 3 n), rad^2; offsets are (s,) slips, rad.
    """
    i, j = np.triu_indices(len(rotations), 1)
    turns = log_map(rotations[i] @ np.swapaxes(rotations[j], 1, 2))
    seen = np.linalg.norm(turns, axis=1)
    read = _read(model, np.ones(len(model.free)), offsets, i, j)
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
    by_axis, estimator = _regression(model, offsets, middle, (i, j, seen), answer)
    sigma = {axis: float(np.sqrt(row @ covariance @ row)) for axis, row in estimator.items()}
    return PairRatios(float(middle), float(spread), len(seen), by_axis, sigma, estimator)


def weighted_median(values: Array, weights: Array) -> float:
    """Return the weighted median: half of the weight, which is positive, lies below it (Edgeworth, 1888)."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, 0.5 * below[-1])])


def _read(
    model: GimbalModel, scales: Array, offsets: Array | None, i: NDArray[np.int_], j: NDArray[np.int_]
) -> Array:
    """Return the angle between the heads of each pair, rad."""
    values = model.start
    values[: len(model.free)] = scales
    if offsets is not None:
        values[len(scales) : len(scales) + len(offsets)] = offsets
    heads, _ = model.heads(values)
    return np.asarray(np.linalg.norm(log_map(heads[i] @ np.swapaxes(heads[j], 1, 2)), axis=1))


def _regression(
    model: GimbalModel,
    offsets: Array | None,
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
    for _ in range(_STEPS):
        read = _read(model, scales, offsets, i, j)
        for k in range(count):
            shifted = scales.copy()
            shifted[k] += 1e-6
            slopes[:, k] = (_read(model, shifted, offsets, i, j) - read) / 1e-6
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
