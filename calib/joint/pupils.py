"""Where the camera's pupil is in the beam, if the camera is moved by hand: what the visible discs show of it.

The fields by turn follow the pupil. On a gimbal it follows the turn, which is known far better than a disc. If not, the
discs say where it is, and the stars say it better (`calib.joint.places`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array, rms_length
from calib.model.beam import discs_of
from calib.model.rim_fit import Discs
from calib.view import View

#: A pupil that wanders by this share of the radius may be moved by hand; on a gimbal with good discs, by less than a
#: quarter of it. It is moved by hand for certain if it wanders by more than the uncertainty of the discs' differences.
_WANDERS = 0.01
#: Tangent of the turn that brings the pupil aside by the radius: one prior then serves fields by turn and by pupil.
_AS_TURNS = 12.0
#: The mean of the places is held to this, tangents: it does what a common field does.
_SAME = 4e-3


@dataclass(frozen=True)
class Pupils:
    """What the visible discs show of the pupils of n poses, in tangents of a turn that would bring them there."""

    shown: Array  # (n, 2) by the discs
    information: Array  # (2 n, 2 n) of that
    certain: bool  # Whether the discs exclude a gimbal


def discs_of_poses(views: Sequence[View], poses: NDArray[np.int64]) -> Discs | None:
    """Return the visible discs of the poses, None if out of view. Repeats of a pose show the same rim."""
    return discs_of([views[v] for v in np.unique(poses, return_index=True)[1]])


def pupils_of(found: Discs, r_mm: float) -> Pupils | None:
    """Return the pupils if they may wander as on no gimbal, where the turn shows them far better than a disc."""
    of_poses = found.of_views
    middles = np.array([disc.centre_mm for disc in of_poses])
    aside = middles - np.array([disc.expected_mm for disc in of_poses])
    wander = rms_length(aside - aside.mean(axis=0))
    n = len(middles)
    about = np.kron(np.eye(n) - 1.0 / n, np.eye(2))
    differences = about @ found.covariance_mm2 @ about
    sigma = np.sqrt(np.trace(differences) / n)
    if wander < _WANDERS * r_mm:
        return None
    as_turns = _AS_TURNS / r_mm
    covariance = as_turns**2 * differences
    covariance += _SAME**2 * (np.eye(2 * n) - about)
    shown = as_turns * (middles - middles.mean(axis=0))
    return Pupils(shown, np.asarray(np.linalg.inv(covariance)), bool(wander > sigma))
