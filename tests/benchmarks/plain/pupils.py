"""Where the camera's pupil is in the beam: how it is moved, how far, and what the visible discs show of its places."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from calib.arrays import Array
from calib.model.gimbal_readings import ParallaxBound
from calib.model.rim_fit import Disc, Discs

from .amplitudes import LEVER, UNIT_TURN, Lever

#: Tangent of the turn that brings the pupil aside by the radius, if a hand moves it: one prior then serves fields that
#: follow a turn and those that follow a pupil.
_AS_TURNS = 12.0
#: Grid of the posterior of how far a pupil moves, in 1-sigma of its logarithm.
_LEVERS = np.linspace(-3.0, 3.0, 61)
#: Turns whose tangent is smaller say nothing of how a pupil moves.
_NO_TURN = 1e-3
#: The mean of the places is held to this, tangents: it does what a common field does.
_SAME = 4e-3
#: Displacements rho^4 g and rho^10 g from the middle of a view's visible disc: g in units of r, rho in radii of it.
_POWERS = np.array([4, 10])
#: Stars outside of the visible disc are displaced as those at so many of its radii; the change is so wide.
_BEYOND, _BEND = 1.05, 0.02
_NOTHING = 1e-30


class Pupil(Enum):
    """How the camera's pupil is moved through the beam."""

    HELD = (
        "the parallax is bounded, or no disc is visible: the pupil follows the turn, and stays near its pivot"
    )
    WALKS = "visible discs count, and the pupil follows the turn"
    BY_HAND = "visible discs count, and the pupil wanders: they show where it is"


@dataclass(frozen=True)
class Moved:
    """How the pupil of a bench is moved."""

    pupil: Pupil = Pupil.HELD
    discs: Discs | None = None  # Of the poses

    @property
    def by_hand(self) -> bool:
        """Whether the places of the pupil are unknowns."""
        return self.pupil is Pupil.BY_HAND

    @property
    def of_poses(self) -> list[Disc]:
        """The discs, if displacements about them count."""
        return [] if self.discs is None or self.pupil is Pupil.HELD else self.discs.of_views

    @property
    def turn_degrees(self) -> tuple[int, int]:
        """Highest degrees of the fields by turn and by turn squared.

        A pupil that is moved through the beam by 10 mm sees all that the glass has. They are the same for a gimbal and
        a hand: else their odds would be those of the degrees.
        """
        return (4, 3) if self.pupil is Pupil.HELD else (5, 4)

    def lever(self, tangents: Array, r_mm: float, bound: ParallaxBound | None) -> Lever:
        """Return how far the pupil moves across the beam, as stated, or as the discs show. tangents: (n, 2)."""
        if self.by_hand:
            return Lever(1.0 / _AS_TURNS, 0.0)
        if bound is not None:
            off = np.hypot(bound.pupil_off_pivot_mm, bound.pupil_off_pivot_sigma_mm) / r_mm
            return Lever(float(np.hypot(off, LEVER)), 0.0)
        if not self.of_poses or len(tangents) < 2 or self.discs is None:
            return Lever()
        return _seen_lever(self.discs, tangents, r_mm)

    def places(self, r_mm: float) -> Places:
        """Return the places of a pupil that a hand moves."""
        assert self.discs is not None
        middles, differences = _about_their_mean(self.discs)
        n = len(middles)
        same = (_SAME * r_mm / _AS_TURNS) ** 2 * np.kron(np.full((n, n), 1.0 / n), np.eye(2))
        root = np.linalg.cholesky(differences + same).reshape(n, 2, 2 * n)
        per_mm = _AS_TURNS / (r_mm * UNIT_TURN)
        return Places(per_mm * middles, per_mm, np.asarray(root, np.float64))


