"""Rims of discs, drawn without images: points where the light of a pose ends."""

import numpy as np
from numpy.typing import NDArray

from calib.view import RimPoints

Array = NDArray[np.float64]

SECTIONS = 86
POINT_SIGMA_MM = 0.05
_STEP_MM = 0.5
#: Half the width and height of the frame on the target.
HALF_FRAME_MM = np.array([48.8, 27.4])


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
