"""The table of effects: each is some unknowns, what they do to the poses, and a diagonal prior.

A pose sees the S shared unknowns through its own basis: the C unknowns of the camera, the distance of the target, the
2 K coefficients of one field, and, where visible discs count, two displacements about the disc and its middle. What
follows the pupil's place t (in units of `UNIT_TURN`) is kept apart, as the fields that the products of t multiply, so
that places of a pupil can be unknowns, too. All unknowns are independent Gaussians: a hypothesis is nothing but another
1-sigma of some of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from calib.arrays import Array, Ints
from calib.model.type_b_terms import TypeBTerm

from .fields import K

#: Products of the places along X and Y that fields follow: t_x, t_y, t_x^2, t_x t_y, t_y^2.
POWERS = np.array([(1, 0), (0, 1), (2, 0), (1, 1), (0, 2)])


def products(places: Array) -> Array:
    """Return (n, 5) the `POWERS` of (n, 2) places."""
    return np.asarray(np.prod(places[:, None] ** POWERS, axis=2))


def slopes(places: Array) -> Array:
    """Return (n, 5, 2) the derivatives of `products` by the places."""
    x, y = places.T
    one, none = np.ones_like(x), np.zeros_like(x)
    by_x, by_y = (one, none, 2.0 * x, y, none), (none, one, none, x, 2.0 * y)
    return np.stack([np.stack(by_x, axis=1), np.stack(by_y, axis=1)], axis=2)


class Row(NamedTuple):
    """The row of the budget that unknowns belong to."""

    name: str
    kind: Literal["A", "B"]  # Evaluated from the views, or by other means
    source: str = ""


@dataclass(frozen=True)
class Statement:
    """What somebody states of some unknowns, and could be wrong: its value and 1-sigma are those of the table."""

    name: str
    at: Ints  # (k,) places of the unknowns
    free: Array  # (k,) 1-sigma if nobody had stated it
    odds: float  # Beforehand, that its errors are 3.2 times as large or more
    row: Row
    unit: str = ""
    stated: float = 0.0  # In its unit, for one unknown
    per_unknown: float = 1.0  # Change in its unit by the unknown
    larger: Array | None = (
        None  # (k,) what grows if its errors are larger than stated; None: the 1-sigma of the table
    )
    focal: float | None = (
        None  # 1-sigma of the unknown if it states a focal length; None if that is not meant
    )
    together: str = ""  # Name of a source of several statements that can all be wrong together
    together_odds: float = 0.0  # A factor of the odds of one
    term: TypeBTerm | None = None


@dataclass(frozen=True)
class Unknowns:
    """All S shared unknowns."""

    names: tuple[str, ...]
    field: slice  # Places of the field in the basis
    fixed: Array  # (n, B, S) what they do to the poses, whatever the pupil's place
    by_place: Array  # (5, 2 K, S) fields that follow products of the pupil's place
    log_r: Array  # (S,) how log r follows them
    mean: Array  # (S,)
    size: Array  # (S,) 1-sigma, at unit amplitude
    amplitudes: tuple[str, ...]  # S names; empty for a 1-sigma that is known
    rows: tuple[Row, ...]  # S
    statements: tuple[Statement, ...]
    results: dict[str, Array]  # By name (S,) how a quantity of the collimator follows them

    def maps(self, places: Array) -> Array:
        """Return (n, B, S) what they do to the bases of n poses whose pupils are at (n, 2) places."""
        whole = self.fixed.copy()
        whole[:, self.field] += np.tensordot(products(places), self.by_place, 1)
        return whole

    def places(self, name: str) -> Ints:
        """Return the places of the unknowns of an effect."""
        return np.array([k for k, own in enumerate(self.names) if own.split(" #")[0] == name], np.int64)


@dataclass
class Table:
    """Collects effects for n poses of a basis with B entries."""

    n: int
    camera: int  # Number of the camera's unknowns, which are the first entries of the basis
    about_disc: bool = False  # Whether visible discs count
    _names: list[str] = field(default_factory=list)
    _fixed: list[Array] = field(default_factory=list)
    _by_place: list[Array] = field(default_factory=list)
    _log_r: list[Array] = field(default_factory=list)
    _mean: list[Array] = field(default_factory=list)
    _size: list[Array] = field(default_factory=list)
    _amplitudes: list[str] = field(default_factory=list)
    _rows: list[Row] = field(default_factory=list)
    statements: list[Statement] = field(default_factory=list)
    _results: dict[str, list[tuple[int, float]]] = field(default_factory=dict)

    @property
    def depth(self) -> int:
        """Place of the distance in the basis."""
        return self.camera

    @property
    def field_slice(self) -> slice:
        """Places of the field in the basis."""
        return slice(self.camera + 1, self.camera + 1 + 2 * K)

    @property
    def basis(self) -> int:
        """Number of entries of the basis."""
        return self.middle.stop

    @property
    def rim(self) -> slice:
        """Places of the displacements about the disc."""
        return slice(self.field_slice.stop, self.field_slice.stop + 2 * self.about_disc)

    @property
    def middle(self) -> slice:
        """Places of the movement of the disc's middle, mm."""
        return slice(self.rim.stop, self.rim.stop + 2 * self.about_disc)

    def add(
        self,
        name: str,
        row: Row,
        size: Array | float,
        *,
        count: int = 1,
        amplitude: str | Sequence[str] = "",
        mean: Array | float = 0.0,
        columns: Array | None = None,
        by_place: Array | None = None,
        log_r: Array | float = 0.0,
    ) -> Ints:
        """Add ``count`` unknowns, and return their places.

        columns: (n, B, q); by_place: (5, 2 K, q); log_r: (q,).
        """
        begin = len(self._names)
        self._names += [name if count == 1 else f"{name} #{k}" for k in range(count)]
        none = np.zeros((self.n, self.basis, count))
        self._fixed.append(none if columns is None else columns.reshape(none.shape))
        self._by_place.append(np.zeros((len(POWERS), 2 * K, count)) if by_place is None else by_place)
        self._log_r.append(np.broadcast_to(log_r, count))
        self._mean.append(np.broadcast_to(mean, count))
        self._size.append(np.broadcast_to(size, count))
        self._amplitudes += [amplitude] * count if isinstance(amplitude, str) else list(amplitude)
        self._rows += [row] * count
        return np.arange(begin, begin + count)

    def field(
        self,
        name: str,
        row: Row,
        shapes: Array,
        size: Array | float,
        amplitude: str | Sequence[str] = "",
        factors: Array | None = None,
    ) -> Ints:
        """Add unknowns that displace the stars by (2 K, q) shapes, times (n,) factors of the poses."""
        columns = np.zeros((self.n, self.basis, shapes.shape[1]))
        columns[:, self.field_slice] = shapes if factors is None else factors[:, None, None] * shapes
        return self.add(name, row, size, count=shapes.shape[1], amplitude=amplitude, columns=columns)

    def turning(
        self, name: str, row: Row, shapes: Callable[[int], Array], size: Array | float, amplitude: str
    ) -> Ints:
        """Add unknowns with a field of their own in each pose; ``shapes``: its (2 K, q) by the number of the pose."""
        of_poses = np.array([shapes(pose) for pose in range(self.n)])
        columns = np.zeros((self.n, self.basis, of_poses.shape[2]))
        columns[:, self.field_slice] = of_poses
        return self.add(name, row, size, count=of_poses.shape[2], amplitude=amplitude, columns=columns)

    def follows(self, result: str, at: Ints, coefficients: Array | float = 1.0) -> None:
        """Say that a quantity of the collimator follows unknowns with these coefficients."""
        values = np.broadcast_to(coefficients, len(at)).tolist()
        self._results.setdefault(result, []).extend(zip(at.tolist(), values, strict=True))

    def ended(self) -> Unknowns:
        """Return all unknowns."""
        size = len(self._names)
        results = {name: np.zeros(size) for name in self._results}
        for name, parts in self._results.items():
            for at, value in parts:
                results[name][at] += value
        return Unknowns(
            tuple(self._names),
            self.field_slice,
            np.concatenate(self._fixed, axis=2),
            np.concatenate(self._by_place, axis=2),
            np.concatenate(self._log_r).astype(float),
            np.concatenate(self._mean).astype(float),
            np.concatenate(self._size).astype(float),
            tuple(self._amplitudes),
            tuple(self._rows),
            tuple(self.statements),
            results,
        )
