"""The suspects of a gimbal and its camera, weighed against each other by one evidence.

Every suspect is a few columns of the linearised fit, with a prior of its size. The rotations scatter by the stated
covariance C and by s S, where S is one of several shapes: readings that scatter, rotations that scatter, or these with
smooth errors, quadratic in the angles, as a collimator causes them. The likelihood is the marginal one: mounting,
standing, scales and sizes of the suspects are integrated out (Bayesian linear model; Bishop, 2006, section 3.3;
Laplace's method for the sizes), shapes and s over a grid. Two suspects of a kind are also looked for together, because
each can hide the other.

Without the scatter s, errors that all rotations share (an uncertain focal length) would absorb it, and the scales would
be absurd, far below 1. This is known as Peelle's pertinent puzzle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy import linalg, special

from calib.arrays import Array
from calib.diagnosis.gimbal_model import GimbalFit, GimbalModel, fit_at, refine
from calib.diagnosis.suspects import ODDS, Suspect, suspects
from calib.model import cause as kinds
from calib.model.likelihood_ratio import ALONE, DECISIVE

#: Prior of each parameter of a suspect: Cauchy, half of all are larger than this, because sizes differ by orders of
#: magnitude.
_SIZE_RAD = np.deg2rad(0.02)
#: Prior 1 sigma of a scale, or how far it is off if that is more.
_SCALE = 0.1
#: Scatter of rotations across the axes over that about the axes, if it is the readings that scatter.
_ACROSS = 0.05
#: Smooth errors over the scatter of each pose, and the prior probabilities of all shapes; that of readings is first.
_SMOOTH = (0.0, 1.0, 6.0, 36.0)
_SHAPES = np.array([0.3, 0.3, 0.15, 0.15, 0.1])
#: Scatters that are tried, from a share of the smallest stated one, and their number. None is as probable as all.
_LEAST_SHARE, _LARGEST_RAD, _TRIED = 0.3, 0.2, 28
#: Fits of a model, each with the scatter that the last one leaves; and suspects, or pairs of them, that are found at
#: most.
_ROUNDS = 3
#: Least variance of a stated covariance, rad^2, and of a combination of rotations in units of the shape.
_ROUNDING, _LEAST = 1e-15, 1e-20
#: Least information on a size, in units of its prior.
_SINGULAR = 1e-6
#: Cosine of the angle between the target's normal and the axis of a holder, which leans by some degrees.
_ALONG = 0.99
#: Number of the most promising hypotheses that are fitted; it bounds the time.
_FITTED = 4


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
    # 2 log of the odds, against the stated covariance alone: readings scatter, rotations do, errors are smooth.
    scatters: Array
    likelihood: float  # 2 log(likelihood), up to a constant

    @property
    def scattered(self) -> bool:
        """Whether the stated covariance alone is decisively less likely."""
        return bool(self.scatters.max() > DECISIVE)

    @property
    def excess_rad(self) -> float:
        """Scatter of each component of a rotation that the stated covariance does not explain, 1 sigma, rad, or 0.

        The root of s times the mean diagonal element of S = U^-T U^-1.
        """
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
        """Scatters beyond the stated covariance C: of the readings, and smooth functions of the angles.

        For each shape S of a scatter, the eigenvectors of C v = l S v make C + s S diagonal for every variance s.
        """
        stated = self.covariance + _ROUNDING * np.eye(len(self.covariance))
        angles = self.first.model.angles
        moved = [i for i in range(3) if np.ptp(angles[:, i]) > 0]
        axes = self.first.frames.motors[:, :, moved]
        readings = linalg.block_diag(*(axes @ np.swapaxes(axes, 1, 2))) + _ACROSS**2 * np.eye(len(stated))
        x = angles - angles.mean(axis=0)
        x = x / np.maximum(np.abs(x).max(axis=0), 1e-9)
        smooth = [x[:, i] * x[:, j] for k, i in enumerate(moved) for j in moved[k:]]
        alike = np.kron(np.transpose(smooth) @ np.array(smooth), np.eye(3))
        shapes = [readings, *(np.eye(len(stated)) + ratio**2 * alike for ratio in _SMOOTH)]
        pairs = [linalg.eigh(stated, shape) for shape in shapes]
        return [Scatter(np.maximum(eigenvalues, _LEAST), basis) for eigenvalues, basis in pairs]

    @cached_property
    def _variances(self) -> Array:
        """(K,) variances s that are tried, rad^2; the first is 0."""
        least = _LEAST_SHARE * np.sqrt(max(float(np.diag(self.covariance).min()), _ROUNDING))
        return np.append(0.0, np.geomspace(least, _LARGEST_RAD, _TRIED) ** 2)

    def likelihoods(self, fit: GimbalFit, hypotheses: Sequence[tuple[Suspect, ...]]) -> Array:
        """Return (H,) 2 log(likelihood) of hypotheses, each a set of suspects, linearised at a fit."""
        return np.asarray(2.0 * special.logsumexp(self._grid(fit, hypotheses), axis=(0, 1)))

    def explain(self, model: GimbalModel, near: GimbalFit) -> Explanation:
        """Fit a model from a fit with other suspects, or other scatter.

        The scatter is the mean over its posterior.
        """
        known = near.model.suspects
        sizes = [
            near.model.of(own, near.values) if own in known else np.zeros(own.size) for own in model.suspects
        ]
        values = np.concatenate([near.values[: len(model.free)], *sizes])
        start = near.camera_from_head, near.base_from_target, values
        fit = fit_at(self.rotations, model, np.eye(len(self.covariance)), start)
        for _ in range(_ROUNDS):
            grid = self._grid(fit, [model.suspects])[:, :, 0]
            best = int(special.logsumexp(grid, axis=1).argmax())
            variance = float(special.softmax(grid[best]) @ self._variances)
            scatter = replace(self._scatters[best], variance=variance)
            start = fit.camera_from_head, fit.base_from_target, fit.values
            fit = refine(self.rotations, model, scatter.whitening, start)
        each = [special.logsumexp(part) for part in (grid[0, 1:], grid[1, 1:], grid[2:, 1:])]
        scatters = 2.0 * (np.array(each) - special.logsumexp(grid[:, 0]))
        return Explanation(fit, scatter, scatters, float(self.likelihoods(fit, [model.suspects])[0]))

    def _grid(self, fit: GimbalFit, hypotheses: Sequence[tuple[Suspect, ...]]) -> Array:
        """Return (R, K, H) log(likelihood times prior) of each hypothesis, for each shape S and variance s.

        Without suspects, 2 log = -log det(C + s S) - log det N - (squares that are left), with the information N of
        mounting, standing and scales, which are integrated out (Bishop, 2006, section 3.5); `_gains` adds the suspects.
        """
        every = list(dict.fromkeys(suspect for hypothesis in hypotheses for suspect in hypothesis))
        count = len(fit.model.free)
        turns, singular, _ = np.linalg.svd(fit.jacobian[:, :6], full_matrices=False)
        turns = turns[:, singular > 1e-7 * singular[0]]
        scales = np.maximum(_SCALE, np.abs(fit.values[:count] - 1.0)) * fit.jacobian[:, 6 : 6 + count]
        sizes = [_SIZE_RAD * fit.columns(suspect) for suspect in every]
        off = fit.off + fit.jacobian[:, 6:] @ (fit.values - fit.model.start)
        stacked = np.hstack([turns, scales, *sizes, off[:, None]])
        always = turns.shape[1] + count
        ends = np.cumsum([0, *(suspect.size for suspect in every)])
        prior = np.repeat([0.0, 1.0, _SINGULAR, 0.0], [turns.shape[1], count, ends[-1], 1])
        places = {suspect: range(ends[k], ends[k + 1]) for k, suspect in enumerate(every)}
        indices = [[at for suspect in hypothesis for at in places[suspect]] for hypothesis in hypotheses]
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
    """Return (K, H) gains of 2 log(likelihood) by columns, of (K, m, m) their products; the residual is the last.

    Own use of Laplace's method at the least-squares sizes x, in units of their Cauchy prior: with the normal equations
    N x = b, the gain is b.x - 2 sum log(1 + x^2) - log det(N + 1), which is 0 without information.
    """
    gains = np.zeros((len(rest), len(hypotheses)))
    for size in {len(hypothesis) for hypothesis in hypotheses} - {0}:
        which = [k for k, hypothesis in enumerate(hypotheses) if len(hypothesis) == size]
        at = np.array([hypotheses[k] for k in which])
        normal, right = rest[:, at[:, :, None], at[:, None, :]], rest[:, at, -1]
        sizes = np.linalg.solve(normal, right[..., None])[..., 0]
        gains[:, which] = (right * sizes - 2.0 * np.log1p(sizes**2)).sum(axis=-1)
        gains[:, which] -= np.linalg.slogdet(normal + np.eye(size))[1]
    return gains


@dataclass(frozen=True)
class Found:
    """A suspect that explains the rotations, or one of several that do."""

    suspect: Suspect
    size_rad: float  # Of a rotation vector its length
    sigma_rad: float  # 1-sigma of the size
    evidence: float  # 2 log of the odds against a gimbal without it
    beside: tuple[str, ...]  # Other kinds that explain the rotations nearly as well, the most probable first


def search(
    seen: SeenRotations, first: Explanation, axes: tuple[int, ...]
) -> tuple[Explanation, tuple[Found, ...], float]:
    """Add suspects as long as their odds are better than those of fewer; the most probable one is first.

    Forward selection (Efroymson, 1960). Returns also 2 log of the likelihood times the odds.
    """
    cost = dict.fromkeys(first.fit.model.suspects, 0.0) | suspects(len(seen.rotations), axes)
    current = first
    for _ in range(_ROUNDS if cost else 0):
        known = current.fit.model.suspects
        new = [suspect for suspect in cost if suspect not in known]
        pairs = [pair for pair in combinations(new, 2) if pair[0].kind == pair[1].kind]
        tried = [(*known, *more) for more in (*((one,) for one in new), *pairs)]
        worth = seen.likelihoods(current.fit, tried) - [_sum(cost, each) for each in tried]
        models = [replace(current.fit.model, suspects=tried[k]) for k in np.argsort(-worth)[:_FITTED]]
        every = [current, *(seen.explain(model, current.fit) for model in models)]
        best = max(every, key=lambda each: each.likelihood - _sum(cost, each.fit.model.suspects))
        if best is current:
            break
        current = best
    found = [_described(seen, current, suspect, cost) for suspect in current.fit.model.suspects]
    odds = current.likelihood - _sum(cost, current.fit.model.suspects)
    kept = (each for each in found if each.evidence > DECISIVE)  # a later one may explain an earlier one, too
    return current, tuple(sorted(kept, key=lambda each: -each.evidence)), odds


def none_fits(seen: SeenRotations, explained: Explanation) -> bool:
    """Return whether poses that are wrong each for itself explain the rotations far better than what was found."""
    free = tuple(suspect for suspect in suspects(len(seen.rotations), ()) if suspect.kind == kinds.ONE_POSE)
    if not free:
        return False
    better = float(seen.likelihoods(explained.fit, [free])[0]) - explained.likelihood
    return better > DECISIVE - 2.0 * np.log(ODDS)


def _sum(cost: Mapping[Suspect, float], of: Sequence[Suspect]) -> float:
    return sum(cost[suspect] for suspect in of)


def _described(
    seen: SeenRotations, explained: Explanation, suspect: Suspect, cost: Mapping[Suspect, float]
) -> Found:
    """Return a suspect that was found with its size, and what explains the rotations nearly as well in its place."""
    model = explained.fit.model
    spread = model.of(suspect, model.of(suspect, explained.covariance[6:, 6:]).T)
    value = model.of(suspect, explained.fit.values)
    others = tuple(other for other in model.suspects if other != suspect)
    rivals = [other for other in cost if other.kind != suspect.kind and other not in others]
    sets = [others, *((*others, other) for other in rivals)]
    worth = seen.likelihoods(explained.fit, sets) - [_sum(cost, each) for each in sets]
    best = explained.likelihood - _sum(cost, model.suspects)
    likely: dict[str, float] = {}
    for k in np.argsort(-worth[1:])[:_FITTED] + 1:
        rival = seen.explain(replace(model, suspects=sets[k]), explained.fit)
        kind, own = sets[k][-1].kind, rival.likelihood - _sum(cost, sets[k])
        likely[kind] = max(own, likely.get(kind, -np.inf))
    near = [kind for kind, own in likely.items() if own > best - ALONE]
    beside = sorted(near, key=lambda kind: -likely[kind])
    beside += [kind for kind in _alike(suspect, value, len(seen.rotations)) if kind not in beside]
    length = float(np.linalg.norm(value))
    return Found(
        suspect,
        float(value[0]) if suspect.size == 1 else length,
        float(np.sqrt(value @ spread @ value)) / max(length, 1e-15),
        best - float(worth[0]) + DECISIVE,
        tuple(beside[: kinds.MOST_BESIDE]),
    )


def _alike(suspect: Suspect, value: Array, count: int) -> tuple[str, ...]:
    """Return kinds that turn the camera in the same way as a suspect with these parameters, rad."""
    if suspect.kind == kinds.ONE_POSE and suspect.pose in (0, count - 1):
        return kinds.TURNED, kinds.MOVED  # a step at the end
    if suspect.kind == kinds.MOVED and abs(value[2]) > _ALONG * np.linalg.norm(value):
        return (kinds.HELD,)
    # A camera that sags to one side turns in proportion to tilt, as if pan leant.
    return (kinds.SAGS,) if suspect.kind == kinds.NOT_SQUARE else ()
