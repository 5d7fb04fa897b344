"""What placements of a board show together: which part of the image, which tilts; and where the board is needed next.

A planar calibration is determined by boards over the whole image (distortion) and by tilts (focal length and principal
point; Zhang, 2000, section 3.4). The rules are this project's own. It uses image points alone: no camera is known yet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import Array, Bools, rms_length
from calib.boards.board import Board
from calib.model.homography import fit_homography

#: Cells of the image along x and y.
CELLS = 3
#: A cell is covered by this number of points, or by this share of those of one board.
_POINTS_OF_CELL, _SHARE_OF_CELL = 4, 0.04
#: A board must be moved by this share of the image's diagonal.
_LEAST_SHIFT = 0.02
#: One side of a tilted board must be nearer than the other: its pitch is larger by this share.
TILTED = 0.06
#: Placements for a planar calibration, as usual.
ENOUGH = 8
_COLUMNS, _ROWS = ("left", "middle", "right"), ("upper", "middle", "lower")
_SIDES = ("left", "right", "upper", "lower")


@dataclass(frozen=True)
class Seen:
    """A placement as the image shows it."""

    name: str
    image_size: tuple[int, int]  # Width and height, px
    points_px: Array  # (N, 2) float64, px, all points of the board, row by row; those outside the image too

    @property
    def least_shift_px(self) -> float:
        """Shift from which another placement counts as another one, px."""
        return _LEAST_SHIFT * float(np.hypot(*self.image_size))

    @property
    def cells(self) -> Bools:
        """(3, 3) bool, the covered cells of the image, row by row."""
        place = np.floor((self.points_px + 0.5) / np.array(self.image_size) * CELLS).astype(int)
        place = place[((place >= 0) & (place < CELLS)).all(axis=1)]
        counts = np.bincount(CELLS * place[:, 1] + place[:, 0], minlength=CELLS * CELLS)
        least = max(1.0, min(_POINTS_OF_CELL, _SHARE_OF_CELL * len(self.points_px)))
        return np.asarray(counts.reshape(CELLS, CELLS) >= least)

    @property
    def where(self) -> str:
        """The covered part of the image, in words."""
        covered = self.cells
        corners = [f"{_ROWS[r]} {_COLUMNS[c]}" for r in (0, 2) for c in (0, 2) if covered[r, c]]
        share = f"{np.count_nonzero(covered)} of {CELLS * CELLS} parts of the image"
        if not corners:
            return f"{share}, no corner"
        return f"{share}, with the {_listed(corners)} corner{'s' if len(corners) > 1 else ''}"

    def nearer_sides(self, board: Board) -> frozenset[str]:
        """Return which sides (left, right, upper, lower) of the board's image are nearer to the camera: larger.

        Own estimate: the homography's change of scale from side to side of the image; it needs no focal length.
        """
        (left, upper), (right, lower) = self.points_px.min(axis=0), self.points_px.max(axis=0)
        back = np.linalg.inv(fit_homography(board.nodes.astype(np.float64), self.points_px))
        x, y = (left + right) / 2, (upper + lower) / 2
        ends = np.array([[left, y, 1.0], [right, y, 1.0], [x, upper, 1.0], [x, lower, 1.0]])
        # The depth of the plane at an image point p is 1 / (b . p), with the last row b of the inverse homography.
        one, other = (1.0 / np.abs(ends @ back[2])).reshape(2, 2).T
        nearer = np.where(one < other, _SIDES[::2], _SIDES[1::2])
        return frozenset(nearer[np.abs(one / other - 1.0) > TILTED].tolist())


def shift_px(one: Seen, other: Seen, board: Board) -> float:
    """Return the root mean square distance, px, that the points of a board moved between two placements.

    Own measure; for a board that looks the same after half a turn, of the nearer order.
    """
    orders = [other.points_px, other.points_px[::-1]] if board.symmetric else [other.points_px]
    return min(rms_length(one.points_px - order) for order in orders)


def advice(seen: Sequence[Seen], board: Board) -> str:
    """Return what the next placement should be, in words.

    Own rule: first the corners of the image, then its other parts, then tilts to each side, then a few more.
    """
    if not seen:
        return "hold the board in the middle of the image, wholly in view."
    covered = np.logical_or.reduce([one.cells for one in seen])
    order = [(0, 0), (0, 2), (2, 2), (2, 0), (0, 1), (1, 2), (2, 1), (1, 0), (1, 1)]
    missing = [f"{_ROWS[r]} {_COLUMNS[c]}" for r, c in order if not covered[r, c]]
    tilts = frozenset().union(*(one.nearer_sides(board) for one in seen))
    untilted = [side for side in _SIDES if side not in tilts]
    tilt = f" Tilt it: its {untilted[0]} side nearer to the camera." if untilted else ""
    if missing:
        what = "corner" if missing[0].split()[0] != "middle" and missing[0].split()[1] != "middle" else "part"
        named = "middle" if missing[0] == "middle middle" else missing[0]
        return f"move the board to the {named} {what} of the image.{tilt}"
    if untilted:
        return f"tilt the board by about 30 degrees, its {untilted[0]} side nearer to the camera."
    if len(seen) < ENOUGH:
        return f"any other place and tilt; {ENOUGH} placements or more are usual, {len(seen)} are there."
    return "the image is covered and the tilts differ; further placements only lower the noise."


def turned_upside_down(points_px: Array, board: Board) -> bool:
    """Return whether a board's first row, of (N, 2) points, is lower and runs left; false if half a turn hides it."""
    if board.symmetric:
        return False
    grid = points_px.reshape(board.rows, board.columns, 2)
    along, down = (grid[:, -1] - grid[:, 0]).mean(axis=0), (grid[-1] - grid[0]).mean(axis=0)
    return bool(along[0] < 0 and down[1] < 0)


def is_cut(points_px: Array, image_size: tuple[int, int]) -> bool:
    """Return whether one of all (N, 2) points of a board, px, also those not found in the image, lies outside of it."""
    return bool(((points_px < 0) | (points_px >= image_size)).any())


def _listed(names: Sequence[str]) -> str:
    """Return names as a list in words."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
