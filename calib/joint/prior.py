"""The priors of the shared unknowns as information matrices: statements, and unknowns that have amplitudes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.joint.knowledge import Statement
from calib.joint.layout import RandomBlock

Array = NDArray[np.float64]
Places = NDArray[np.int64]

#: Names of statements with their faults (`calib.joint.knowledge.FAULTS`).
Faults = tuple[tuple[str, str], ...]
NO_FAULT: Faults = ()


#: Triangles of this size are inverted as a whole; larger ones in halves.
_WHOLE = 50


def inverse_of(matrices: Array) -> tuple[Array, float]:
    """Return the inverses of (..., K, K) positive definite matrices and the sum of the logarithms of determinants."""
    lower = np.asarray(np.linalg.cholesky(matrices), np.float64)
    logarithm = 2.0 * float(np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum())
    root = _inverse_of_triangle(lower)
    return np.swapaxes(root, -1, -2) @ root, logarithm


def _inverse_of_triangle(lower: Array) -> Array:
    """Return the inverses of (..., K, K) lower triangles, by halves (Golub and Van Loan, 2013)."""
    half = lower.shape[-1] // 2
    if half < _WHOLE:
        return np.asarray(np.linalg.inv(lower))
    found = np.zeros_like(lower)
    first = found[..., :half, :half] = _inverse_of_triangle(lower[..., :half, :half])
    last = found[..., half:, half:] = _inverse_of_triangle(lower[..., half:, half:])
    found[..., half:, :half] = -last @ (lower[..., half:, :half] @ first)
    return found


@dataclass(frozen=True)
class RandomPrior:
    """All unknowns that have amplitudes: their prior covariance is stated + sum over columns of a_q^2 u_q u_q^T."""

    places: Places  # (K,) of the shared unknowns
    shapes: Array  # (K, Q) columns u_q
    amplitudes: Places  # (Q,) place of the amplitude of each column
    stated: Array  # (K, K)
    groups: tuple[str, ...]  # The row of the budget of each unknown
    blocks: tuple[slice, ...]  # The rows of unknowns that are independent of all others

    @classmethod
    def of(cls, blocks: Sequence[RandomBlock]) -> RandomPrior:
        """Return the blocks as one."""
        places = np.concatenate([block.places for block in blocks])
        columns = [(b, at, shape) for b, block in enumerate(blocks) for at, shape in block.parts]
        shapes = np.zeros((len(places), sum(shape.shape[1] for *_, shape in columns)))
        stated = np.zeros((len(places), len(places)))
        ends = np.cumsum([len(block.places) for block in blocks])
        own = tuple(slice(end - len(block.places), end) for end, block in zip(ends, blocks, strict=True))
        for rows, block in zip(own, blocks, strict=True):
            stated[rows, rows] = block.stated
        begin = 0
        for b, _, shape in columns:
            shapes[own[b], begin : begin + shape.shape[1]] = shape
            begin += shape.shape[1]
        amplitudes = np.repeat([at for _, at, _ in columns], [shape.shape[1] for *_, shape in columns])
        groups = tuple(block.group for block in blocks for _ in block.places)
        return cls(places, shapes, amplitudes, stated, groups, own)

    def information(self, squares: Array) -> tuple[Array, float]:
        """Return the (K, K) prior information for (A,) squares of amplitudes, and log det of the covariance."""
        covariance = (self.shapes * squares[self.amplitudes]) @ self.shapes.T + self.stated
        found, logarithm = np.zeros_like(covariance), 0.0
        for own in self.blocks:
            found[own, own], more = inverse_of(covariance[own, own])
            logarithm += more
        return found, logarithm


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
        informations = [one.information(wrong.get(one.name, "")) for one in statements]
        ends = np.cumsum([len(one) for one in informations])
        inside = np.zeros((ends[-1], ends[-1]))
        for end, own in zip(ends, informations, strict=True):
            inside[end - len(own) : end, end - len(own) : end] = own
        return cls(
            np.concatenate([one.rows for one in statements]),
            np.concatenate([one.values for one in statements]),
            inside,
            -float(np.linalg.slogdet(inside)[1]),
            tuple(one.group for one in statements for _ in one.values),
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
