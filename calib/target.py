"""The star target: where its stars lie, how they are numbered, and how bright it is printed.

Knows the printed pattern only: no camera, no collimator, no image. The pattern is a grid of squares; a star
of alternating black and white segments surrounds every inner node, cut to the square cell of half a pitch
around it, and an AprilTag of family 36h11 stands in place of some squares, inside a white ring as wide as
half a square.

Target frame: the plane Z = 0, X right along the columns, Y down along the rows, millimetres; node (0, 0), the
inner node of the first column and row, is the origin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from calib.errors import InputMismatch

#: An AprilTag 36h11 is 6 x 6 bits inside a black border of one module.
TAG_MODULES = 8


class TargetLayout(NamedTuple):
    """All that `reflectance_at` needs, in a form that numba compiles: plain numbers and one small array."""

    pitch_mm: float
    columns: int
    rows: int
    segments: int
    tag_column: int
    tag_row: int
    tag_squares: int
    tag_modules: NDArray[np.uint8]


@dataclass(frozen=True)
class StarTarget:
    """A printed star target.

    Parameters
    ----------
    squares_x, squares_y
        Number of squares along X and Y; stars stand at the inner nodes, one fewer each way.
    pitch_mm
        Distance of neighbouring stars, mm.
    segments
        Segments of a star, black and white counted together; a multiple of 4, so that a star keeps its look
        when turned by half a turn.
    tag_id
        Number of the AprilTag in family 36h11, 0 to 586.
    tag_square
        Column and row of the tag's upper left square, counted from 0 over all squares.
    tag_squares
        Side of the tag in squares, its black border included.

    Raises
    ------
    InputMismatch
        When the numbers make no printable target.

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

    def __post_init__(self) -> None:
        fault = self._fault()
        if fault:
            raise InputMismatch(fault, where="star target", remedy="Describe the target as it is printed.")

    def _fault(self) -> str:
        """Say what makes the target unprintable, or nothing."""
        if self.squares_x < 2 or self.squares_y < 2:
            return f"{self.squares_x} x {self.squares_y} squares have no inner node."
        if not (math.isfinite(self.pitch_mm) and self.pitch_mm > 0):
            return f"A pitch of {self.pitch_mm} mm."
        if self.segments < 4 or self.segments % 4:
            return f"{self.segments} segments: a star has a multiple of 4."
        if not 0 <= self.tag_id <= 586:
            return f"Tag {self.tag_id}: family 36h11 has 0 to 586."
        fits = all(
            first >= 1 and first + self.tag_squares <= squares - 1
            for first, squares in zip(self.tag_square, (self.squares_x, self.squares_y), strict=True)
        )
        if self.tag_squares < 1 or not fits:
            return f"A tag of {self.tag_squares} squares at square {self.tag_square} does not lie inside."
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
    def tag_centre_mm(self) -> tuple[float, float]:
        """X and Y of the tag's centre, mm."""
        column, row = self.tag_square
        half = self.tag_squares / 2.0 - 1.0
        return (column + half) * self.pitch_mm, (row + half) * self.pitch_mm

    @property
    def tag_corners_mm(self) -> NDArray[np.float64]:
        """(4, 2) corners of the tag's black border, mm: upper left, upper right, lower right, lower left."""
        centre, half = np.array(self.tag_centre_mm), self.tag_squares * self.pitch_mm / 2.0
        return centre + half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])

    @cached_property
    def _ids_by_node(self) -> NDArray[np.int64]:
        """(rows, columns) id of the star at each node, -1 where there is none; row by row without gaps."""
        present = np.ones((self.rows, self.columns), bool)
        column, row = self.tag_square
        side = self.tag_squares + 1
        present[row - 1 : row - 1 + side, column - 1 : column - 1 + side] = False
        ids = np.full(present.shape, -1, np.int64)
        ids[present] = np.arange(np.count_nonzero(present))
        return ids

    @cached_property
    def _nodes_by_id(self) -> NDArray[np.int64]:
        """(number of stars, 2) column and row of each star."""
        return np.argwhere(self._ids_by_node >= 0)[:, ::-1].copy()

    @property
    def ids(self) -> NDArray[np.int64]:
        """(number of stars,) int64, every id that exists, rising."""
        return np.arange(len(self._nodes_by_id))

    def id_at(self, column: ArrayLike, row: ArrayLike) -> NDArray[np.int64]:
        """Id of the star at each node, int64 in the broadcast shape; -1 where no star is printed."""
        columns, rows = np.broadcast_arrays(np.asarray(column, np.int64), np.asarray(row, np.int64))
        inside = (columns >= 0) & (columns < self.columns) & (rows >= 0) & (rows < self.rows)
        ids = self._ids_by_node[np.where(inside, rows, 0), np.where(inside, columns, 0)]
        return np.where(inside, ids, -1)

    def node_of(self, ids: ArrayLike) -> NDArray[np.int64]:
        """(N, 2) int64 column and row of each star.

        Raises
        ------
        InputMismatch
            When a star of that number is not on the target.
        """
        wanted = np.atleast_1d(np.asarray(ids, np.int64))
        unknown = wanted[(wanted < 0) | (wanted >= len(self._nodes_by_id))]
        if unknown.size:
            raise InputMismatch(f"Star {unknown[0]} is not on the target.", where="star target")
        return self._nodes_by_id[wanted]

    def positions_mm(self, ids: ArrayLike) -> NDArray[np.float64]:
        """(N, 2) float64 X and Y of each star, mm. Raises `InputMismatch` as `node_of` does."""
        return np.asarray(self.node_of(ids) * self.pitch_mm, np.float64)

    @cached_property
    def layout(self) -> TargetLayout:
        """The pattern as `reflectance_at` takes it."""
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        modules = family.generateImageMarker(self.tag_id, TAG_MODULES, borderBits=1) > 0
        column, row = self.tag_square
        return TargetLayout(
            float(self.pitch_mm),
            self.columns,
            self.rows,
            self.segments,
            column - 1,
            row - 1,
            self.tag_squares,
            np.ascontiguousarray(modules, np.uint8),
        )

    def reflectance(self, x_mm: ArrayLike, y_mm: ArrayLike) -> NDArray[np.float64]:
        """Return the printed brightness at points of the target plane, 0 (black) or 1 (white).

        The result has the broadcast shape of the inputs. The paper outside the stars' cells is white; at a
        star's very centre, where segments meet, the value is that of one of them.
        """
        x, y = np.broadcast_arrays(np.asarray(x_mm, float), np.asarray(y_mm, float))
        values = _reflectances(x.ravel(), y.ravel(), self.layout)
        return np.asarray(values).reshape(x.shape)


