"""How much each star counts: robust weights, noise at the rim of the beam, own noise of each view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import RAYLEIGH_MEDIAN, Array

from .problem import Problem, Stars

#: Stars beyond this number of sigma lose their weight, with the sixth power of the distance.
_FAR = 3.5
#: At the rim the beam fills the pupil only partly: noise c rho^12 is added, and these c over the usual noise are tried.
#: In the published recordings it is 1.1 times larger at 0.8, 3 times at 0.92, 14 times at 1.05.
_RIM_NOISES = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
#: It counts so many times: it is alike in neighbouring stars and in other poses, and the fields take a part of it.
_RIM_ALIKE = 2.0
#: So many px rho^24 are added always: fields could follow a few stars at the rim, and then no noise is left to see.
#: Where no disc shows the rim, this is no more than as many of the stated px: exact points count up to the last.
_RIM_EDGE_PX = 1.0
#: Beyond the rim nothing more is added.
_BEYOND = 1.05
#: No residual counts as longer than this when c is looked for, sigmas: one gross error would decide.
_LONGEST = 10.0
#: Own noise of a view is the common one's with the weight of so many stars, and its own residuals'.
_ALIKE_STARS = 20.0
#: Stars whose places agree to so many decimals of a millimetre are the same.
_SAME_STAR = 6
#: Smallest spread, in sigmas: points without any noise all count.
_LEAST = 1e-9


@dataclass(frozen=True)
class Weights:
    """Weights of the stars of all views."""

    robust: list[Array]  # For each view (N,), 0 to 1: how far each star counts as an observation
    precision: list[Array]  # For each view (N,) of its noise; 1 is usual
    rim_px: float  # Noise at the rim, times rho^12
    edge_px: float  # The same, times rho^24
    of_views: Array  # (m,) how precise the stars of each view are, over all views'
    shares: Array  # (m,) how much of each view is new: less than 1 for repeats of a pose

    @property
    def whole(self) -> list[Array]:
        """For each view (N,) what a square counts."""
        return [robust * own for robust, own in zip(self.robust, self.precision, strict=True)]

    @property
    def observed(self) -> float:
        """Number of star coordinates, each with its robust weight; the rotation of a repeat is as little new."""
        return 2.0 * sum(float(robust.sum()) for robust in self.robust) + 3.0 * float(
            (1.0 - self.shares).sum()
        )

    @property
    def logarithm(self) -> float:
        """Sum of the logarithms of the precisions of all coordinates."""
        pairs = zip(self.robust, self.precision, strict=True)
        return 2.0 * sum(float(robust @ np.log(own)) for robust, own in pairs)


def spread(residuals: Sequence[Array]) -> float:
    """Return the sigma of the stars over the stated one, from the median length of (N, 2) residuals over sigma."""
    return max(float(np.median(np.hypot(*np.concatenate(list(residuals)).T))) / RAYLEIGH_MEDIAN, _LEAST)


def robust_weights(lengths: Array, limit: float) -> Array:
    """Return the weights of stars: 1 for small residuals, falling smoothly beyond 3.5 sigma."""
    return np.asarray(1.0 / (1.0 + (lengths / (_FAR * limit)) ** 6))


def precisions(stars: Sequence[Stars], weights: Weights) -> list[Array]:
    """Return for each view (N,) the precisions of its stars, by weights that were found."""
    at_rim = _at_rim(stars, weights.rim_px, weights.edge_px)
    return [own * times for own, times in zip(at_rim, weights.of_views.tolist(), strict=True)]


def weights(problem: Problem, residuals: Sequence[Array], limit: float) -> Weights:
    """Return the weights by (N, 2) residuals over sigma; ``limit``: sigma of the stars over the stated one."""
    stars, lengths = problem.stars, [np.linalg.norm(off, axis=1) for off in residuals]
    usual = float(np.median(np.concatenate([star.sigma_px for star in stars])))
    edge_px = _RIM_EDGE_PX / (limit if problem.moved.discs is not None else max(limit, 1.0))

    def cost(c: float) -> float:
        pairs = zip(_at_rim(stars, c * usual, edge_px), lengths, strict=True)
        squares = ((own, np.minimum(own * (length / limit) ** 2, _LONGEST**2)) for own, length in pairs)
        return sum(float((square - 2.0 * np.log(own)).sum()) for own, square in squares)

    rim_px = _RIM_ALIKE * min(_RIM_NOISES, key=cost) * usual
    at_rim = _at_rim(stars, rim_px, edge_px)
    robust = [
        robust_weights(length * np.sqrt(own), limit) for length, own in zip(lengths, at_rim, strict=True)
    ]
    of_views = _own_noise(robust, at_rim, lengths, limit)
    precision = [own * times for own, times in zip(at_rim, of_views.tolist(), strict=True)]
    roots = [np.sqrt(own * times) for own, times in zip(robust, precision, strict=True)]
    shares = _shares(problem, residuals, roots)
    robust = [own * share for own, share in zip(robust, shares.tolist(), strict=True)]
    return Weights(robust, precision, rim_px, edge_px, of_views, shares)


def _shares(problem: Problem, residuals: Sequence[Array], roots: Sequence[Array]) -> Array:
    """Return (m,) the share of each view that is new: 1 / (1 + (n - 1) rho) in a pose of n views.

    rho is the correlation of the residuals of one star in the views of a pose: what no smooth field holds, an error at
    the rim or of finding this star, comes again in each repeat (Kish, 1965, design effect).
    """
    views = np.bincount(problem.poses)
    if (views == 1).all():
        return np.ones(len(problem.poses))
    both, pairs = 0.0, 0.0
    for members in (own for own in problem.members if len(own) > 1):
        places = np.round(np.concatenate([problem.stars[v].mm for v in members]), _SAME_STAR)
        star = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1)
        root = np.concatenate([roots[v] for v in members])
        off = root[:, None] * np.concatenate([residuals[v] for v in members])
        sums = [np.bincount(star, column) for column in (*off.T, root)]
        both += float((sums[0] ** 2 + sums[1] ** 2).sum() - (off**2).sum())
        pairs += float((sums[2] ** 2).sum() - (root**2).sum())
    weighed = zip(roots, residuals, strict=True)
    squares = sum(float(root**2 @ (off**2).sum(axis=1)) for root, off in weighed)
    alike = both * sum(float((root**2).sum()) for root in roots) / max(pairs * squares, _LEAST)
    return np.asarray(1.0 / (1.0 + (views[problem.poses] - 1) * min(max(alike, 0.0), 1.0)))


def _at_rim(stars: Sequence[Stars], rim_px: float, edge_px: float) -> list[Array]:
    """Return for each view (N,) how precise its stars are, 1 in the middle of the beam."""
    precise = []
    for star in stars:
        rho = np.minimum(star.rho, _BEYOND)
        added = (rim_px * rho**12) ** 2 + (edge_px * rho**24) ** 2
        precise.append(1.0 / (1.0 + added / star.sigma_px**2))
    return precise


def _own_noise(
    robust: Sequence[Array], precision: Sequence[Array], lengths: Sequence[Array], limit: float
) -> Array:
    """Return (m,) how precise the stars of each view are, over all views': their level is the stars' amplitude."""
    squares = [
        float((w * own * length**2).sum()) / (2.0 * limit**2)
        for w, own, length in zip(robust, precision, lengths, strict=True)
    ]
    counts = np.array([float(w.sum()) for w in robust])
    own = (_ALIKE_STARS + counts) / (_ALIKE_STARS + np.array(squares))
    level = np.average(np.log(own), weights=[len(length) for length in lengths])
    return np.asarray(own / np.exp(level))
