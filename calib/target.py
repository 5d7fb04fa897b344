"""The star target: positions of its stars, their ids, and the printed brightness.

The module describes the printed pattern only: no camera, no collimator, no image. The pattern is a grid of squares.
Every inner node of the grid has a star of alternating black and white segments, cut to the square cell of half a
pitch around the node. An AprilTag (Olson 2011) takes the place of some squares, inside a white ring that is half a
square wide. Such patterns for calibration are from Schöps et al. (2020), arXiv:1912.02908; the
collimator of arXiv:2512.16092 shows a star pattern.

Target frame: the plane Z = 0, in millimetres; X points right along the columns, Y down along the rows. The origin is
node (0, 0), the inner node of the first column and row.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import InputMismatch as InputMismatch  # noqa: PLC0414 - simulators catch it, and import this module only

MOST_SQUARES = 200_000
"""Squares that a target may have at most: more than 50 times those of the published pattern."""
MOST_SEGMENTS = 256
"""Segments that a star may have at most: of more, no camera tells one from the next."""


class TagFamily(NamedTuple):
    """A family of AprilTags (Olson 2011), as OpenCV has it."""

    modules: int
    tags: int  # Number of tags: their numbers are 0 to ``tags - 1``


#: Families of AprilTags by name. The number after the h is the least number of bits in which two tags of it differ.
TAG_FAMILIES: Mapping[str, TagFamily] = {
    "36h11": TagFamily(8, 587),
    "36h10": TagFamily(8, 2320),
    "25h9": TagFamily(7, 35),
    "16h5": TagFamily(6, 30),
}


@dataclass(frozen=True)
class StarTarget:
    """A printed star target.

    The defaults are those of the pattern ``pattern_resolution_50x72_segments_16_apriltag_3`` in the toolbox of Schöps
    et al. (2020): 50 x 72 squares, 16 segments, tag 3.

    Parameters
    ----------
    squares_x, squares_y
        Number of squares along X and Y. Stars are at the inner nodes, one fewer in each direction.
    pitch_mm
        Distance of neighbouring stars, mm.
    segments
        Number of segments of a star, black and white together. It is a multiple of 4, so that a star looks the
        same after half a turn.
    tag_id
        Number of the AprilTag in its family.
    tag_square
        Column and row of the tag's upper left square, counted from 0 over all squares.
    tag_squares
        Side of the tag in squares, its black border included.
    tag_family
        Family of the AprilTag, a key of `TAG_FAMILIES`.

    Raises
    ------
    InputMismatch
        If no such target can be printed.

    Examples
    --------
    >>> target = StarTarget()
    >>> len(target.ids)
    3454
    >>> target.node_of([903])
    array([[21, 18]])
    >>> int(target.id_at(21, 18)), int(target.id_at(24, 35))
    (903, -1)
    """

    squares_x: int = 50
    squares_y: int = 72
    pitch_mm: float = 144.5 / 36.0
    segments: int = 16
    tag_id: int = 3
    tag_square: tuple[int, int] = (23, 34)
    tag_squares: int = 4
    tag_family: str = "36h11"

    def __post_init__(self) -> None:
        fault = self._fault()
        if fault:
            raise InputMismatch(fault, where="star target", remedy="Describe the target as it is printed.")

    def _fault(self) -> str:
        """Return why the target cannot be printed; empty if it can."""
        if self.squares_x < 2 or self.squares_y < 2:
            return f"{self.squares_x} x {self.squares_y} squares have no inner node."
        if self.squares_x * self.squares_y > MOST_SQUARES:
            return f"{self.squares_x} x {self.squares_y} squares are more than {MOST_SQUARES}."
        if not (math.isfinite(self.pitch_mm) and self.pitch_mm > 0):
            return f"The pitch is {self.pitch_mm} mm; it must be a positive number."
        if not 4 <= self.segments <= MOST_SEGMENTS or self.segments % 4:
            return f"A star has {self.segments} segments; the number must be a multiple of 4, at most {MOST_SEGMENTS}."
        return self._tag_fault()

    def _tag_fault(self) -> str:
        """Return why the tag cannot be printed; empty if it can."""
        family = TAG_FAMILIES.get(self.tag_family)
        if family is None:
            return f"Tag family {self.tag_family!r} is unknown; known are {', '.join(TAG_FAMILIES)}."
        if not 0 <= self.tag_id < family.tags:
            return (
                f"Tag {self.tag_id} does not exist; family {self.tag_family} has tags 0 to {family.tags - 1}."
            )
        sides = zip(self.tag_square, (self.squares_x, self.squares_y), strict=True)
        fits = all(first >= 1 and first + self.tag_squares <= squares - 1 for first, squares in sides)
        if self.tag_squares < 1 or not fits:
            return f"A tag of {self.tag_squares} squares at square {self.tag_square} does not lie inside the target."
        return ""

    @property
    def columns(self) -> int:
        """Number of columns of nodes."""
        return self.squares_x - 1

    @property
    def rows(self) -> int:
        """Number of rows of nodes."""
        return self.squares_y - 1

    @property
    def tag_modules(self) -> int:
        """Number of modules along a side of the tag, with its black border."""
        return TAG_FAMILIES[self.tag_family].modules

    @property
    def tag_centre_mm(self) -> tuple[float, float]:
        """X and Y of the tag's centre, mm."""
        column, row = self.tag_square
        half = self.tag_squares / 2.0 - 1.0
        return (column + half) * self.pitch_mm, (row + half) * self.pitch_mm

    @property
    def tag_corners_mm(self) -> NDArray[np.float64]:
        """(4, 2) float64, mm, corners of the tag's black border: upper left, upper right, lower right, lower left."""
        centre, half = np.array(self.tag_centre_mm), self.tag_squares * self.pitch_mm / 2.0
        return centre + half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])

    @cached_property
    def _ids_by_node(self) -> NDArray[np.int64]:
        """(rows, columns) int64, id of the star at each node, -1 if there is none; numbered row by row without gaps."""
        present = np.ones((self.rows, self.columns), bool)
        column, row = self.tag_square
        side = self.tag_squares + 1
        present[row - 1 : row - 1 + side, column - 1 : column - 1 + side] = False
        ids = np.full(present.shape, -1, np.int64)
        ids[present] = np.arange(np.count_nonzero(present))
        return ids

    @cached_property
    def _nodes_by_id(self) -> NDArray[np.int64]:
        """(stars, 2) int64, column and row of each star."""
        return np.argwhere(self._ids_by_node >= 0)[:, ::-1].copy()

    @cached_property
    def surrounded(self) -> NDArray[np.int64]:
        """(M, 2) int64, columns and rows of the stars that have all eight neighbours."""
        around = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
        neighbours = self._nodes_by_id[:, None] + around
        return self._nodes_by_id[(self.id_at(neighbours[..., 0], neighbours[..., 1]) >= 0).all(axis=1)]

    @property
    def ids(self) -> NDArray[np.int64]:
        """(stars,) int64, ids of all stars of the target, in ascending order."""
        return np.arange(len(self._nodes_by_id))

    def id_at(self, column: ArrayLike, row: ArrayLike) -> NDArray[np.int64]:
        """Return the ids of the stars at nodes.

        Parameters
        ----------
        column, row
            Columns and rows of the nodes, int, of any shapes that broadcast; nodes outside of the target are allowed.

        Returns
        -------
        array
            int64, ids, in the broadcast shape; -1 where no star is printed.
        """
        columns, rows = np.broadcast_arrays(np.asarray(column, np.int64), np.asarray(row, np.int64))
        inside = (columns >= 0) & (columns < self.columns) & (rows >= 0) & (rows < self.rows)
        ids = self._ids_by_node[np.where(inside, rows, 0), np.where(inside, columns, 0)]
        return np.where(inside, ids, -1)

    def node_of(self, ids: ArrayLike) -> NDArray[np.int64]:
        """Return the nodes of stars.

        Parameters
        ----------
        ids
            (N,) int, ids of the stars.

        Returns
        -------
        array
            (N, 2) int64, column and row of each star.

        Raises
        ------
        InputMismatch
            If an id does not exist on the target.
        """
        wanted = np.atleast_1d(np.asarray(ids, np.int64))
        unknown = wanted[(wanted < 0) | (wanted >= len(self._nodes_by_id))]
        if unknown.size:
            raise InputMismatch(f"Star {unknown[0]} is not on the target.", where="star target")
        return self._nodes_by_id[wanted]

    def positions_mm(self, ids: ArrayLike) -> NDArray[np.float64]:
        """Return the positions of stars on the target plane.

        Parameters
        ----------
        ids
            (N,) int, ids of the stars.

        Returns
        -------
        array
            (N, 2) float64, X and Y of each star, mm.

        Raises
        ------
        InputMismatch
            If an id does not exist on the target.
        """
        return np.asarray(self.node_of(ids) * self.pitch_mm, np.float64)

    @cached_property
    def tag_print(self) -> NDArray[np.uint8]:
        """(M, M) uint8, the `tag_modules` along each side of the tag, with its border: 1 is white."""
        import cv2

        family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{self.tag_family}"))
        printed = family.generateImageMarker(self.tag_id, self.tag_modules, borderBits=1) > 0
        return np.ascontiguousarray(printed, np.uint8)

    def reflectance(self, x_mm: ArrayLike, y_mm: ArrayLike) -> NDArray[np.float64]:
        """Return the printed brightness at points of the target plane.

        The paper outside of the stars' cells is white. At the centre of a star, where all segments meet, the value
        is that of one of them.

        Parameters
        ----------
        x_mm, y_mm
            X and Y of the points, mm, of any shapes that broadcast.

        Returns
        -------
        array
            float64, 0 (black) or 1 (white), in the broadcast shape.
        """
        x, y = np.broadcast_arrays(np.asarray(x_mm, float), np.asarray(y_mm, float))
        column, row, side = x / self.pitch_mm, y / self.pitch_mm, self.tag_squares
        node_x, node_y = np.floor(column + 0.5), np.floor(row + 0.5)
        # Segments are counted from +Y. The first one is white.
        turns = np.arctan2(row - node_y, column - node_x) / (2.0 * np.pi) - 0.25
        segment = np.floor(self.segments * (turns - np.floor(turns)))
        printed = (node_x >= 0) & (node_x < self.columns) & (node_y >= 0) & (node_y < self.rows)
        tag_x, tag_y = column - (self.tag_square[0] - 1), row - (self.tag_square[1] - 1)
        around = (tag_x >= -0.5) & (tag_x < side + 0.5) & (tag_y >= -0.5) & (tag_y < side + 0.5)
        values = np.where(printed & ~around & (segment % 2 != 0), 0.0, 1.0)
        inside = (tag_x >= 0.0) & (tag_x < side) & (tag_y >= 0.0) & (tag_y < side)
        module_x, module_y = ((tag[inside] * self.tag_modules / side).astype(int) for tag in (tag_x, tag_y))
        values[inside] = self.tag_print[module_y, module_x]
        return values
