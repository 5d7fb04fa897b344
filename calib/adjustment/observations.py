"""The stars of all views, one below the other, as the refinement takes them.

Knows what was measured and how well; no camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch
from calib.view import View

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observations:
    """The stars of all views, one below the other.

    Attributes
    ----------
    target
        (N, 3) positions on the target, mm, with Z = 0.
    points_px
        (N, 2) image points, px.
    whitening
        (N, 2, 2) inverse Cholesky factors of the stars' covariances; they give residuals unit covariance.
    slices
        The rows of each view.
    view
        (N,) index of each row's view.
    """

    target: Array
    points_px: Array
    whitening: Array
    slices: tuple[slice, ...]
    view: NDArray[np.int64]

    @classmethod
    def from_views(cls, views: Sequence[View]) -> Observations:
        """Stack views.

        Raises
        ------
        InputMismatch
            When a star's covariance is not positive definite.
        """
        counts = [len(view) for view in views]
        target = np.concatenate([view.target_mm for view in views])
        covariances = np.concatenate([view.covariances_px2 for view in views])
        try:
            whitening = np.linalg.inv(np.linalg.cholesky(covariances))
        except np.linalg.LinAlgError:
            raise InputMismatch(
                "A star's covariance is not positive definite.",
                remedy="Use unit covariances if they are unknown.",
            ) from None
        return cls(
            np.column_stack([target, np.zeros(len(target))]),
            np.concatenate([view.points_px for view in views]),
            whitening,
            _slices(counts),
            np.repeat(np.arange(len(views)), counts),
        )

    @property
    def sigmas_per_px(self) -> float:
        """The factor from px to units of the typical star's uncertainty."""
        return float(np.sqrt(np.median(np.abs(np.linalg.det(self.whitening)))))

    def whitened(self, vectors: Array) -> Array:
        """Multiply (N, 2) vectors by the whitening."""
        w = self.whitening
        # The factors are lower triangular; written out, this is several times faster than small products.
        return np.column_stack(
            [w[:, 0, 0] * vectors[:, 0], w[:, 1, 0] * vectors[:, 0] + w[:, 1, 1] * vectors[:, 1]]
        )

    def unwhitened(self, vectors: Array) -> Array:
        """Multiply (N, 2) vectors by the whitening's transpose: a gradient by residuals becomes one by px."""
        w = self.whitening
        return np.column_stack(
            [w[:, 0, 0] * vectors[:, 0] + w[:, 1, 0] * vectors[:, 1], w[:, 1, 1] * vectors[:, 1]]
        )

    def rows(self, views: Sequence[int]) -> list[NDArray[np.int64]]:
        """Return the rows of some views, view by view."""
        return [np.arange(self.slices[i].start, self.slices[i].stop) for i in views]

    def with_rows(self, rows: Sequence[NDArray[np.int64]]) -> Observations:
        """Return views made of the given rows, view by view."""
        every = np.concatenate(rows)
        counts = [len(r) for r in rows]
        return Observations(
            self.target[every],
            self.points_px[every],
            self.whitening[every],
            _slices(counts),
            np.repeat(np.arange(len(counts)), counts),
        )


def _slices(counts: Sequence[int]) -> tuple[slice, ...]:
    """Return the rows of views of so many stars, one below the other."""
    ends = np.cumsum(counts)
    return tuple(slice(int(end - n), int(end)) for n, end in zip(counts, ends, strict=True))
