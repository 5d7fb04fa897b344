"""What the rim of the beam does to the stars: there, the beam fills the camera's pupil only partly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import Array
from calib.joint import amplitudes as amp
from calib.joint.effects.by_turn import TURN_ROW
from calib.joint.effects.collimator import POSE_ROW
from calib.joint.effects.effect import Effect, OwnPart, Places, RandomBlock, Row, Turned
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


@dataclass(frozen=True)
class AroundDiscs:
    """Where N stars lie about the visible discs of their views."""

    from_disc_mm: Array  # (N, 2) from where the disc was found
    radius_mm: Array  # (N,) of the disc
    root_mm: Array  # (N, 2, 2) Cholesky factor of the covariance of its middle

    @classmethod
    def of(cls, target_mm: Array, discs: Sequence[Disc], views: Places) -> AroundDiscs:
        """Return where (N, 2) stars of (N,) views lie about the disc of each view."""
        centres, radii = np.array([disc.centre_mm for disc in discs]), [disc.radius_mm for disc in discs]
        roots = np.linalg.cholesky(np.array([disc.covariance_mm2 for disc in discs]))
        return cls(target_mm - centres[views], np.array(radii)[views], roots[views])

    def displaced(self, middles: Array) -> Array:
        """Return (N, 2, R) displacements, mm; middles: (N, 2) from where the disc was found, in sigmas."""
        from_middle, rho, beyond = self._from_middle(middles)
        return np.asarray(from_middle[:, :, None] * ((rho - _BEND * beyond) ** _POWERS)[:, None])

    def by_middle(self, middles: Array, sizes: Array) -> Array:
        """Return (N, 2, 2) derivatives by the middle of the disc, with (N, R) sizes of the displacements."""
        from_middle, rho, beyond = self._from_middle(middles)
        inside, along = rho - _BEND * beyond, from_middle / (rho * self.radius_mm[:, None])
        steep = (sizes * _POWERS * inside ** (_POWERS - 1)).sum(axis=1) * (rho * np.exp(-beyond))[:, 0]
        slopes = (steep[:, None] * along)[:, :, None] * along[:, None]
        slopes += np.eye(2) * (sizes * inside**_POWERS).sum(axis=1)[:, None, None]
        return np.asarray(-slopes @ self.root_mm)

    def _from_middle(self, middles: Array) -> tuple[Array, Array, Array]:
        """Return (N, 2) stars from the disc's middle, mm; (N, 1) how far, in its radii; (N, 1) how far beyond it."""
        from_middle = self.from_disc_mm - (self.root_mm @ middles[:, :, None])[:, :, 0]
        rho = (np.maximum(np.hypot(*from_middle.T), np.finfo(float).tiny) / self.radius_mm)[:, None]
        return from_middle, rho, np.logaddexp(0.0, (rho - BEYOND) / _BEND)
