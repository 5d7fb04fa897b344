"""A view: the stars detected in one pose, with their points in the image and on the target."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar, cast

import numpy as np

from calib.arrays import AnyArray, Array, Bools, Ints, ReadOnlyArrays
from calib.errors import InputMismatch, require_unmasked

T = TypeVar("T")
#: Share of the variances by which the two halves of a covariance may differ, as rounding makes them.
_ASYMMETRY = 1e-9
_ARRAYS = {"ids": np.int64, **dict.fromkeys(("points_px", "target_mm", "covariances_px2"), np.float64)}

_SHAPES: dict[str, tuple[tuple[int, ...], str]] = {
    "ids": ((), "Give one number for each point, in a row."),
    "points_px": ((2,), "Points as OpenCV has them, (N, 1, 2): give points.reshape(-1, 2)."),
    "target_mm": ((2,), "Object points as OpenCV has them, (N, 3): leave out Z, points[:, :2]."),
    "covariances_px2": (
        (2, 2),
        "Give a matrix for each point, or one number for all, their 1-sigma: 0.02 px.",
    ),
}
#: Shape of each array after its first axis, and what to do with another one.


@dataclass(frozen=True)
class RimPoints(ReadOnlyArrays):
    """The rim of the beam as the image of a pose shows it: finite points on the target's plane."""

    # (K, 2) float64, mm, points at which the light ends; K is 0 if the rim is out of the frame.
    points_mm: Array
    sigmas_mm: Array  # (K,) float64, mm, 1-sigma of each point across the rim
    # (L, 2) float64, mm, points at the border of the frame that are bright: the rim lies farther out.
    lit_mm: Array
    # 1-sigma of the rim's centre along each axis, mm, because the light is not even over the beam.
    level_sigma_mm: float

    def __post_init__(self) -> None:
        super().__post_init__()
        k, shapes = len(self.points_mm), (self.points_mm.shape, self.sigmas_mm.shape, self.lit_mm.shape)
        if shapes != ((k, 2), (k,), (len(self.lit_mm), 2)):
            raise InputMismatch(f"The arrays of the rim have shapes {shapes}.", where="rim points")
        numbers = (self.points_mm, self.sigmas_mm, self.lit_mm, np.array(self.level_sigma_mm))
        if not all(np.isfinite(a).all() for a in numbers):
            raise InputMismatch("The rim holds numbers that are not finite.", where="rim points")


