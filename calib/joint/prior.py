"""The priors of the shared unknowns as information matrices: statements, and unknowns that have amplitudes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Array
from calib.joint.amplitudes import Hyperprior
from calib.joint.effects.effect import Places
from calib.joint.knowledge import Statement
from calib.joint.layout import Layout

#: Names of statements with their doubts (`Statement.doubts`).
Faults = tuple[tuple[str, str], ...]
NO_FAULT: Faults = ()

#: Halves of triangles that are smaller than this are not halved again.
_SMALLEST = 24


def block_diagonal(blocks: Array | Sequence[Array]) -> Array:
    """Return the matrix with square blocks on its diagonal; with that of `scipy.linalg`, `plan` would start slower."""
    ends = np.cumsum([len(block) for block in blocks])
    whole = np.zeros((ends[-1], ends[-1]))
    for end, own in zip(ends, blocks, strict=True):
        whole[end - len(own) : end, end - len(own) : end] = own
    return whole


def inverse_root(matrices: Array) -> tuple[Array, float]:
    """Return R with R^T R the inverses of (..., K, K) positive definite matrices, and the sum of log det of these."""
    lower = np.asarray(np.linalg.cholesky(matrices), np.float64)
    logarithm = 2.0 * float(np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum())
    return _inverse_of_triangle(lower), logarithm


def _inverse_of_triangle(lower: Array) -> Array:
    """Return the inverses of (..., K, K) lower triangles, by halves (Golub and Van Loan, 2013)."""
    half = lower.shape[-1] // 2
    if half < _SMALLEST:
        return np.asarray(np.linalg.inv(lower))
    inverse = np.zeros_like(lower)
    first = inverse[..., :half, :half] = _inverse_of_triangle(lower[..., :half, :half])
    last = inverse[..., half:, half:] = _inverse_of_triangle(lower[..., half:, half:])
    inverse[..., half:, :half] = -last @ (lower[..., half:, :half] @ first)
    return inverse


@dataclass(frozen=True)
class RandomPrior:
    """All unknowns that have amplitudes: their prior covariance is stated + sum over columns of a_q^2 u_q u_q^T."""

    places: Places  # (K,) of the shared unknowns
    shapes: Array  # (K, Q) columns u_q
    amplitudes: Places  # (Q,) place of the amplitude of each column
    stated: Array  # (K,) variances
    groups: tuple[str, ...]  # The row of the budget of each unknown
    blocks: tuple[tuple[slice, slice], ...]  # Rows and columns of unknowns that are independent of all others

    @classmethod
    def of(cls, layout: Layout, hyper: Hyperprior) -> RandomPrior:
        """Return what all effects expect as one."""
        blocks = layout.priors
        places = np.concatenate([layout.places(block.names) for block in blocks])
        parts = [part for block in blocks for part in block.parts]
        amplitudes = np.repeat([hyper.at(name) for name, _ in parts], [shape.shape[1] for _, shape in parts])
        shapes, stated = np.zeros((len(places), len(amplitudes))), np.zeros(len(places))
        own, row, column = [], 0, 0
        for block in blocks:
            shape = np.concatenate([shape for _, shape in block.parts], axis=1)
            rows, columns = slice(row, row + len(shape)), slice(column, column + shape.shape[1])
            shapes[rows, columns], stated[rows] = shape, block.stated
            own.append((rows, columns))
            row, column = rows.stop, columns.stop
        groups = tuple(block.row.name for block in blocks for _ in block.names)
        return cls(places, shapes, amplitudes, stated, groups, tuple(own))

    @cached_property
    def _alone(self) -> NDArray[np.bool_]:
        """(Q,) whether a column scales one unknown; each unknown has such a column, or a stated variance."""
        return np.asarray(np.count_nonzero(self.shapes, axis=0) == 1)

    def information(self, squares: Array) -> tuple[Array, float]:
        """Return the (K, K) prior information for (A,) squares of amplitudes, and log det of the covariance.

        The covariance is diagonal but for few columns (Woodbury, 1950).
        """
        shapes = self.shapes * np.sqrt(squares[self.amplitudes])
        variances, together = self.stated + (shapes[:, self._alone] ** 2).sum(axis=1), shapes[:, ~self._alone]
        pulled = together / variances[:, None]
        root, logarithm = inverse_root(np.eye(together.shape[1]) + together.T @ pulled)
        part = root @ pulled.T
        return np.diag(1.0 / variances) - part.T @ part, logarithm + float(np.log(variances).sum())

    def pulled(self, squares: Array, inside: Array) -> Array:
        """Return (K, Q) the (K, K) prior information times the columns with their amplitudes."""
        columns_pulled = np.zeros_like(self.shapes)
        for rows, columns in self.blocks:
            columns_pulled[rows, columns] = inside[rows, rows] @ self.shapes[rows, columns]
        return np.asarray(columns_pulled * np.sqrt(squares[self.amplitudes]))

    def gradient(self, inside: Array, covariance: Array, mean: Array) -> Array:
        """Return (Q,) number minus expected square of what each column scales, at unit amplitude.

        For the (K, K) prior information, and covariance and mean of the unknowns.
        """
        gradient = np.zeros(len(self.amplitudes))
        for rows, columns in self.blocks:
            own, shape = inside[rows, rows], self.shapes[rows, columns]
            pulled = own @ mean[rows]
            left = own - own @ covariance[rows, rows] @ own - np.outer(pulled, pulled)
            gradient[columns] = ((left @ shape) * shape).sum(axis=0)
        return gradient

    def times_pulled(self, values: Array, pulled: Array) -> Array:
        """Return (..., Q) values (..., K) times `pulled`."""
        parts = [values[..., rows] @ pulled[rows, columns] for rows, columns in self.blocks]
        return np.concatenate(parts, axis=-1)


@dataclass(frozen=True)
class Stated:
    """All statements as one: rows b = values with an information matrix."""

    rows: Array  # (T, S)
    values: Array  # (T,)
    inside: Array  # (T, T) information of the values, a block for each statement
    logarithm: float  # of the determinant of their covariance
    groups: tuple[str, ...]  # The row of the budget of each

    @classmethod
    def of(cls, statements: Sequence[Statement], faults: Faults = NO_FAULT) -> Stated:
        """Return statements as one; some may be at fault."""
        wrong = dict(faults)
        informations = [statement.information(wrong.get(statement.name, "")) for statement in statements]
        inside = block_diagonal(informations)
        return cls(
            np.concatenate([statement.rows for statement in statements]),
            np.concatenate([statement.values for statement in statements]),
            inside,
            -float(np.linalg.slogdet(inside)[1]),
            tuple(statement.group for statement in statements for _ in statement.values),
        )

    @cached_property
    def weighted(self) -> Array:
        """(S, T) rows^T times the information."""
        return np.asarray(self.rows.T @ self.inside)

    @cached_property
    def information(self) -> Array:
        """(S, S) information of the shared unknowns."""
        return np.asarray(self.weighted @ self.rows)

    def off(self, b: Array) -> tuple[Array, float]:
        """Return the (S,) right-hand side and the cost at (S,) shared unknowns."""
        off = self.values - self.rows @ b
        return self.weighted @ off, float(off @ self.inside @ off)