@dataclass(frozen=True)
class Places:
    """What the discs show of the places of the pupils of n poses."""

    shown: Array  # (n, 2) in units of `UNIT_TURN`
    per_mm: float  # Of these units by the middle of the disc
    root: Array  # (n, 2, 2 n) errors of the middles, mm, for unit unknowns


def shown_way(discs: Discs | None) -> Pupil:
    """Return how the pupil is more probably moved, by the discs alone."""
    if discs is None:
        return Pupil.HELD
    return Pupil.BY_HAND if discs.wander > 0.0 and len(discs.of_views) > 1 else Pupil.WALKS


def _seen_lever(discs: Discs, tangents: Array, r_mm: float) -> Lever:
    """Return how far the discs move along X as the turn along X says, and along Y as that along Y, with their errors.

    The logarithm of the size is Gaussian beforehand.
    """
    middles, differences = _about_their_mean(discs)
    turned = tangents - tangents.mean(axis=0)
    turned /= np.maximum((turned**2).sum(axis=0), _NO_TURN**2)
    along = np.einsum("na,ab->anb", turned, np.eye(2)).reshape(2, -1) / r_mm
    ways, unseen = (
        along @ middles.reshape(-1),
        np.diag(np.where(np.ptp(tangents, axis=0) < _NO_TURN, 1.0, 0.0)),
    )
    logs = np.log(LEVER) + _LEVERS * Lever().spread
    variances = along @ differences @ along.T + unseen + np.exp(2.0 * logs)[:, None, None] * np.eye(2)
    fit = np.einsum("a,gab,b->g", ways, np.linalg.inv(variances), ways)
    density = -0.5 * (_LEVERS**2 + fit + np.linalg.slogdet(variances)[1])
    weights = np.exp(density - density.max())
    mean = np.average(logs, weights=weights)
    return Lever(float(np.exp(mean)), float(np.sqrt(np.average((logs - mean) ** 2, weights=weights))))


def _about_their_mean(discs: Discs) -> tuple[Array, Array]:
    """Return the (n, 2) middles of discs about their mean, mm, and their covariance."""
    middles = np.array([disc.centre_mm for disc in discs.of_views])
    n = len(middles)
    about = np.kron(np.eye(n) - 1.0 / n, np.eye(2))
    return middles - middles.mean(axis=0), about @ discs.covariance_mm2 @ about


def about_disc(disc: Disc, mm: Array, moved_mm: Array) -> Array:
    """Return (N, 2, 2) displacements, mm, of (N, 2) stars by the terms at the rim; (2,): how its middle moved."""
    from_middle, rho, beyond = _from_middle(disc, mm, moved_mm)
    return np.asarray(from_middle[:, :, None] * ((rho - _BEND * beyond) ** _POWERS)[:, None])


def by_middle(disc: Disc, mm: Array, moved_mm: Array, sizes: Array) -> Array:
    """Return (N, 2, 2) derivatives of `about_disc`, times (2,) sizes, by the middle of the disc."""
    from_middle, rho, beyond = _from_middle(disc, mm, moved_mm)
    inside, along = rho - _BEND * beyond, from_middle / (rho * disc.radius_mm)
    steep = (_POWERS * inside ** (_POWERS - 1) * np.exp(-beyond)) @ sizes
    flat = (inside**_POWERS) @ sizes
    return np.asarray(
        -along[:, :, None] * along[:, None, :] * (rho[:, 0] * steep)[:, None, None]
        - flat[:, None, None] * np.eye(2)
    )


def _from_middle(disc: Disc, mm: Array, moved_mm: Array) -> tuple[Array, Array, Array]:
    """Return (N, 2) stars from the disc's middle, mm; (N, 1) how far, in its radii; (N, 1) how far beyond it."""
    from_middle = mm - disc.centre_mm - moved_mm
    rho = np.maximum(np.hypot(*from_middle.T), _NOTHING)[:, None] / disc.radius_mm
    return from_middle, rho, np.logaddexp(0.0, (rho - _BEYOND) / _BEND)
