"""The observations of the adjustment: the stars of all views in common arrays, with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
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
    # covariance.
    whitening: Array
    slices: tuple[slice, ...]
    view: NDArray[np.int64]  # (N,) int64 index of the view of each row
    _remembered: list[tuple[tuple[object, ...], Array]] = field(
        default_factory=list, init=False, repr=False, compare=False
    )

    @classmethod
    def from_views(cls, views: Sequence[View]) -> Observations:
        """Stack the stars of views.

        Returns: The stars of the views, in their order.
        Raises InputMismatch: If the covariance of a star is not positive definite.
        """
        counts = [len(view) for view in views]
        target = np.concatenate([view.target_mm for view in views])
        covariances = np.concatenate([view.covariances_px2 for view in views])
        whitening = _whitening(covariances)
        return cls(
            np.column_stack([target, np.zeros(len(target))]),
            np.asfortranarray(np.concatenate([view.points_px for view in views])),
            whitening,
            _slices(counts),
            np.repeat(np.arange(len(views)), counts),
        )

    @cached_property
    def target_rows(self) -> Array:
        """(3, N) float64 positions on the target, mm: one contiguous row for each coordinate."""
        return np.ascontiguousarray(self.target.T)

    @cached_property
    def point_rows(self) -> Array:
        """(2, N) float64 image points, px: one contiguous row for each axis."""
        return np.ascontiguousarray(self.points_px.T)

    @cached_property
    def bounds(self) -> NDArray[np.int64]:
        """(n, 2) int64 first star of each view, and the first behind it."""
        return np.array([(rows.start, rows.stop) for rows in self.slices], np.int64)

    @cached_property
    def factors(self) -> Array:
        """(3, N) float64 elements 00, 10 and 11 of the whitening, 1 / px; element 01 is zero."""
        return np.array([self.whitening[:, 0, 0], self.whitening[:, 1, 0], self.whitening[:, 1, 1]])

    @cached_property
    def farthest_px(self) -> float:
        """Largest coordinate of an image point, px."""
        return float(np.abs(self.points_px).max())

    @cached_property
    def sigmas_per_px(self) -> float:
        """The factor from px to standard deviations of the typical star."""
        return math.sqrt(median(np.abs(self.factors[0] * self.factors[2])))

    def remembered(self, given: tuple[object, ...], of: Callable[[], Array]) -> Array:
        """Return the result of a function; the last one is kept and returned for the same objects.

        given: Objects that the result depends on besides these observations; they never change.
        Returns: The array that it returns, of any shape; not to be written to.
        """
        if self._remembered and all(a is b for a, b in zip(self._remembered[0][0], given, strict=True)):
            return self._remembered[0][1]
        found = of()
        found.flags.writeable = False
        self._remembered[:] = [(given, found)]
        return found

    def whitened(self, vectors: Array) -> Array:
        """Multiply vectors by the whitening: residuals in px become weighted residuals.

        This is generalised least squares (Aitken, 1936), with the inverse of the Cholesky factor of each covariance.

        vectors: (N, 2) vectors, px.
        Returns: (N, 2) vectors in standard deviations.
        """
        # The factors are lower triangular; written out, this is several times faster than small products.
        a, b, c = self.factors
        x, y = vectors.T
        return np.array([a * x, b * x + c * y]).T

    def unwhitened(self, vectors: Array) -> Array:
        """Multiply vectors by the transposed whitening: a gradient by weighted residuals becomes one by px.

        Own derivation, by the chain rule: if w = L^-1 v, the gradient by v is L^-T times that by w.

        vectors: (N, 2) gradients by weighted residuals.
        Returns: (N, 2) gradients by image points, 1 / px.
        """
        a, b, c = self.factors
        x, y = vectors.T
        return np.array([a * x + b * y, c * y]).T

    def rows(self, views: Sequence[int]) -> list[NDArray[np.int64]]:
        """Return the rows of some views.

        Returns: Row indices, shape (N_i,), of each view.
        """
        return [np.arange(self.slices[i].start, self.slices[i].stop) for i in views]

    def of_view(self, i: int) -> Observations:
        """Return the observations of one view."""
        rows = self.slices[i]
        count = rows.stop - rows.start
        return Observations(
            self.target[rows],
            self.points_px[rows],
            self.whitening[rows],
            (slice(0, count),),
            np.zeros(count, np.int64),
        )

    def with_rows(self, rows: Sequence[NDArray[np.int64]]) -> Observations:
        """Return observations that consist of given rows.

        rows: For each new view, its row indices, shape (N_i,) int64.
        Returns: One view for each entry of `rows`.
        """
        every = np.concatenate(rows)
        counts = [len(r) for r in rows]
        return Observations(
            self.target[every],
            np.asfortranarray(self.points_px[every]),
            self.whitening[every],
            _slices(counts),
            np.repeat(np.arange(len(counts)), counts),
        )


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


def _slices(counts: Sequence[int]) -> tuple[slice, ...]:
    """Return the rows of views with the given numbers of stars."""
    ends = np.cumsum(counts)
    return tuple(slice(int(end - n), int(end)) for n, end in zip(counts, ends, strict=True))
