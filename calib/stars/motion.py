"""How far the stars moved during a recording: their centres by symmetry in the images of its two halves.

A shift of whole images by Lucas and Kanade (1981) is a tenth too small here, also when it is iterated: a pixel of an
event image has fired or not, so the edges of the stars are steps on the pixel grid, which no interpolation follows.
"""

from __future__ import annotations

import numpy as np

from calib.arrays import AnyArray, Array, Bools
from calib.errors import TooFewStars
from calib.stars.centring import SYMMETRY_REACH, refine_by_symmetry, smooth, symmetry_samples
from calib.stars.detect import BLUR_PX, COARSE_STEP_PX, OPEN_STRIP_PX
from calib.stars.grid_map import fit_grid_map
from calib.stars.printed_star import cell_reach, open_sides
from calib.target import StarTarget
from calib.view import View

#: Least number of stars that both halves must show: the median of eight bears three wrong ones.
MIN_COMMON = 8
#: Largest distance of a star in one half from its place in the whole recording, pitches. Further away its neighbour's
#: cell would take part.
MAX_SHIFT_PITCHES = 0.25


def shift_between_halves(first: AnyArray, second: AnyArray, view: View, target: StarTarget) -> Array:
    """Return the median shift, (2,) px, of the stars of a view between the images, (H, W), of its recording's halves.

    It is right to .01 px for shifts up to 1 px (`tests/validation/test_star_motion.py`). Raises TooFewStars if fewer
    than `MIN_COMMON` stars are found in both.
    """
    nodes = target.node_of(view.ids)
    grid = nodes.astype(float)
    local_map = fit_grid_map(grid, view.points_px)[0].local_map(grid)
    pitch = local_map.pitch_px
    samples = symmetry_samples(pitch / COARSE_STEP_PX)
    used_to = cell_reach(open_sides(target, nodes), SYMMETRY_REACH, OPEN_STRIP_PX / pitch)

    def centres(half: AnyArray) -> tuple[Array, Bools]:
        image = smooth(np.nan_to_num(np.asarray(half, np.float32)), BLUR_PX)
        fit = refine_by_symmetry(
            image, view.points_px, local_map, samples, used_to, MAX_SHIFT_PITCHES * pitch
        )
        return fit.centres, fit.converged

    (before, seen_before), (after, seen_after) = centres(first), centres(second)
    common = seen_before & seen_after
    if np.count_nonzero(common) < MIN_COMMON:
        raise TooFewStars(
            f"The halves of the recording share {np.count_nonzero(common)} stars; {MIN_COMMON} are needed.",
            where=f"view {view.name}",
            remedy="Record for longer.",
        )
    return np.asarray(np.median((after - before)[common], axis=0))
