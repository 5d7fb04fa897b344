"""Search for faults of a gimbal: a slipped axis, a camera that turned in its mount, a wrong pose, axes not square.

A fault is found if the likelihood ratio decides for it, whatever the number of places where it was looked for. Two
faults are also looked for together, because each can hide the other.

Every fault is a few columns of the linearised fit, with a prior of its size. The rotations scatter by the stated
covariance C and by s S, where S is one of several shapes: readings that scatter, rotations that scatter, or both with
smooth errors, quadratic in the angles or linear in time, as a collimator or a mount that creeps causes them. The
likelihood is the marginal one: mounting, standing, scales and sizes of the faults are integrated out (Bayesian linear
model; Bishop, 2006, section 3.3; Laplace's method for the sizes), shapes and s over a grid.

Without the scatter s, errors that all rotations share (an uncertain focal length) would absorb it, and the scales would
be absurd, far below 1. This is known as Peelle's pertinent puzzle.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy import linalg, special

from calib.arrays import Array
from calib.diagnosis.gimbal_model import Fault, FaultKind, GimbalFit, GimbalModel, fit_at, refine
from calib.model.likelihood_ratio import DECISIVE, needed

#: Prior of each parameter of a fault: Cauchy, half of all are larger than this, because sizes differ by orders of
#: magnitude.
_FAULT_RAD = np.deg2rad(0.02)
#: Prior 1 sigma of a scale.
_SCALE = 0.1
#: Scatter of rotations across the axes over that about the axes, if it is the readings that scatter.
_ACROSS = 0.05
#: Smooth errors over the scatter of each pose, and the prior probabilities of all shapes; that of readings is first.
_SMOOTH = (0.0, 1.0, 6.0, 36.0)
_SHAPES = np.array([0.3, 0.3, 0.15, 0.15, 0.1])
#: Scatters that are tried, from a share of the smallest stated one, and their number. None is as probable as all.
_LEAST_SHARE, _LARGEST_RAD, _TRIED = 0.3, 0.2, 28
_ROUNDS = 3
#: Least variance of a stated covariance, rad^2, and of a combination of rotations in units of the shape.
_ROUNDING, _LEAST = 1e-15, 1e-20
#: Least information on a size, in units of its prior.
_SINGULAR = 1e-6
#: Number of the most promising hypotheses that are fitted.
_FITTED = 4
#: Poses that are needed to look for faults.
_FEWEST = 5


@dataclass(frozen=True, eq=False)
class Scatter:
    """Covariance of the rotations, C + s S, diagonal in the basis U: U^T S U = 1."""

    eigenvalues: Array  # (3 n,) of C
    basis: Array  # (3 n, 3 n) float64 U
    variance: float = 0.0  # s, rad^2

    @property
    def whitening(self) -> Array:
        """(3 n, 3 n) float64 W with W^T W = inverse of the covariance; 1/rad."""
        return np.asarray((self.basis / np.sqrt(self.eigenvalues + self.variance)).T)

    @property
    def covariance(self) -> Array:
        """(3 n, 3 n) float64 covariance, rad^2."""
        root = np.linalg.inv(self.whitening)
        return np.asarray(root @ root.T)


@dataclass(frozen=True, eq=False)
class Explanation:
    """A model of the readings, fitted to the rotations."""

    fit: GimbalFit
    scatter: Scatter
    scattered: bool  # Whether the stated covariance alone is decisively less likely
    likelihood: float  # 2 log(likelihood), up to a constant

    @property
    def excess_rad(self) -> float:
        """Scatter of each component of a rotation that the stated covariance does not explain, 1 sigma, rad, or 0."""
        if not self.scattered:
            return 0.0
        root = np.linalg.inv(self.scatter.basis.T)
        return float(np.sqrt(self.scatter.variance * (root**2).sum(axis=1).mean()))

    @cached_property
    def covariance(self) -> Array:
        """(6 + p, 6 + p) covariance of mounting, standing and the values of the model."""
        return self.fit.covariance(self.scatter.whitening)


@dataclass(frozen=True, eq=False)
class SeenRotations:
    """Rotations seen, (n, 3, 3), camera <- target, and the (3 n, 3 n) covariance, rad^2, of their rotation vectors.

    A first fit of the gimbal says where its axes are.
    """

    rotations: Array
    covariance: Array
    first: GimbalFit

    @cached_property
    def _scatters(self) -> list[Scatter]:
        stated = self.covariance + _ROUNDING * np.eye(len(self.covariance))
        angles = self.first.model.angles
        moved = [i for i in range(3) if np.ptp(angles[:, i]) > 0]
        axes = self.first.motors[:, :, moved]
        readings = linalg.block_diag(*(axes @ np.swapaxes(axes, 1, 2))) + _ACROSS**2 * np.eye(len(stated))
        x = angles - angles.mean(axis=0)
        x = x / np.maximum(np.abs(x).max(axis=0), 1e-9)
        smooth = [x[:, i] * x[:, j] for k, i in enumerate(moved) for j in moved[k:]]
        smooth.append(np.linspace(-1.0, 1.0, len(x)))
        alike = np.kron(np.transpose(smooth) @ np.array(smooth), np.eye(3))
        shapes = [readings, *(np.eye(len(stated)) + ratio**2 * alike for ratio in _SMOOTH)]
        pairs = [linalg.eigh(stated, shape) for shape in shapes]
        return [Scatter(np.maximum(eigenvalues, _LEAST), basis) for eigenvalues, basis in pairs]

    @cached_property
    def _variances(self) -> Array:
        """(K,) variances s that are tried, rad^2; the first is 0."""
        least = _LEAST_SHARE * np.sqrt(max(float(np.diag(self.covariance).min()), _ROUNDING))
        return np.append(0.0, np.geomspace(least, _LARGEST_RAD, _TRIED) ** 2)

    def likelihoods(self, fit: GimbalFit, hypotheses: Sequence[tuple[Fault, ...]]) -> Array:
        """Return (H,) 2 log(likelihood) of hypotheses, each a set of faults, linearised at a fit."""
        return np.asarray(2.0 * special.logsumexp(self._grid(fit, hypotheses), axis=(0, 1)))

    def explain(self, model: GimbalModel, near: GimbalFit) -> Explanation:
        """Fit a model from a fit with fewer faults, or other scatter.

        The scatter is the mean over its posterior.
        """
        values = np.append(near.values, model.start[len(near.values) :])
        start = near.camera_from_head, near.base_from_target, values
        fit = fit_at(self.rotations, model, np.eye(len(self.covariance)), start)
        for _ in range(_ROUNDS):
            scatter, scattered = self._scatter(fit)
            start = fit.camera_from_head, fit.base_from_target, fit.values
            fit = refine(self.rotations, model, scatter.whitening, start)
        return Explanation(fit, scatter, scattered, float(self.likelihoods(fit, [model.faults])[0]))

    def _scatter(self, fit: GimbalFit) -> tuple[Scatter, bool]:
        """Return the scatter about a fit, and whether none is decisively less likely."""
        grid = self._grid(fit, [fit.model.faults])[:, :, 0]
        more, none = special.logsumexp(grid[:, 1:]), special.logsumexp(grid[:, 0])
        best = int(special.logsumexp(grid, axis=1).argmax())
        variance = float(special.softmax(grid[best]) @ self._variances)
        return replace(self._scatters[best], variance=variance), bool(2.0 * (more - none) > DECISIVE)

    def _grid(self, fit: GimbalFit, hypotheses: Sequence[tuple[Fault, ...]]) -> Array:
        """Return (R, K, H) log(likelihood times prior) of each hypothesis, for each shape S and variance s."""
        faults = list(dict.fromkeys(fault for hypothesis in hypotheses for fault in hypothesis))
        count = len(fit.model.free)
        turns, singular, _ = np.linalg.svd(fit.jacobian[:, :6], full_matrices=False)
        turns = turns[:, singular > 1e-7 * singular[0]]
        scales = _SCALE * fit.jacobian[:, 6 : 6 + count]
        sizes = [_FAULT_RAD * fit.columns(fault) for fault in faults]
        off = fit.off + fit.jacobian[:, 6:] @ (fit.values - fit.model.start)
        stacked = np.hstack([turns, scales, *sizes, off[:, None]])
        always = turns.shape[1] + count
        ends = np.cumsum([0, *(fault.size for fault in faults)])
        prior = np.repeat([0.0, 1.0, _SINGULAR, 0.0], [turns.shape[1], count, ends[-1], 1])
        places = {fault: range(ends[k], ends[k + 1]) for k, fault in enumerate(faults)}
        indices = [[at for fault in hypothesis for at in places[fault]] for hypothesis in hypotheses]
        answer = np.empty((len(_SHAPES), len(self._variances), len(hypotheses)))
        steps = np.log(np.append(0.5, np.full(_TRIED, 0.5 / _TRIED)))
        for k, scatter in enumerate(self._scatters):
            z = scatter.basis.T @ stacked
            variances = scatter.eigenvalues + self._variances[:, None]
            gram = (z.T / variances[:, None]) @ z + np.diag(prior)
            own, cross = gram[:, :always, :always], gram[:, :always, always:]
            rest = gram[:, always:, always:] - np.swapaxes(cross, 1, 2) @ np.linalg.solve(own, cross)
            base = -np.log(variances).sum(axis=1) - np.linalg.slogdet(own)[1] - rest[:, -1, -1]
            base += 2.0 * np.linalg.slogdet(scatter.basis)[1]
            answer[k] = 0.5 * (base[:, None] + _gains(rest, indices)) + steps[:, None] + np.log(_SHAPES[k])
        return answer


def _gains(rest: Array, hypotheses: Sequence[Sequence[int]]) -> Array:
    """Return (K, H) gains of 2 log(likelihood) by columns, of (K, m, m) their products; the residual is the last."""
    gains = np.zeros((len(rest), len(hypotheses)))
    for size in {len(hypothesis) for hypothesis in hypotheses} - {0}:
        which = [k for k, hypothesis in enumerate(hypotheses) if len(hypothesis) == size]
        at = np.array([hypotheses[k] for k in which])
        normal, right = rest[:, at[:, :, None], at[:, None, :]], rest[:, at, -1]
        sizes = np.linalg.solve(normal, right[..., None])[..., 0]
        gains[:, which] = (right * sizes - 2.0 * np.log1p(sizes**2)).sum(axis=-1)
        gains[:, which] -= np.linalg.slogdet(normal + np.eye(size))[1]
    return gains


@dataclass(frozen=True, kw_only=True)
class GimbalFault(Fault):
    """A fault of the gimbal, or of one pose, that the rotations show."""

    size_deg: float  # Size of the fault, degrees; for ``pose`` the angle by which it is off
    sigma_deg: float  # 1-sigma of the size, degrees
    probability: float  # That there is no such fault
    # Kind of another fault that explains the data nearly as well; None if there is none.
    rival: FaultKind | None = None


def search_faults(
    seen: SeenRotations, first: Explanation, axes: tuple[int, ...]
) -> tuple[Explanation, tuple[GimbalFault, ...]]:
    """Add faults as long as the likelihood ratio decides for them; the most probable fault is first.

    Forward selection (Efroymson, 1960).
    """
    places = _places(len(seen.rotations), axes)
    number = Counter(fault.kind for fault in places)
    cost = {fault: needed(number[fault.kind]) for fault in places}
    current = first
    for _ in range(_ROUNDS if places else 0):
        known = current.fit.model.faults
        new = [fault for fault in places if fault not in known]
        tried = [(*known, *combination) for count in (1, 2) for combination in combinations(new, count)]
        worth = seen.likelihoods(current.fit, tried) - [_cost(faults, cost) for faults in tried]
        models = [replace(current.fit.model, faults=tried[k]) for k in np.argsort(-worth)[:_FITTED]]
        explanations = [current, *(seen.explain(model, current.fit) for model in models)]
        best = max(
            explanations,
            key=lambda explanation: explanation.likelihood - _cost(explanation.fit.model.faults, cost),
        )
        if best is current:
            break
        current = best
    faults = [_described(seen, current, fault, cost) for fault in current.fit.model.faults]
    return current, tuple(sorted(faults, key=lambda fault: fault.probability))


def _places(count: int, axes: tuple[int, ...]) -> list[Fault]:
    """Return the faults that can be seen in a number of poses, with readings of some axes."""
    if count < _FEWEST:
        return []
    square = [Fault("squareness")] if {0, 1} <= set(axes) else []
    steps = range(2, count - 1)  # before and after, two poses or more: a step at an end is one wrong pose
    slips = [Fault("slip", axis, first) for axis in axes for first in steps]
    turns = [Fault("mount", pose=first) for first in steps]
    return [*square, *slips, *turns, *(Fault("pose", pose=pose) for pose in range(count))]


def _cost(faults: Sequence[Fault], cost: Mapping[Fault, float]) -> float:
    """Return what 2 log(likelihood) must gain by faults, from what it must gain by each that can be seen."""
    return sum(cost[fault] for fault in faults)


def _described(
    seen: SeenRotations, explanation: Explanation, fault: Fault, cost: Mapping[Fault, float]
) -> GimbalFault:
    """Return one of the faults found with its size, its uncertainty and its rival."""
    model = explanation.fit.model
    spread = model.of(fault, model.of(fault, explanation.covariance[6:, 6:]).T)
    value = model.of(fault, explanation.fit.values)
    size = float(value[0] if fault.size == 1 else np.linalg.norm(value))
    others = tuple(other for other in model.faults if other != fault)
    rivals = [(*others, other) for other in cost if other.kind != fault.kind and other not in others]
    tried = [model.faults, others, *rivals]
    worth = seen.likelihoods(explanation.fit, tried) - [_cost(faults, cost) for faults in tried]
    worth[1] -= DECISIVE
    best = int(worth[2:].argmax()) if rivals else 0
    undecided = bool(rivals) and worth[2 + best] > worth[0] - DECISIVE
    return GimbalFault(
        fault.kind,
        fault.axis,
        fault.pose,
        size_deg=float(np.rad2deg(size)),
        sigma_deg=float(np.rad2deg(np.sqrt(np.linalg.eigvalsh(spread)[-1]))),
        probability=float(special.expit(0.5 * (worth[1] - worth[0]))),
        rival=rivals[best][-1].kind if undecided else None,
    )
