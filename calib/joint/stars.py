"""The stars of all views in common arrays, and the weight of each star."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array
from calib.diagnosis.gross_stars import noise_px
from calib.joint.amplitudes import FINEST_PX
from calib.joint.effects.rim import BEYOND, AroundDiscs
from calib.joint.fields import FieldBasis
from calib.model.rim_fit import Disc
from calib.view import View

#: Near the rim the noise of the stars is sqrt(1 + (c rho^12)^2) times larger, rho in radii of the disc. In the
#: published recordings it is 1.1 times larger at 0.8, 3 times at 0.92, 14 times at 1.05. These c are tried.
_RIM_NOISE_POWER = 12
_RIM_NOISES = np.concatenate([[0.0], np.geomspace(0.25, 32.0, 15)])
#: The noise at the rim counts so many times: it is alike in neighbouring stars and in other poses, and the smooth
#: fields take a part of it. Left-out poses of the published recordings are predicted a seventh better than with 1.
_RIM_ALIKE = 2.0
#: So many px rho^24 are added to it always. The fields can take the displacements of a few stars that all poses see at
#: the rim, and then no noise would be left to see: on the shipped station, cx was wrong by up to 3 sigma.
_RIM_EDGE_PX = 1.0
#: No residual counts as longer than this when c is looked for, sigmas of its noise: one gross error would decide.
_LONGEST = 10.0
#: Stars beyond this number of sigma lose their weight, with the sixth power of the distance.
_LIMIT_SIGMAS = 3.5
#: Smallest median length of the residuals, sigmas: points without any noise all count.
_LEAST_LENGTH = 1e-9
#: Median length of a residual of two components over their sigma.
_RAYLEIGH_MEDIAN = 1.1774


@dataclass(frozen=True)
class RimNoise:
    """Noise at the rim of the disc, in the px in which the noise of the stars is stated."""

    wide_px: float = 0.0  # Times rho^12
    edge_px: float = 0.0  # Times rho^24


@dataclass(frozen=True)
class Stars:
    """What does not change of the N stars of m views."""

    rows: tuple[slice, ...]  # Of each view
    views: NDArray[np.int64]  # (N,) view of each star
    target_mm: Array  # (N, 2)
    points_px: Array  # (N, 2)
    whitening: Array  # (2, 2, N) W with W^T W the inverse covariance
    polynomials: Array  # (N, K)
    sigma_px: Array  # (N,) stated noise of each star: its covariance's geometric mean
    discs: tuple[Disc, ...]  # Visible disc of each view, if the rim is in view
    given: tuple[View, ...]

    @classmethod
    def of(cls, views: Sequence[View], basis: FieldBasis, discs: Sequence[Disc] = ()) -> Stars:
        """Return the stars of views."""
        counts = [len(view) for view in views]
        ends = np.cumsum(counts).tolist()
        target_mm = np.concatenate([view.target_mm for view in views])
        whitening = np.linalg.inv(
            np.linalg.cholesky(np.concatenate([view.covariances_px2 for view in views]))
        )
        return cls(
            tuple(slice(end - count, end) for end, count in zip(ends, counts, strict=True)),
            np.repeat(np.arange(len(views)), counts),
            target_mm,
            np.concatenate([view.points_px for view in views]),
            np.ascontiguousarray(whitening.transpose(1, 2, 0)),
            basis.polynomials(target_mm),
            np.linalg.det(whitening) ** -0.5,
            tuple(discs),
            tuple(views),
        )

    @cached_property
    def local(self) -> float:
        """1-sigma that neighbouring stars show, over the stated one; NaN if views have few stars."""
        shown = [max(noise_px(view), FINEST_PX) / _usual_sigma_px(view) for view in self.given]
        return float(np.median(shown))

    def moved(self, shifts_mm: Array, basis: FieldBasis) -> Stars:
        """Return the stars with (m, 2) shifts of the views on the target; the discs go with them."""
        target_mm = self.target_mm + shifts_mm[self.views]
        discs = [
            replace(disc, centre_mm=disc.centre_mm + shift)
            for disc, shift in zip(self.discs, shifts_mm, strict=False)
        ]
        return replace(
            self, target_mm=target_mm, polynomials=basis.polynomials(target_mm), discs=tuple(discs)
        )

    def of_views(self, values: Array) -> list[Array]:
        """Return values (N, ...) of all stars for each view."""
        return [values[rows] for rows in self.rows]

    @cached_property
    def usual_sigma_px(self) -> float:
        """Median stated noise."""
        return float(np.median(self.sigma_px))

    @cached_property
    def around_discs(self) -> AroundDiscs:
        """Where the stars lie about the visible discs of their views."""
        return AroundDiscs.of(self.target_mm, self.discs, self.views)

    @cached_property
    def _at_rim(self) -> Array:
        """(N,) rho^12: rho is how far a star is from the middle of the disc, in its radii. 0 if no disc is visible."""
        if not self.discs:
            return np.zeros(len(self.views))
        around = self.around_discs
        rho = np.hypot(*around.from_disc_mm.T) / around.radius_mm
        return np.asarray(np.minimum(rho, BEYOND) ** _RIM_NOISE_POWER)

    def precision(self, rim: RimNoise) -> Array:
        """Return (N,) how precise stars are, 1 in the disc's middle."""
        added = (rim.wide_px * self._at_rim) ** 2 + (rim.edge_px * self._at_rim**2) ** 2
        return np.asarray(1.0 / (1.0 + added / self.sigma_px**2))

    def rim_noise(self, lengths: Array) -> RimNoise:
        """Return `_RIM_ALIKE` times the most probable noise at the rim of the visible discs; none without discs."""
        if not self.discs:
            return RimNoise()
        spread = robust_sigma(lengths)
        scaled = (lengths / spread) ** 2
        costs, edge_px, usual = [], _RIM_EDGE_PX / spread, self.usual_sigma_px
        for size in usual * _RIM_NOISES:
            own = self.precision(RimNoise(size, edge_px))
            costs.append(float(np.minimum(own * scaled, _LONGEST**2).sum()) - 2.0 * float(np.log(own).sum()))
        return RimNoise(_RIM_ALIKE * usual * float(_RIM_NOISES[np.argmin(costs)]), edge_px)


def _usual_sigma_px(view: View) -> float:
    """Return the stated noise of a view's median star, per axis."""
    return float(np.sqrt(0.5 * np.median(np.trace(view.covariances_px2, axis1=1, axis2=2))))


def robust_weights(lengths: Array, limit: float) -> Array:
    """Return the weights of stars: 1 for small residuals, falling smoothly beyond 3.5 sigma."""
    return np.asarray(1.0 / (1.0 + (lengths / (_LIMIT_SIGMAS * limit)) ** 6))


def robust_sigma(lengths: Array) -> float:
    """Return the sigma of the stars over the stated one, from the median length of their residuals."""
    return max(float(np.median(lengths)), _LEAST_LENGTH) / _RAYLEIGH_MEDIAN
