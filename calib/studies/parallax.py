"""The parallax test: how far the entrance pupil is off the pivot, from how the beam's disc moves on the target.

If the entrance pupil is s in front of the pivot of the gimbal, it moves across the beam by s times the tangent of the
turn, and the disc that the beam lights on the target moves by the opposite amount (the walk), whatever the focus of the
collimator. So the walk measures s. With the collimator's defocus, the parallax follows, an error of the gimbal's
readings that imitates a scale error (`calib.model.gimbal_readings`).

The walk is a common value of the joint fit of all rims (`calib.model.rim_fit.fit_rims`), not the slope of a
line through the single discs. The errors of the discs are not independent: a radius that is too large moves the discs
of opposite turns apart, as a walk does. The sigma of such a line would be too small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import Array
from calib.errors import DegenerateViews, InputMismatch
from calib.model.collimator import Collimator
from calib.model.gimbal_readings import ParallaxBound
from calib.model.rim_fit import fit_rims
from calib.view import View

#: Least number of rim points of a view that shows its rim, and least number of such views.
_FEWEST_POINTS, _FEWEST_VIEWS = 3, 3
#: Largest useful standard uncertainty of the walk, as a share of r; that of the prior is 0.3.
_LARGEST_SIGMA = 0.15
#: The walks along x and y differ significantly from this many standard uncertainties on.
_SIGNIFICANT = 2.5
_AXES = ("x", "y")


@dataclass(frozen=True)
class Parallax:
    """The parallax of a gimbal in front of a collimator that is out of focus."""

    bound: ParallaxBound
    share: float  # Displacement of the pattern per unit tangent of the turn, as a share of r
    share_sigma: float  # Standard uncertainty of the share
    fx_px: float  # Error of fx, px, by the readings of the gimbal if the parallax were neglected
    fx_sigma_px: float  # Standard uncertainty of that error, px


@dataclass(frozen=True)
class PupilWalk:
    """How the disc of the beam moves when the camera turns, and where the entrance pupil is."""

    # (2,) float64, motion of the disc along the target's x and y, mm per unit tangent of the turn.
    walk_mm: Array
    covariance_mm2: Array  # (2, 2) float64, covariance of the walk, mm^2
    # Distance of the entrance pupil in front of the pivot, mm, if x and y have the same pivot
    pupil_off_pivot_mm: float
    # Its standard uncertainty, mm; it covers the walks along x and y if they differ significantly
    sigma_mm: float
    views: int
    without_rim: tuple[str, ...]

    @property
    def walk_sigma_mm(self) -> Array:
        """(2,) float64 standard uncertainties of the walk along x and y, mm per unit tangent."""
        return np.sqrt(np.diag(self.covariance_mm2))

    @property
    def difference_in_sigmas(self) -> float:
        """Difference of the walks along x and y, over its standard uncertainty."""
        return float(abs(np.diff(self.walk_mm)[0]) / _difference_sigma(self.covariance_mm2))

    @property
    def axes_differ(self) -> bool:
        """Whether the walks along x and y differ significantly: pan and tilt then have separate pivots."""
        return self.difference_in_sigmas > _SIGNIFICANT

    @property
    def station_entry(self) -> str:
        """The entry of the station file that states the place of the pupil, as YAML."""
        value, sigma = _rounded(self.pupil_off_pivot_mm, self.sigma_mm)
        return f"gimbal: {{pupil_off_pivot_mm: {{value: {value}, sigma: {sigma}}}}}"

    @property
    def advice(self) -> str:
        """What to write into the station file, as a sentence."""
        return f"To state this, write into the station file: {self.station_entry}"

    def says(self) -> tuple[str, ...]:
        """Describe the result in sentences."""
        x, y = (" +- ".join(_rounded(*both)) for both in zip(self.walk_mm, self.walk_sigma_mm, strict=True))
        off, sigma = _rounded(abs(self.pupil_off_pivot_mm), self.sigma_mm)
        seen = self.views - len(self.without_rim)
        sentence = (
            f"The disc of the beam moves on the target by {x} mm along x and {y} mm along y per unit tangent of the "
            f"turn, with standard uncertainties. The rim is seen in {seen} of {self.views} views."
        )
        side = "in front of" if self.pupil_off_pivot_mm >= 0 else "behind"
        place = f"{off} mm {side} the pivot" if float(off) else "on the pivot"
        if self.axes_differ:
            pivot = (
                f"The walks along x and y differ by {self.difference_in_sigmas:.1f} standard uncertainties, so the "
                f"axes may have separate pivots. The entrance pupil is about {place}; the standard uncertainty, "
                f"{sigma} mm, covers both."
            )
        else:
            pivot = f"If the axes meet in one pivot, the entrance pupil is {place}, standard uncertainty {sigma} mm."
        return sentence, pivot

    def parallax(self, defocus: float, defocus_sigma: float, *, r_mm: float, fx_px: float) -> Parallax:
        """Return the parallax that follows from the collimator's defocus, dimensionless, and its standard uncertainty.

        Product as of `ParallaxBound.mean_and_sigma`. To first order, the error of fx is the opposite share of fx.
        """
        bound = ParallaxBound(defocus, defocus_sigma, self.pupil_off_pivot_mm, self.sigma_mm)
        share, sigma = bound.mean_and_sigma(r_mm)
        return Parallax(bound, share, sigma, -share * fx_px, sigma * fx_px)


def pupil_walk(views: Sequence[View], rotations: Array, collimator: Collimator) -> PupilWalk:
    """Measure how the disc of the beam moves when the camera turns, from rotations camera <- target.

    The walk is the posterior mean of the motion in the joint fit of all rims. Mean of x and y: generalised least
    squares (Aitken, 1935) with weights from 0 to 1. Errors of the rotations and of the collimator's radius change the
    walk by their own share of it only, and are neglected. Views whose images were not searched for the rim take no
    part.
    Raises DegenerateViews: If fewer than three views show the rim, or if the rims do not determine the walk.
    """
    if len(rotations) != len(views):
        raise InputMismatch(f"{len(views)} views, but {len(rotations)} rotations.", where="parallax test")
    without = tuple(v.name for v in views if v.rim is None or len(v.rim.points_mm) < _FEWEST_POINTS)
    seen = len(views) - len(without)
    if seen < _FEWEST_VIEWS:
        raise DegenerateViews(
            f"{seen} of {len(views)} views show the rim of the beam; at least {_FEWEST_VIEWS} are needed.",
            where="parallax test",
            remedy="Turn the camera farther to both sides, until the rim is in view.",
        )
    searched = [
        (view, view.rim, axis[:2] / axis[2])
        for view, axis in zip(views, rotations[:, 2], strict=True)
        if view.rim is not None
    ]
    stars = np.concatenate([view.target_mm for view, _, _ in searched])
    looks = np.array([collimator.x, collimator.y]) + collimator.r * np.array([t for _, _, t in searched])
    motion = fit_rims([rim for _, rim, _ in searched], looks, stars).motion
    own = np.ix_([0, 3], [0, 3])
    walk = collimator.r * np.diag(motion.matrix)
    covariance = collimator.r**2 * motion.covariance[own]
    if (worst := float(np.sqrt(np.diag(covariance).max()))) > _LARGEST_SIGMA * collimator.r:
        raise DegenerateViews(
            f"The rims in view do not determine how the disc moves: standard uncertainty {worst:.2g} mm per unit "
            f"tangent of the turn along {_AXES[int(np.argmax(np.diag(covariance)))]}.",
            where="parallax test",
            remedy="Turn the camera farther to both sides along both axes, until the rim is in view.",
        )
    off, sigma = mean_of_axes(-walk, covariance)
    return PupilWalk(walk, covariance, off, sigma, len(views), without)


def mean_of_axes(off: Array, covariance: Array) -> tuple[float, float]:
    """Return the mean of the (2,) values of x and y, and its 1-sigma; it covers both if they differ significantly.

    The weights give the least variance among those from 0 to 1. Without this limit, strongly correlated errors would
    place the mean beyond both values.
    """
    if abs(np.diff(off)[0]) <= _SIGNIFICANT * _difference_sigma(covariance):
        spread = _difference_sigma(covariance) ** 2
        share = float(np.clip((covariance[1, 1] - covariance[0, 1]) / spread, 0.0, 1.0))
        weights = np.array([share, 1.0 - share])
        return float(weights @ off), float(np.sqrt(weights @ covariance @ weights))
    return float(off.mean()), float(np.hypot(0.5 * np.diff(off)[0], np.sqrt(covariance.mean())))


def _difference_sigma(covariance: Array) -> float:
    """Return the 1-sigma of the difference of two values with a (2, 2) covariance."""
    return float(np.sqrt(np.array([1.0, -1.0]) @ covariance @ [1.0, -1.0]))


def _rounded(value: float, sigma: float) -> tuple[str, str]:
    """Return a value and its sigma with two digits of the sigma (JCGM 100:2008, 7.2.6)."""
    places = max(0, 1 - int(np.floor(np.log10(float(f"{sigma:.1e}")))))
    return f"{round(value, places) + 0.0:.{places}f}", f"{sigma:.{places}f}"
