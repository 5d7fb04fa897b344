"""Where the camera's pupil looks through the beam: along with the turn, and aside of it on a mount moved by hand.

The middle of a view's visible disc is what is known of it. Discs that the image cuts off are known badly, so each
middle is estimated from all discs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.model.beam import Disc

Array = NDArray[np.float64]

#: The middle of all discs about the mean of what is seen, and its walk with the tangent of a turn, mm (1-sigma).
_MIDDLE_MM, _WALK_MM = 100.0, 60.0
#: How far the pupil wanders from pose to pose aside of the turn, mm: the median, and 1-sigma of the logarithm.
_WANDER_MM, _WANDER_WIDTH = 3.0, 1.0
#: Discs are known so many times worse than their fit says: the edge of the beam is no circle.
_EDGE = 1.5
#: Tangent of the turn that brings the pupil aside by the radius: one prior then serves fields by turn and by pupil.
_AS_TURNS = 3.0
_GRID_MM = np.geomspace(0.03, 30.0, 25)


@dataclass(frozen=True)
class Pupils:
    """Estimated middles of the visible discs."""

    middles: Array  # (n, 2) of the poses, mm
    wander_mm: float  # RMS of their part that does not follow the turn

    def as_turns(self, r_mm: float) -> Array:
        """Return (n, 2) the places of the pupils, in tangents of the turns that would bring them there."""
        return np.asarray(_AS_TURNS * (self.middles - self.middles.mean(axis=0)) / r_mm)


def estimated(discs: Sequence[Disc], poses: NDArray[np.int64], turns: Array) -> Pupils:
    """Return the middles of the discs: a shared middle, a walk along the turn, a wander from pose to pose.

    A linear model with two variance components; that of the wander is integrated over a grid.

    discs: With their covariances. poses: (m,) pose of each disc; the discs of a pose count as one, because they are cut
    off alike. turns: (n, 2) tangents of the poses' turns.
    """
    n = len(turns)
    seen, noise = _poses_discs(discs, poses, n)
    line = np.zeros((2 * n, 4))  # the middle, and the walk of each coordinate with its turn
    line[0::2, [0, 2]] = np.column_stack([np.ones(n), turns[:, 0]])
    line[1::2, [1, 3]] = np.column_stack([np.ones(n), turns[:, 1]])
    walked = line @ np.diag(np.repeat([_MIDDLE_MM**2, _WALK_MM**2], 2)) @ line.T
    off = (seen - seen.mean(axis=0)).reshape(-1)
    values, walks, wanders = [], [], []
    for size in _GRID_MM:
        covariance = walked + noise + size**2 * np.eye(2 * n)
        left = np.linalg.solve(covariance, off)
        width = np.log(size / _WANDER_MM) / _WANDER_WIDTH
        values.append(off @ left + np.linalg.slogdet(covariance)[1] + width**2)
        walks.append(walked @ left)
        wanders.append(size**2 * left)
    weights = np.exp(-0.5 * (np.array(values) - min(values)))
    weights /= weights.sum()
    walk, wander = (weights @ np.array(part) for part in (walks, wanders))
    wander = wander.reshape(n, 2)
    aside = wander - wander.mean(axis=0)
    middles = seen.mean(axis=0) + walk.reshape(n, 2) + wander
    return Pupils(middles, float(np.sqrt((aside**2).sum(axis=1).mean())))


def _poses_discs(discs: Sequence[Disc], poses: NDArray[np.int64], n: int) -> tuple[Array, Array]:
    """Return (n, 2) the middle of each pose's discs, mm, and their (2n, 2n) covariance, mm²."""
    middles = np.array([disc.centre_mm for disc in discs])
    covariances = np.array([disc.covariance_mm2 for disc in discs], np.float64)
    noise = np.zeros((2 * n, 2 * n))
    for pose in range(n):
        own = slice(2 * pose, 2 * pose + 2)
        noise[own, own] = _EDGE**2 * covariances[poses == pose].mean(axis=0)
    return np.array([middles[poses == pose].mean(axis=0) for pose in range(n)]), noise
