"""The problem of a search: the stars, the table of effects about a start, and the readings; and a state of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.arrays import Array, Ints
from calib.model import result_parts as parts
from calib.model.rim_fit import Disc
from calib.model.rotation import exp_map
from calib.view import View

from . import amplitudes as amp
from .amplitudes import Expected, Lever, expected
from .camera import Camera
from .effects import RIM_SIZES, Glass, Poses, sizes_by_degree
from .fields import FIELD_RADIUS, Fields, K, of_degrees
from .gimbal import Readings
from .knowledge import Known
from .pupils import Moved, Places, about_disc
from .table import Row, Table, Unknowns, slopes


@dataclass(frozen=True)
class Own:
    """What each pose has for itself: a field, and where discs count, displacements about the disc and its middle."""

    basis: Array  # (n, B, F) what its coefficients do to the bases of the poses
    size: Array  # (F,) 1-sigma at unit amplitude
    amplitudes: tuple[str, ...]
    rows: tuple[Row, ...]


_POSES = Row(parts.POSE_FIELDS, "A", "residuals that differ from pose to pose")
_DISCS = Row(parts.PUPILS, "A", "visible discs")
#: Displacements about the disc differ from pose to pose by this share of those that all poses share.
_RIM_DIFFERS = 0.2


def own_of(table: Table, moved: Moved) -> Own:
    """Return what each of n poses has for itself."""
    unit, degrees = of_degrees(range(1, len(amp.POSE) + 1))
    size, names = sizes_by_degree(amp.POSE, degrees)
    basis = np.zeros((table.n, table.basis, len(size)))
    basis[:, table.field_slice] = unit
    rows = (_POSES,) * len(size)
    if table.about_disc:
        rim = np.zeros((table.n, table.basis, 2))
        rim[:, table.rim] = np.eye(2)
        basis, size = np.concatenate([basis, rim], axis=2), np.concatenate([size, _RIM_DIFFERS * RIM_SIZES])
        names, rows = [*names, amp.RIM, amp.RIM], (*rows, _POSES, _POSES)
    if table.about_disc and not moved.by_hand:
        middle = np.zeros((table.n, table.basis, 2))
        middle[:, table.middle] = [np.linalg.cholesky(disc.covariance_mm2) for disc in moved.of_poses]
        basis, size = np.concatenate([basis, middle], axis=2), np.concatenate([size, np.ones(2)])
        names, rows = [*names, amp.DISCS, amp.DISCS], (*rows, _DISCS, _DISCS)
    return Own(basis, size, tuple(names), rows)


@dataclass(frozen=True)
class Start:
    """Where a search begins."""

    f_px: float
    centre: tuple[float, float, float]  # x, y, r, mm
    rotations: Array  # (m, 3, 3) of the views, camera <- target
    camera: Array  # (C,) unknowns of the camera at f0 = f_px
    glass: float = 0.0  # Radial distortion of the glass, of |h|^2 h
    another: bool = False  # Whether the certificate is another collimator's: its length is free


@dataclass(frozen=True)
class Stars:
    """What does not change of the stars of a view."""

    mm: Array  # (N, 2)
    px: Array  # (N, 2)
    whitening: Array  # (N, 2, 2) W with W^T W the inverse covariance
    sigma_px: Array  # (N,) geometric mean of the covariance
    polynomials: Array  # (N, K)
    rho: Array  # (N,) distance from the middle of the beam, over its radius
    disc: Disc | None  # About which stars are displaced, if it counts

    @classmethod
    def of(cls, view: View, fields: Fields, rho: Array, disc: Disc | None) -> Stars:
        """Return those of a view."""
        whitening = np.linalg.inv(np.linalg.cholesky(view.covariances_px2))
        sigma_px = np.linalg.det(whitening) ** -0.5
        polynomials = fields.polynomials(view.target_mm)
        return cls(view.target_mm, view.points_px, whitening, sigma_px, polynomials, rho, disc)


@dataclass(frozen=True)
class State:
    """A point of the search."""

    b: Array  # (S,) shared unknowns
    own: Array  # (n, F) own fields of the poses
    rotations: Array  # (m, 3, 3) of the views

    def moved(self, step: Array, own: Array, turns: Array, share: float = 1.0) -> State:
        """Return the state after a share of a step: (S,), (n, F), and (m, 3) rotation vectors on the camera's side."""
        return State(self.b + share * step, self.own + share * own, exp_map(share * turns) @ self.rotations)


