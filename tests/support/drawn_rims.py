"""Rims of simulated benches, drawn without images: points where the light of each pose ends, and the true discs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.model.rim_fit import Disc, fit_rims
from calib.view import RimPoints
from simulators.optics.collimator_errors import disc_of, relative_radius
from simulators.optics.picture import pose_rotation
from simulators.world.truth import Truth

Array = NDArray[np.float64]

SECTIONS = 86
POINT_SIGMA_MM = 0.05
#: Share of the radius at which pixels stop firing under a square flicker.
DARK_AT = 0.99
_STEP_MM = 0.5
#: Half the width and height of the frame on the target.
HALF_FRAME_MM = np.array([48.8, 27.4])
_NARROW = [(pan, tilt) for pan in (-6.0, 0.0, 6.0) for tilt in (-2.5, 0.0, 2.5)]
_WIDE = [(pan, tilt) for pan in (-12.0, 0.0, 12.0) for tilt in (-8.0, 0.0, 8.0)]
_THREE = [(-6.0, 2.0), (6.0, 2.0), (0.0, -3.0)]
POSES = {"narrow": _NARROW, "wide": _WIDE, "three": _THREE}
"""Pan and tilt of the poses by name, degrees."""


@dataclass(frozen=True)
class DrawnRims:
    """Rims of one bench."""

    rims: list[RimPoints]
    looks_mm: Array  # (V, 2) points of the target at which the camera looks
    discs_mm: Array  # (V, 2) true centres of the discs

    def fitted(self) -> list[Disc]:
        """Return the fitted discs."""
        seen = np.concatenate([np.vstack([rim.points_mm, rim.lit_mm]) for rim in self.rims])
        return fit_rims(self.rims, self.looks_mm, seen).of_views


def framed_rim(
    look: Array,
    disc: Array,
    radius: float,
    waves: Array,
    rng: np.random.Generator,
    sigma: float = POINT_SIGMA_MM,
) -> RimPoints:
    """Return what a frame about ``look`` shows of a disc whose radius varies by (8,) waves: cosines, sines of orders 2 to 5."""
    phi = (np.arange(SECTIONS) + 0.5) * 2 * np.pi / SECTIONS
    orders = phi[:, None] * np.arange(2, 6)
    radii = radius * (1 + np.cos(orders) @ waves[:4] + np.sin(orders) @ waves[4:])
    direction = np.column_stack([np.cos(phi), np.sin(phi)])
    edge = disc + radii[:, None] * direction
    framed = (np.abs(edge - look) < HALF_FRAME_MM).all(axis=1)
    along = np.arange(0.0, 2.2 * radius, _STEP_MM)
    bright = np.full(SECTIONS, -1.0)
    for i in np.flatnonzero(~framed):
        inside = (np.abs(disc + along[:, None] * direction[i] - look) < HALF_FRAME_MM).all(axis=1)
        bright[i] = along[inside & (along < radii[i])].max(initial=-1.0)
    lit = disc + bright[:, None] * direction
    points = edge + rng.normal(0.0, sigma, (SECTIONS, 1)) * direction
    return RimPoints(points[framed], np.full(framed.sum(), sigma), lit[bright > 0], 0.0)


def draw_rims(truth: Truth, poses: Sequence[tuple[float, float]], seed: int) -> DrawnRims:
    """Draw the rims of a bench.

    poses: Pan and tilt, degrees; the roll is 10 degrees.
    """
    rng = np.random.default_rng(seed)
    c = truth.collimator
    rims, looks, discs = [], [], []
    for pan, tilt in poses:
        rotation = pose_rotation({"pan": pan, "tilt": tilt, "roll": 10.0}, truth.optics)
        axis = rotation[2]
        looks.append(np.array([c.x, c.y]) + c.r * axis[:2] / axis[2])
        rims.append(_rim(truth, rotation, rng))
        disc = disc_of(c, rotation)
        discs.append([disc.x, disc.y])
    return DrawnRims(rims, np.array(looks), np.array(discs))


def _rim(truth: Truth, rotation: Array, rng: np.random.Generator) -> RimPoints:
    disc = disc_of(truth.collimator, rotation)
    centre = np.array([disc.x, disc.y])
    phi = (np.arange(SECTIONS) + 0.5) * 2.0 * math.pi / SECTIONS
    radius = DARK_AT * disc.radius * relative_radius(np.cos(phi), np.sin(phi), disc.edge)
    direction = np.column_stack([np.cos(phi), np.sin(phi)])
    noise = rng.normal(0.0, POINT_SIGMA_MM, (SECTIONS, 1))
    framed = _framed(truth, rotation, centre + radius[:, None] * direction)
    points = (centre + (radius[:, None] + noise) * direction)[framed]
    lit = []
    for i in np.flatnonzero(~framed):
        along = np.arange(0.0, radius[i], _STEP_MM)[:, None] * direction[i] + centre
        inside = along[_framed(truth, rotation, along)]
        lit.extend(inside[-1:])
    return RimPoints(points, np.full(len(points), POINT_SIGMA_MM), np.array(lit).reshape(-1, 2), 0.0)


def _framed(truth: Truth, rotation: Array, places_mm: Array) -> NDArray[np.bool_]:
    """Return which points of the target lie in the frame, for a lens without distortion."""
    c = truth.collimator
    rays = np.column_stack([places_mm - [c.x, c.y], np.full(len(places_mm), c.r)]) @ rotation.T
    tangents = np.abs(rays[:, :2] / rays[:, 2:])
    half = np.array([truth.camera.width, truth.camera.height]) / 2.0
    return np.asarray((tangents * truth.camera.fx < half).all(axis=1))
