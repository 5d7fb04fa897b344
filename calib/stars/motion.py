"""How far the stars moved during a recording: their centres in the images of its two halves.

A shift of whole images by Lucas and Kanade (1981) is a tenth too small here, also when it is iterated: a pixel of an
event image has fired or not, so the edges of the stars are steps on the pixel grid, which no interpolation follows.
"""

from __future__ import annotations

import numpy as np

from calib.arrays import AnyArray, Array, selected
from calib.errors import TooFewStars
from calib.stars.centring import SYMMETRY_REACH, refine_by_symmetry, smooth, symmetry_samples
from calib.stars.detect import BLUR_PX, COARSE_STEP_PX, MIN_FOR_LIKELIHOOD, OPEN_STRIP_PX
from calib.stars.edge_pixels import quantise
from calib.stars.grid_map import fit_grid_map
from calib.stars.likelihood import refine_by_likelihood
from calib.stars.printed_star import cell_reach, open_sides
from calib.target import StarTarget
from calib.view import View

#: Least number of stars that both halves must show: the median of eight bears three wrong ones.
MIN_COMMON = 8
#: Most stars that are located in the halves: the median of fifty is right to .005 px, and time grows with their number.
MOST_STARS = 100
#: Largest distance of a star in one half from its place in the whole recording, pitches. Further away its neighbour's
#: cell would take part.
MAX_SHIFT_PITCHES = 0.25


def shift_between_halves(
    first: AnyArray, second: AnyArray, view: View, target: StarTarget, *, edge_width_px: float | None = None
) -> Array:
    """Return the median shift, (2,) px, of the stars of a view between the images, (H, W), of its recording's halves.

    It is right to .01 px for shifts up to 1 px (`tests/validation/test_star_motion.py`). The stars are located by
    symmetry, which bears a start that is off, and then by likelihood: in a half of one period, symmetry alone is a
    fifth too short. ``edge_width_px`` is that of the whole recording, if it is known: a half need not look for its own.
    Raises TooFewStars if fewer than `MIN_COMMON` stars are found in both.
    """
    some = slice(None, None, -(-len(view.ids) // MOST_STARS))
    nodes, points = target.node_of(view.ids), view.points_px[some]
    grid_map, _ = fit_grid_map(nodes.astype(float), view.points_px)
    nodes = nodes[some]
    local_map = grid_map.local_map(nodes.astype(float))
    pitch, sides = local_map.pitch_px, open_sides(target, nodes)
    samples = symmetry_samples(pitch / COARSE_STEP_PX)
    used_to = cell_reach(sides, SYMMETRY_REACH, OPEN_STRIP_PX / pitch)
    images = [np.nan_to_num(np.asarray(half, np.float32)) for half in (first, second)]
    reach_px = MAX_SHIFT_PITCHES * pitch
    near = [
        refine_by_symmetry(smooth(image, BLUR_PX), points, local_map, samples, used_to, reach_px)
        for image in images
    ]
    common = near[0].converged & near[1].converged
    if np.count_nonzero(common) < MIN_COMMON:
        raise TooFewStars(
            f"The halves of the recording share {np.count_nonzero(common)} stars; {MIN_COMMON} are needed.",
            where=f"view {view.name}",
            remedy="Record for longer.",
        )
    before, after = (fit.centres[common] for fit in near)
    if np.count_nonzero(common) >= MIN_FOR_LIKELIHOOD:
        maps = selected(local_map, common)
        before, after = (
            refine_by_likelihood(
                quantise(image), centres, maps, target, sides[common], blur_px=edge_width_px
            ).centres
            for image, centres in zip(images, (before, after), strict=True)
        )
    return np.asarray(np.nanmedian(after - before, axis=0))
