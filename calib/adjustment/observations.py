"""The observations of the adjustment: the stars of all views in common arrays, with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch
from calib.model.median import median
from calib.view import View

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observations:
    """The N stars of all views, view after view."""

    target: Array  # (N, 3) float64 positions on the target, mm, with Z = 0
    points_px: Array  # (N, 2) float64 image points, px
    # (N, 2, 2) float64 inverse Cholesky factors of the stars' covariances, 1 / px. They give residuals unit
    # covariance (Aitken, 1936).
    whitening: Array
    slices: tuple[slice, ...]
    view: NDArray[np.int64]  # (N,) int64 index of the view of each row

    @classmethod
    def from_views(cls, views: Sequence[View]) -> Observations:
        """Stack the stars of views.

        Returns: The stars of the views, in their order.
        Raises InputMismatch: If the covariance of a star is not positive definite.
        """
        target = np.concatenate([view.target_mm for view in views])
        return cls(
            np.column_stack([target, np.zeros(len(target))]),
            np.concatenate([view.points_px for view in views]),
            _whitening(np.concatenate([view.covariances_px2 for view in views])),
            *_stacked([len(view) for view in views]),
        )

    @cached_property
    def stars(self) -> NDArray[np.int64]:
        """(n,) int64 number of stars of each view."""
        return np.array([rows.stop - rows.start for rows in self.slices], np.int64)

    @cached_property
    def farthest_px(self) -> float:
        """Largest coordinate of an image point, px."""
        return float(np.abs(self.points_px).max())

    @cached_property
    def sigmas_per_px(self) -> float:
        """The factor from px to standard deviations of the typical star."""
        return math.sqrt(median(np.abs(self.whitening[:, 0, 0] * self.whitening[:, 1, 1])))

    @cached_property
    def factors(self) -> Array:
        """(2, 2, N) float64 the whitening as contiguous rows over the stars, for `mapped`."""
        return np.ascontiguousarray(self.whitening.transpose(1, 2, 0))

    def part(self, rows: Sequence[NDArray[np.int64]]) -> Observations:
        """Return observations that consist of given rows.

        rows: For each new view, its row indices, shape (N_i,) int64.
        Returns: One view for each entry of `rows`.
        """
        every = np.concatenate(rows)
        kept = self.target[every], self.points_px[every], self.whitening[every]
        return Observations(*kept, *_stacked([len(r) for r in rows]))


def mapped(matrices: Array, rows: Array) -> Array:
    """Multiply the vectors of the stars by a matrix of each, row by row: several times faster than small products.

    matrices: (2, 2, N). rows: (..., 2, N) vectors.
    """
    x, y = rows[..., 0, :], rows[..., 1, :]
    return np.stack([one[0] * x + one[1] * y for one in matrices], axis=-2)


def _whitening(covariances: Array) -> Array:
    """Return (N, 2, 2) the inverses of the Cholesky factors of (N, 2, 2) covariances, written out."""
    with np.errstate(divide="ignore", invalid="ignore"):
        first = 1.0 / np.sqrt(covariances[:, 0, 0])
        lower = covariances[:, 1, 0] * first
        second = 1.0 / np.sqrt(covariances[:, 1, 1] - lower * lower)
    found = np.zeros_like(covariances)
    found[:, 0, 0], found[:, 1, 0], found[:, 1, 1] = first, -lower * first * second, second
    if not np.isfinite(found).all():
        raise InputMismatch(
            "A star's covariance is not positive definite.",
            remedy="Use unit covariances if they are unknown.",
        )
    return found


def _stacked(counts: Sequence[int]) -> tuple[tuple[slice, ...], NDArray[np.int64]]:
    """Return the rows of views with the given numbers of stars, and the view of each row."""
    ends = np.cumsum(counts)
    slices = tuple(slice(int(end - n), int(end)) for n, end in zip(counts, ends, strict=True))
    return slices, np.repeat(np.arange(len(counts)), counts)
