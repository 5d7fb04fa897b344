"""What the rim of the beam does to the stars: there, the beam fills the camera's pupil only partly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.effects.by_turn import TURN_ROW
from calib.joint.effects.collimator import POSE_ROW
from calib.joint.effects.effect import Effect, OwnPart, RandomBlock, Row, Turned
from calib.model import result_parts as rows
from calib.model.rim_fit import Disc

#: Displacements rho^4 g and rho^10 g from the middle of a view's visible disc: g in units of r, rho in radii of it.
_NAMES, _POWERS = ("rim_4", "rim_10"), np.array([4, 10])
NUMBER = len(_NAMES)
#: rim_10 is typically this share of rim_4.
_RATIO = 0.3
#: They differ from pose to pose by these shares of the amplitude of rim_4.
_OWN = 0.2 * np.array([1.0, _RATIO])
#: Stars outside of the visible disc are displaced as those at so many of its radii; the change is so wide.
BEYOND, _BEND = 1.05, 0.02
_NOTHING = 1e-30


class Rim(Effect):
    """Displacements about the visible disc of each view, whose middle is known only so well."""

    names = _NAMES

    def fill(self, columns: Array, poses: Turned) -> None:
        columns[:, self.pose.rim] = np.eye(NUMBER)

    def priors(self) -> Sequence[RandomBlock]:
        return [RandomBlock(TURN_ROW, _NAMES, ((amp.RIM, np.diag([1.0, _RATIO])),))]

    def own(self) -> Sequence[OwnPart]:
        at = np.arange(self.pose.size)
        discs = Row(rows.PUPILS, "A", "visible discs")
        return [
            OwnPart(POSE_ROW, at[self.pose.rim], NUMBER * (amp.RIM,), _OWN**-2),
            OwnPart(discs, at[self.pose.middle], 2 * (amp.DISCS,), np.ones(2)),
        ]


def about_disc(disc: Disc, target_mm: Array, middle: Array) -> Array:
    """Return (N, 2, R) displacements of (N, 2) stars, mm; middle: (2,) from where the disc was found, in sigmas."""
    from_middle, rho, beyond = _from_middle(disc, target_mm, middle)
    return np.asarray(from_middle[:, :, None] * ((rho - _BEND * beyond) ** _POWERS)[:, None])


def by_middle(disc: Disc, target_mm: Array, middle: Array) -> Array:
    """Return (N, 2, R, 2) derivatives of `about_disc` by the middle of the disc."""
    from_middle, rho, beyond = _from_middle(disc, target_mm, middle)
    inside, along = rho - _BEND * beyond, from_middle / (rho * disc.radius_mm)
    steep = _POWERS * inside ** (_POWERS - 1) * np.exp(-beyond)
    slopes = np.einsum("na,nb,nr->narb", along, along, rho * steep)
    slopes += np.eye(2)[:, None] * (inside**_POWERS)[:, None, :, None]
    return np.asarray(-slopes @ np.linalg.cholesky(disc.covariance_mm2))


def _from_middle(disc: Disc, target_mm: Array, middle: Array) -> tuple[Array, Array, Array]:
    """Return (N, 2) stars from the disc's middle, mm; (N, 1) how far, in its radii; (N, 1) how far beyond it."""
    from_middle = target_mm - disc.centre_mm - np.linalg.cholesky(disc.covariance_mm2) @ middle
    rho = np.maximum(np.hypot(*from_middle.T), _NOTHING)[:, None] / disc.radius_mm
    return from_middle, rho, np.logaddexp(0.0, (rho - BEYOND) / _BEND)
