"""Stars beside something other than stars: which sides of their cell the print ends at, and how much of it is used.

Next to the tag, and at the border of the pattern, a star has no neighbour on one side, but plain paper. Between two
stars, black meets white all along the border of their cells; towards plain paper it does not. So light from a bright
neighbour, or a bright paper, reaches into the cell on one side only. In an image that is black and white at a low share
of the light, this moves the star by 0.03 px towards dark paper, as a negative print has it. So the strip of the cell
next to the paper is left out, and the strip on the opposite side too, so that what is left is point symmetric. The
module uses the target alone, no image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.target import StarTarget

#: Least half side of the part of a cell that is used, pitches, however wide the blur is.
MIN_REACH = 0.25


def open_sides(target: StarTarget, nodes: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return (N, 2) whether stars lack a printed neighbour to the left or right, and above or below.

    A star that touches the plain paper with one corner counts as open along the columns: the strips on its left and on
    its right hold all its corners. Own rule. A node without a star counts as not open.
    """
    columns, rows = nodes[:, 0], nodes[:, 1]

    def missing(across: int, down: int) -> NDArray[np.bool_]:
        return np.asarray(target.id_at(columns + across, rows + down) < 0)

    beside, above = missing(-1, 0) | missing(1, 0), missing(0, -1) | missing(0, 1)
    corner = missing(-1, -1) | missing(1, -1) | missing(-1, 1) | missing(1, 1)
    found = np.column_stack([beside | (corner & ~above), above])
    return found & (target.id_at(columns, rows) >= 0)[:, None]


def cell_reach(is_open: NDArray[np.bool_], reach: float, strip: float) -> NDArray[np.float64]:
    """Return (N, 2) how far from its centre a star's cell is used, pitches; ``reach`` is half the side between stars.

    Examples
    --------
    >>> cell_reach(np.array([[False, True]]), 0.49, 0.1).round(2).tolist()
    [[0.49, 0.39]]
    """
    return np.where(is_open, max(reach - strip, MIN_REACH), reach)
