"""Where the camera's pupil is in the beam, if the camera is moved by hand: what the visible discs show of it.

The fields by turn follow the pupil. On a gimbal it follows the turn, which is known far better than a disc. If not, the
discs say where it is, and the stars say it better (`calib.joint.places`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array
from calib.joint.amplitudes import LEVER, Lever, Pupil
from calib.model.gimbal_readings import ParallaxBound
from calib.model.rim_fit import Discs

#: Tangent of the turn that brings the pupil aside by the radius: one prior then serves fields by turn and by pupil.
_AS_TURNS = 12.0
#: How far the pupil moves if a hand moves the camera.
LEVER_BY_HAND = Lever(1.0 / _AS_TURNS, 0.0)
#: 1-sigma of its logarithm beforehand, and the grid of its posterior in these: a pupil 3 to 20 mm before the pivot.
_LEVER_SPREAD, _LEVERS = 1.0, np.linspace(-3.0, 3.0, 61)
#: Turns whose tangent is smaller say nothing of how a pupil moves.
_NO_TURN = 1e-3
#: The mean of the places is held to this, tangents: it does what a common field does.
_SAME = 4e-3


@dataclass(frozen=True)
class Pupils:
    """What the visible discs show of the pupils of n poses, in tangents of a turn that would bring them there."""

    shown: Array  # (n, 2) by the discs
    information: Array  # (2 n, 2 n) of that
    r_mm: float  # Radius by which lengths on the target are these tangents

    def moved(self, shifts_mm: Array) -> Pupils:
        """Return the pupils if the discs are shifted by (n, 2) on the target."""
        about_mean = shifts_mm - shifts_mm.mean(axis=0)
        return replace(self, shown=self.shown + _AS_TURNS / self.r_mm * about_mean)


def shown_way(discs: Discs) -> Pupil:
    """Return how the pupil is more probably moved, by the discs alone."""
    return Pupil.BY_HAND if discs.wander > 0.0 and len(discs.of_views) > 1 else Pupil.WALKS


def lever_of(discs: Discs | None, turns: Array, r_mm: float, bound: ParallaxBound | None = None) -> Lever:
    """Return how far the pupil of a gimbal moves across the beam, as stated or as the discs show. turns: (n, 2).

    A stated distance from the pivot adds to what is expected. If none is stated, the logarithm of the size is Gaussian
    beforehand. The posterior counts how far the discs move along X as the turn along X says, and along Y as that along
    Y, with their covariance.
    """
    if bound is not None:
        off = np.hypot(bound.pupil_off_pivot_mm, bound.pupil_off_pivot_sigma_mm) / r_mm
        return Lever(float(np.hypot(off, LEVER)), 0.0)
    if discs is None or len(turns) < 2:
        return Lever(LEVER, _LEVER_SPREAD)
    middles, differences = _about_their_mean(discs)
    along = _along(turns) / r_mm
    ways, unseen = along @ middles.reshape(-1), np.diag(np.where(np.ptp(turns, axis=0) < _NO_TURN, 1.0, 0.0))
    logs = np.log(LEVER) + _LEVERS * _LEVER_SPREAD
    variances = along @ differences @ along.T + unseen + np.exp(2.0 * logs)[:, None, None] * np.eye(2)
    fit = np.einsum("a,gab,b->g", ways, np.linalg.inv(variances), ways)
    density = -0.5 * (_LEVERS**2 + fit + np.linalg.slogdet(variances)[1])
    weights = np.exp(density - density.max())
    mean = np.average(logs, weights=weights)
    return Lever(float(np.exp(mean)), float(np.sqrt(np.average((logs - mean) ** 2, weights=weights))))


def _along(turns: Array) -> Array:
    """Return the (2, 2 n) estimator of how far discs move along X by the turn along X, and along Y by that along Y."""
    turned = turns - turns.mean(axis=0)
    turned /= np.maximum((turned**2).sum(axis=0), _NO_TURN**2)
    return np.einsum("na,ab->anb", turned, np.eye(2)).reshape(2, -1)


def _about_their_mean(discs: Discs) -> tuple[Array, Array]:
    """Return the (n, 2) middles of discs about their mean, mm, and their covariance."""
    middles = np.array([disc.centre_mm for disc in discs.of_views])
    n = len(middles)
    about = np.kron(np.eye(n) - 1.0 / n, np.eye(2))
    return middles - middles.mean(axis=0), about @ discs.covariance_mm2 @ about


def pupils_of(discs: Discs, r_mm: float) -> Pupils:
    """Return the pupils of a mount that is moved by hand."""
    middles, differences = _about_their_mean(discs)
    n, as_turns = len(middles), _AS_TURNS / r_mm
    covariance = as_turns**2 * differences
    covariance += _SAME**2 * np.kron(np.full((n, n), 1.0 / n), np.eye(2))
    return Pupils(as_turns * middles, np.asarray(np.linalg.inv(covariance)), r_mm)