@dataclass(frozen=True, eq=False, repr=False)
class View(ReadOnlyArrays):
    """Stars of one pose. Two views are equal only if they are the same object; the arrays are its own, and read-only.

    Attributes
    ----------
    name
        Name of the pose.
    image_size
        Width and height of the sensor, px.
    ids
        (N,) int64, ids of the stars on the target. No id occurs twice. Whole numbers of any type are taken.
    points_px
        (N, 2) float64, px, image points u, v. Pixel centres are at integers, as in OpenCV.
    target_mm
        (N, 2) float64, mm, positions X, Y on the target plane (Z = 0).
    covariances_px2
        (N, 2, 2) float64, px^2, covariance of each image point: symmetric, with positive variances along every axis. A
        single number is taken too: the 1-sigma of every point along each axis, px.
    rim
        The rim of the beam in the image; None if there is no image, as for a list of points.
    recorded_s
        When it was recorded, s, by one clock for all views; None if it is not known.

    Raises
    ------
    InputMismatch
        If shapes disagree, a number is not finite, an id is not whole or occurs twice, or a covariance is not
        symmetric with positive variances.
    """

    name: str
    image_size: tuple[int, int]
    ids: Ints
    points_px: Array
    target_mm: Array
    covariances_px2: Array = field(default_factory=lambda: np.empty(0))
    rim: RimPoints | None = None
    recorded_s: float | None = None
    _remembered: dict[str, object] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name, kind in _ARRAYS.items():
            own = self._numbers(name).astype(kind)  # a copy
            if name == "covariances_px2" and not own.ndim:
                own = np.tile(own * abs(own) * np.eye(2), (self.ids.size, 1, 1))  # none of a negative one
            object.__setattr__(self, name, own)
        super().__post_init__()
        object.__setattr__(self, "image_size", self._sides())
        n = self.ids.size
        self._require_shapes(n)
        if len(set(self.ids.tolist())) != n:  # np.unique would load NumPy's masked arrays
            raise InputMismatch("The view holds a point twice.", where=f"view {self.name}")
        if not all(np.isfinite(a).all() for a in (self.points_px, self.target_mm, self.covariances_px2)):
            raise InputMismatch("The view holds numbers that are not finite.", where=f"view {self.name}")
        self._require_covariances()

    def _numbers(self, name: str) -> AnyArray:
        """Return what was given as an array of numbers; ids are whole."""
        where = f"view {self.name}"
        drop = "Give each array without the rows in which something is masked."
        require_unmasked(getattr(self, name), f"Its {name} hold", where=where, remedy=drop)
        given = np.asarray(getattr(self, name))
        if given.dtype.kind not in "iuf" and given.size:
            raise InputMismatch(f"Its {name} are not numbers.", where=where, remedy="Give numbers.")
        if name == "ids" and given.dtype.kind in "uf":
            wrong = given[~((given == np.rint(given)) & (abs(given) < 2.0**63))]  # nan is not whole either
            if wrong.size:
                raise InputMismatch(
                    f"The id {wrong.flat[0]:g} is not a whole number of 64 bits.",
                    where=where,
                    remedy="Give each point the whole number that names it on the target.",
                )
        return given

    def _sides(self) -> tuple[int, int]:
        """Return width and height as whole numbers."""
        sides = np.ravel(np.asarray(self.image_size))
        if sides.dtype.kind in "iuf" and sides.size == 2 and (sides >= 1).all() and (sides % 1 == 0).all():
            return int(sides[0]), int(sides[1])
        raise InputMismatch(
            f"Its image_size is {self.image_size}.",
            where=f"view {self.name}",
            remedy="Give width and height, px; of a NumPy image: image.shape[1::-1].",
        )

    def _require_shapes(self, n: int) -> None:
        """Refuse arrays of other shapes than those of ``n`` points."""
        for name, (shape, remedy) in _SHAPES.items():
            given, needed = getattr(self, name).shape, (n, *shape)
            if given != needed:
                advice = f"Each point is a column: give {name}.T." if given[:-1] == shape else remedy
                raise InputMismatch(
                    f"Its {name} have the shape {given}, and {n} ids need {needed}.",
                    where=f"view {self.name}",
                    remedy="Give one row for each id." if given[1:] == shape else advice,
                )

    def _require_covariances(self) -> None:
        """Refuse covariances that are not symmetric, or have no positive variance along some axis."""
        (xx, xy), (yx, yy) = np.moveaxis(self.covariances_px2, 0, -1)
        symmetric = np.abs(xy - yx) <= _ASYMMETRY * (np.abs(xx) + np.abs(yy))
        wrong = np.flatnonzero(~(symmetric & (xx > 0) & (yy > 0) & (xx * yy > xy * yx)))
        if wrong.size:
            raise InputMismatch(
                f"The covariance of point {self.ids[wrong[0]]} is not symmetric with positive variances.",
                where=f"view {self.name}",
                remedy="If you do not know it, give the 1-sigma of all points, px, such as 0.02.",
            )

    def __repr__(self) -> str:
        return f"View({self.name!r}, {len(self)} stars, {self.image_size[0]} x {self.image_size[1]})"

    def __len__(self) -> int:
        """Number of stars."""
        return len(self.ids)

    def part(self, kept: Bools) -> View:
        """Return the view with some of its stars.

        Parameters
        ----------
        kept
            (N,) bool, which of its N stars to keep.

        Returns
        -------
        View
            The rest is the same.
        """
        return replace(self, **{name: getattr(self, name)[kept] for name in _ARRAYS})

    def remembered(self, what: str, of: Callable[[View], T]) -> T:
        """Return what a function gives for this view; it is computed at the first call only.

        Parameters
        ----------
        what
            Name of the result.
        of
            A function of the view alone, always the same one for a name. A view never changes, so its result does not
            either.

        Returns
        -------
        object
            Its result.
        """
        if what not in self._remembered:
            self._remembered[what] = of(self)
        return cast("T", self._remembered[what])


def times_of(views: Sequence[View]) -> Array:
    """Return (n,) when views were recorded, 0 the first and 1 the last; by their order if a time is not known."""
    known = [view.recorded_s for view in views if view.recorded_s is not None]
    times = np.array(known) if len(known) == len(views) else np.arange(1.0 * len(views))
    return (times - times.min()) / max(float(np.ptp(times)), 1e-3)