@njit(cache=True, error_model="numpy")
def reflectance_at(x_mm: float, y_mm: float, layout: TargetLayout) -> float:
    """Return the printed brightness at one point, 0 or 1, for code that numba compiles.

    Parameters
    ----------
    x_mm, y_mm
        Point of the target plane, mm.
    layout
        `StarTarget.layout`.
    """
    column, row = x_mm / layout.pitch_mm, y_mm / layout.pitch_mm
    tag_x, tag_y = column - layout.tag_column, row - layout.tag_row
    side = layout.tag_squares
    if -0.5 <= tag_x < side + 0.5 and -0.5 <= tag_y < side + 0.5:
        if not (0.0 <= tag_x < side and 0.0 <= tag_y < side):
            return 1.0
        module_x, module_y = int(tag_x * TAG_MODULES / side), int(tag_y * TAG_MODULES / side)
        return float(layout.tag_modules[module_y, module_x])
    node_x, node_y = math.floor(column + 0.5), math.floor(row + 0.5)
    if not (0 <= node_x < layout.columns and 0 <= node_y < layout.rows):
        return 1.0
    # Segments are counted from +Y, and the first of them is white.
    turns = math.atan2(row - node_y, column - node_x) / (2.0 * math.pi) - 0.25
    segment = math.floor(layout.segments * (turns - math.floor(turns)))
    return 1.0 if segment % 2 == 0 else 0.0


@njit(cache=True, error_model="numpy")
def _reflectances(x_mm: Any, y_mm: Any, layout: TargetLayout) -> Any:
    """Evaluate `reflectance_at` along two flat arrays."""
    values = np.empty(x_mm.size)
    for i in range(x_mm.size):
        values[i] = reflectance_at(x_mm[i], y_mm[i], layout)
    return values