@dataclass(frozen=True)
class Problem:
    """What a search reads."""

    stars: tuple[Stars, ...]
    camera: Camera
    fields: Fields
    poses: Ints  # (m,) pose of each view
    turned: Poses
    unknowns: Unknowns
    own: Own
    moved: Moved
    places: Places | None  # Of a pupil that a hand moves
    readings: Readings | None
    expected: Expected
    lever: Lever

    @cached_property
    def n(self) -> int:
        """Number of poses."""
        return int(self.poses.max()) + 1

    @cached_property
    def members(self) -> list[list[int]]:
        """The views of each pose."""
        return [np.flatnonzero(self.poses == pose).tolist() for pose in range(self.n)]

    @cached_property
    def _held(self) -> Array:
        """(n, B, S) what the shared unknowns do to the poses if the pupil follows the turn, but for log r."""
        return self.unknowns.maps(self.turned.places)

    def pupil(self, b: Array) -> Array:
        """Return (n, 2) where the pupil is, in units of `amplitudes.UNIT_TURN`."""
        if self.places is None:
            return self.turned.places
        return np.asarray(self.places.shown + self.places.per_mm * (self.unknowns.fixed[:, self.middle] @ b))

    def maps(self, b: Array) -> Array:
        """Return (n, B, S) what the shared unknowns do to the poses at the pupil's place, but for log r."""
        return self._held if self.places is None else self.unknowns.maps(self.pupil(b))

    def by_places(self, b: Array) -> Array:
        """Return (n, 2 K, S) what the places of the pupil do to the fields that follow it, by their unknowns."""
        if self.places is None:
            return np.zeros((self.n, 2 * K, len(b)))
        fields = slopes(self.pupil(b)).swapaxes(1, 2) @ (self.unknowns.by_place @ b)
        moved = self.places.per_mm * self.unknowns.fixed[:, self.middle]
        return np.asarray(np.swapaxes(fields, 1, 2) @ moved)

    @property
    def depth(self) -> int:
        """Place of the distance in the basis of a pose."""
        return len(self.camera.names)

    @property
    def field(self) -> slice:
        """Places of the field in the basis of a pose."""
        return self.unknowns.field

    @property
    def shifts(self) -> Ints:
        """Places of a shift along X and along Y: the field's coefficients of degree 0."""
        return self.field.start + np.array([0, K])

    @property
    def size(self) -> int:
        """Number of entries of the basis of a pose."""
        return self.unknowns.fixed.shape[1]

    @property
    def rim(self) -> slice:
        """Places of the displacements about the disc in the basis of a pose."""
        return slice(self.field.stop, self.field.stop + (self.size - self.field.stop) // 2)

    @property
    def middle(self) -> slice:
        """Places of the movement of the disc's middle."""
        return slice(self.rim.stop, self.size)

    @cached_property
    def at(self) -> Ints:
        """(S,) place of the amplitude of each shared unknown; -1 where its 1-sigma is known."""
        place = {name: k for k, name in enumerate(self.expected.names)}
        return np.array([place.get(name, -1) for name in self.unknowns.amplitudes], np.int64)

    @cached_property
    def own_at(self) -> Ints:
        """(F,) place of the amplitude of each own coefficient."""
        return np.array([self.expected.at(name) for name in self.own.amplitudes], np.int64)

    @cached_property
    def groups(self) -> dict[str, Array]:
        """By row of the budget (S + F,) 1 for the shared unknowns and own coefficients that belong to it, else 0."""
        of = [row.name for row in (*self.unknowns.rows, *self.own.rows)]
        return {name: np.array([float(other == name) for other in of]) for name in dict.fromkeys(of)}

    @property
    def star(self) -> int:
        """Place of the amplitude of the stars' noise."""
        return self.expected.at(amp.STAR)

    @cached_property
    def reading(self) -> int:
        """Place of the amplitude of the readings."""
        return self.expected.at(amp.READING)

    @cached_property
    def wide(self) -> Array:
        """(6, S) what the search watches: log f, principal point, x, y, log r, each over its scale."""
        rows = np.zeros((6, len(self.unknowns.names)))
        rows[[0, 1, 2], [0, 2, 3]] = 1.0
        for k, name in enumerate(("x", "y"), start=3):
            rows[k] = self.unknowns.results[name] / self.fields.r0
        rows[5] = self.unknowns.log_r
        return rows

    def variances(self, eta: Array, wide: dict[int, float]) -> Array:
        """Return (S,) prior variances for (A,) logarithms; ``wide``: other 1-sigmas of some unknowns."""
        variances = (self.unknowns.size * np.exp(np.where(self.at >= 0, eta[self.at], 0.0))) ** 2
        for k, sigma in wide.items():
            variances[k] = sigma**2
        return np.asarray(variances)

    def own_variances(self, eta: Array) -> Array:
        """Return (F,) prior variances of the own coefficients."""
        return np.asarray((self.own.size * np.exp(eta[self.own_at])) ** 2)

    def bases(self, state: State) -> Array:
        """Return (n, B) the bases of the poses."""
        bases = self.maps(state.b) @ state.b + (self.own.basis @ state.own[:, :, None])[:, :, 0]
        bases[:, self.depth] += self.fields.r0 * np.exp(self.unknowns.log_r @ state.b)
        return np.asarray(bases)

    def points(self, state: State, v: int, basis: Array) -> Array:
        """Return (N, 3) displaced stars of a view from the centre, in the camera's axes; basis: (B,) of its pose."""
        stars = self.stars[v]
        field = basis[self.field].reshape(2, K)
        mm = stars.mm - self.fields.middle + self.fields.r0 * stars.polynomials @ field.T
        if stars.disc is not None:
            mm += about_disc(stars.disc, stars.mm, basis[self.middle]) @ basis[self.rim]
        depth = np.full(len(mm), basis[self.depth])
        return np.asarray(np.column_stack([mm, depth]) @ state.rotations[v].T)

    def residuals(self, state: State) -> list[Array]:
        """Return for each view (N, 2) image points found minus predicted, px; NaN behind the camera."""
        bases = self.bases(state)
        c = state.b[: len(self.camera.names)]
        return [
            stars.px - self.camera.project(c, self.points(state, v, bases[pose]))
            for v, (stars, pose) in enumerate(zip(self.stars, self.poses, strict=True))
        ]

    def whitened(self, state: State) -> list[Array]:
        """Return for each view (N, 2) the residuals over their sigma."""
        pairs = zip(self.stars, self.residuals(state), strict=True)
        return [(stars.whitening @ off[:, :, None])[:, :, 0] for stars, off in pairs]

    def lengths(self, state: State) -> list[Array]:
        """Return for each view (N,) the lengths of the residuals over their sigma."""
        return [np.linalg.norm(off, axis=1) for off in self.whitened(state)]


@dataclass(frozen=True)
class Task:
    """What a search is given, whatever its start."""

    views: Sequence[View]
    known: Known
    lens: tuple[str, ...]
    poses: Ints  # (m,) pose of each view
    moved: Moved
    rho: Sequence[
        Array
    ]  # For each view (N,) distance of its stars from the middle of the beam, over its radius

    def posed(self, start: Start) -> tuple[Problem, State]:
        """Return the problem about a start, and its first state."""
        known, passport = self.known, self.known.passport
        camera = Camera(self.views[0].image_size, start.f_px, self.lens)
        reference = start.centre
        if passport is not None and passport.reference is not None:
            reference = passport.reference
        fields = Fields.of(self.views, reference)
        if passport is not None and FIELD_RADIUS in passport.conditions:
            fields = replace(fields, radius_mm=float(passport.conditions[FIELD_RADIUS]))
        first = np.unique(self.poses, return_index=True)[1]
        turned = Poses.of(start.rotations[first])
        lever = self.moved.lever(turned.tangents, fields.r0, known.bound)
        far = 1.0 if self.moved.by_hand else lever.far
        places = self.moved.places(start.centre[2]) if self.moved.by_hand else None
        table = Glass(camera, fields, turned, known, self.moved, places, far).table()
        readings = Readings.added(table, known.readings, start.rotations) if known.readings else None
        unknowns, own = table.ended(), own_of(table, self.moved)
        kept = {*unknowns.amplitudes, *own.amplitudes, amp.STAR, amp.READING, amp.ENCODER}
        discs = [self.moved.of_poses[pose] if self.moved.of_poses else None for pose in self.poses]
        stars = [
            Stars.of(view, fields, rho, disc)
            for view, rho, disc in zip(self.views, self.rho, discs, strict=True)
        ]
        problem = Problem(
            tuple(stars),
            camera,
            fields,
            self.poses,
            turned,
            unknowns,
            own,
            self.moved,
            places,
            readings,
            expected(kept, lever, far),
            lever,
        )
        return problem, _first(problem, start)


def _first(problem: Problem, start: Start) -> State:
    """Return the state that a start is."""
    unknowns = problem.unknowns
    b = np.zeros(len(unknowns.names))
    b[: len(start.camera)] = start.camera
    fields, begin = problem.fields, {"radial": np.array([start.glass, 0.0])}
    begin["x y"] = (np.array(start.centre[:2]) - fields.middle) / fields.r0
    begin["r"] = np.array([np.log(start.centre[2] / fields.r0)])
    for name, values in begin.items():
        at = unknowns.places(name)
        b[at] = values[: len(at)]
    stated = unknowns.places("passport")  # which states those that have no place of their own
    b[stated] = unknowns.mean[stated]
    return State(b, np.zeros((problem.n, len(problem.own.size))), start.rotations)
