"""The linearised stars and readings of each view, compressed to small matrices.

A star moves with the basis c of its pose (camera, radius, one field) and with the rotation w of its view. What a
rotation does is projected out of all columns of a view (least squares in the metric of its stars), so that nothing
cancels later: the stars say ``J' c = e'`` and, apart, ``w = w_e - G c``. A reading says where w lies, and therefore
``G c + J_g g = y``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import mapped
from calib.arrays import Array
from calib.joint.effects.effect import Places, Turned
from calib.joint.effects.gimbal import GimbalErrors
from calib.joint.fields import DEGREE
from calib.joint.layout import Layout
from calib.joint.readings import Readings
from calib.joint.stars import RimNoise, Stars, robust_weights
from calib.model.camera import CameraModel
from calib.model.gimbal import GIMBAL, Gimbal
from calib.model.rotation import exp_map

#: Steps to the best rotations.
_ALIGNMENTS = 2
#: Stars whose places agree to so many decimals of a millimetre are the same.
_SAME_STAR = 6


@dataclass(frozen=True)
class State:
    """A point of the search: all unknowns."""

    shared: Array  # (S,)
    fields: Array  # (n, F) own fields of the poses
    rotations: Array  # (m, 3, 3) of the views, camera <- target
    gimbal: Gimbal | None = None


@dataclass(frozen=True)
class Equations:
    """The linearised observations at a state, with unit amplitudes."""

    squares: Array  # (n, B, B) star information of each pose's basis, rotations projected out
    right: Array  # (n, B) its right-hand side
    cost: float  # Weighted square sum of the stars' residuals, rotations at their best
    turns: Array  # (m, 3, 3) star information of each rotation
    coupling: Array  # (m, 3, B) G of each view
    turned: Array  # (m, 3) rotation vectors to the stars' best rotation
    maps: Array  # (n, B, S) bases of the poses by the shared unknowns
    off: Array  # (m, 3) readings to the stars' best rotation, rad; no rows without readings
    gimbal: Array  # (m, 3, g) change of the predicted rotations
    lengths: Array  # (N,) whitened lengths of the residuals
    weights: Array  # (N,) robust weights times the share that is new and the precision
    precisions: Array  # (N,) of `Stars.precision`
    rim: RimNoise
    shares: Array  # (m,) mean share of the stars of each view that is new
    of_views: Array  # (m, B, B) what each view adds to ``squares``
    right_of_views: Array  # (m, B) what each view adds to ``right``

    @cached_property
    def observed(self) -> float:
        """Number of star coordinates, each with its robust weight."""
        return 2.0 * float((self.weights / self.precisions).sum())

    @cached_property
    def logarithm(self) -> float:
        """Logarithms of the precisions of all star coordinates."""
        return 2.0 * float((self.weights / self.precisions) @ np.log(self.precisions))


@dataclass(frozen=True)
class Bench:
    """All that the search reads: stars, readings, layout, poses."""

    layout: Layout
    image_size: tuple[int, int]
    stars: Stars
    poses: NDArray[np.int64]  # (m,) pose of each view
    times: Array  # (m,) when the views were recorded, 0 the first and 1 the last
    readings: Readings | None
    turns: Array  # (n, 2) tangents of each pose's turn along X and Y; data, so that no step changes them
    axes: Array  # (n, 2, 2) the camera's x and y axes on the target; data as well
    # (n, 2) place of the pupil in the beam, in sines of a turn that would bring it there.
    pupils: Array

    @cached_property
    def maps(self) -> Array:
        """(n, B, S) what the shared unknowns do to the bases of the poses."""
        return self.layout.maps(Turned(self.turns, self.axes, self.pupils))

    @cached_property
    def n_poses(self) -> int:
        """Number of poses."""
        return int(self.poses.max()) + 1

    @property
    def gimbal(self) -> tuple[str, ...]:
        """Names of the gimbal's unknowns."""
        return self.layout.names_of(GimbalErrors)

    @cached_property
    def gimbal_places(self) -> NDArray[np.int64]:
        """Places of the gimbal's unknowns."""
        return self.layout.places(self.gimbal)

    def camera(self, shared: Array) -> CameraModel:
        """Return the camera of given shared unknowns."""
        names = self.layout.pose.camera
        lens = dict(zip(names[4:], shared[4 : len(names)].tolist(), strict=True))
        fx, fy, cx, cy = shared[:4].tolist()
        return CameraModel(fx, fy, cx, cy, self.image_size, lens)

    def named_gimbal(self, shared: Array) -> dict[str, float]:
        """Return the gimbal's unknowns by name."""
        return dict(zip(self.gimbal, shared[self.gimbal_places].tolist(), strict=True))

    def _bases(self, state: State) -> Array:
        """Return (n, B) the basis of each pose."""
        bases = (self.maps.reshape(-1, len(state.shared)) @ state.shared).reshape(self.maps.shape[:2])
        bases[:, self.layout.own.places] += state.fields
        return np.asarray(bases)

    def _about_discs(self, bases: Array) -> tuple[Array, Array]:
        """Return (N, 2) the middles of the stars' discs, in sigmas, and (N, R) sizes of displacements about them."""
        poses = self.poses[self.stars.views]
        return bases[poses, self.layout.pose.middle], bases[poses, self.layout.pose.rim]

    def _in_camera(self, state: State) -> Array:
        """Return (N, 3) the displaced stars of all views, from the centre, in the camera's axes, mm."""
        stars, pose = self.stars, self.layout.pose
        bases = self._bases(state)
        fields = pose.fields.reference[2] * bases[:, pose.field].reshape(self.n_poses, 2, -1)
        points = np.empty((len(stars.views), 3))
        points[:, :2] = stars.target_mm
        for rows, of_pose in zip(stars.rows, self.poses, strict=True):
            points[rows, :2] += stars.polynomials[rows] @ fields[of_pose].T
            points[rows, 2] = bases[of_pose, pose.radius]
        if pose.about_disc:
            middles, sizes = self._about_discs(bases)
            points[:, :2] += (stars.around_discs.displaced(middles) @ sizes[:, :, None])[:, :, 0]
        for rows, rotation in zip(stars.rows, state.rotations, strict=True):
            points[rows] = points[rows] @ rotation.T
        return points

    def residuals(self, state: State) -> Array:
        """Return (N, 2) image points found minus predicted, px; NaN behind the camera."""
        return np.asarray(self.stars.points_px - self.camera(state.shared).project(self._in_camera(state)))

    def whitened(self, state: State) -> Array:
        """Return (N,) the lengths of the residuals over their sigma."""
        return np.asarray(np.hypot(*mapped(self.stars.whitening, self.residuals(state).T)))

    def aligned(self, state: State, weights: Array) -> State:
        """Return the state with the rotations that fit the weighted stars best, by Gauss and Newton; all else stays."""
        camera, roots, stars = self.camera(state.shared), np.sqrt(weights), self.stars
        for _ in range(_ALIGNMENTS):
            in_camera = self._in_camera(state)
            predicted, by_point, _ = camera.project_with_jacobians(in_camera)
            slopes = roots * mapped(stars.whitening, _by_turn(in_camera, by_point.transpose(2, 1, 0)))
            left = roots * mapped(stars.whitening, (stars.points_px - predicted).T)
            turns = np.zeros((len(stars.rows), 3))
            for v, own in enumerate(stars.rows):
                if (in_camera[own, 2] > 0).all():
                    rows = slopes[:, :, own].reshape(3, -1)
                    turns[v] = np.linalg.solve(rows @ rows.T, rows @ left[:, own].reshape(-1))
            state = replace(state, rotations=exp_map(turns) @ state.rotations)
        return state

    def readings_off(self, state: State) -> Array:
        """Return (m, 3) rotation vectors from the gimbal's predictions to the rotations, rad."""
        assert self.readings is not None
        assert state.gimbal is not None
        named = self.named_gimbal(state.shared)
        return self.readings.off(state.gimbal, named, state.rotations)

    def linearised(
        self,
        state: State,
        limit: float = 1.0,
        before: Equations | None = None,
        entries: Places | None = None,
        *,
        is_near: bool = False,
    ) -> Equations:
        """Return the equations; ``limit`` is the stars' sigma over the stated one; weights are those of ``before``.

        ``is_near``: only near the optimum, residuals show what neighbours share.
        Only some ``entries`` of the bases may be asked for: all others are zero then.
        """
        stars = self.stars
        in_camera = self._in_camera(state)
        predicted, by_point, by_camera = self.camera(state.shared).project_with_jacobians(in_camera)
        residuals = mapped(stars.whitening, (stars.points_px - predicted).T)
        lengths = np.where(in_camera[:, 2] > 0.0, np.hypot(*residuals), np.nan)
        rim = before.rim if before else stars.rim_noise(lengths)
        precisions = before.precisions if before else stars.precision(rim)
        if before:
            weights, shares = before.weights, before.shares
        else:
            weights = precisions * robust_weights(np.sqrt(precisions) * lengths, limit)
            new = self._new(weights, residuals, neighbours=is_near)
            weights = new * weights
            shares = np.bincount(stars.views, new) / np.bincount(stars.views)
        slopes = mapped(stars.whitening, np.concatenate([by_camera, by_point], axis=2).transpose(2, 1, 0))
        views = self._compressed(state, in_camera, residuals, slopes, weights, entries)
        off, jacobian = np.zeros((0, 3)), np.zeros((0, 3, 0))
        if self.readings is not None and state.gimbal is not None:
            off = self.readings_off(state) + views.turned
            jacobian = self.readings.jacobian(state.gimbal, self.named_gimbal(state.shared))
        return Equations(
            self.by_pose(views.squares),
            self.by_pose(views.right),
            float(views.cost.sum()),
            views.turn,
            views.coupling,
            views.turned,
            self.maps,
            off,
            jacobian,
            lengths,
            weights,
            precisions,
            rim,
            shares,
            views.squares,
            views.right,
        )

    def by_pose(self, values: Array) -> Array:
        """Return (n, ...) the sums over the views of each pose of (m, ...) values."""
        if len(values) == self.n_poses:
            return values
        sums = np.zeros((self.n_poses, *values.shape[1:]))
        np.add.at(sums, self.poses, values)
        return sums

    @cached_property
    def _alike(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(N,) the star that each is, and its cell of the target: half the shortest wave of a field. Both of a pose."""
        stars, basis = self.stars, self.layout.basis
        cells = np.round((stars.target_mm - basis.reference[:2]) * (DEGREE / basis.radius_mm))
        star, cell = (
            np.unique(np.column_stack([self.poses[stars.views], places]), axis=0, return_inverse=True)[1]
            for places in (np.round(stars.target_mm, _SAME_STAR), cells)
        )
        return star.reshape(-1), cell.reshape(-1)

    def _new(self, weights: Array, residuals: Array, *, neighbours: bool) -> Array:
        """Return (N,) the share of each star that is new: 1 / (1 + (n - 1) rho) of n stars that are alike.

        rho is the correlation of their whitened residuals (2, N). What no smooth field holds comes again: an error of
        finding a star in each repeat of its pose; fine errors of the glass in its neighbours, as far as these show less
        noise than all stars have. n of correlation rho determine what they have in common as well as n times this share
        (Kish, 1965, design effect).
        """
        roots, whole = np.sqrt(weights), float(weights.sum())
        weighted = roots * residuals
        squares = max(float((weighted**2).sum()), np.finfo(float).eps ** 2 * whole)  # 0 in a forecast
        star, cell = self._alike
        products, pairs = _of_pairs(star, weighted, roots)
        rho = products / squares * whole / max(pairs, 1.0)
        times = 1.0 + (np.bincount(star)[star] - 1) * max(0.0, min(1.0, rho))
        if neighbours:
            of_glass = 1.0 - 2.0 * self.stars.local**2 * whole / squares
            in_cell = _of_pairs(cell, weighted, roots)
            rho = (in_cell[0] - products) / squares * whole / max(in_cell[1] - pairs, 1.0)
            others = np.bincount(cell, 1.0 / times)[cell] - 1.0
            times = times * (1.0 + others * max(0.0, min(of_glass, rho)))
        return np.asarray(1.0 / times)

    def _compressed(
        self,
        state: State,
        in_camera: Array,
        residuals: Array,
        slopes: Array,
        weights: Array,
        entries: Places | None,
    ) -> _ViewEquations:
        """Linearise the N stars of all views, and compress each view.

        residuals: (2, N), whitened. slopes: (P + 3, 2, N) their changes by the camera and by the points in its axes.
        """
        stars, pose, size, k = self.stars, self.layout.pose, self.layout.pose.size, len(slopes) - 3
        roots = np.sqrt(weights)
        slopes = roots * slopes
        by_star = np.einsum("nia,icn->acn", state.rotations[stars.views], slopes[k:])
        across_mm = pose.fields.reference[2] * by_star[:2]
        last = np.concatenate([(roots * residuals)[None], _by_turn(in_camera, slopes[k:])])
        about, middles = self._by_discs(state, by_star) if pose.about_disc else (slopes[:0], slopes[:0])
        if entries is None:
            entries = np.arange(size)
        kept = np.append(entries, size + np.arange(4))
        views = _ViewEquations.zeros(len(stars.rows), size)
        for v, rows in enumerate(stars.rows):
            columns = np.empty((size + 4, 2, rows.stop - rows.start))
            columns[:k], columns[k] = slopes[:k, :, rows], by_star[2, :, rows]
            columns[pose.rim], columns[pose.middle] = about[:, :, rows], middles[:, :, rows]
            fields = columns[pose.field].reshape(2, -1, *columns.shape[1:])
            np.multiply(across_mm[:, None, :, rows], stars.polynomials[rows].T[:, None], out=fields)
            columns[size:] = last[:, :, rows]
            views.add(v, columns.reshape(size + 4, -1)[kept], entries)
        return views

    def _by_discs(self, state: State, by_star: Array) -> tuple[Array, Array]:
        """Return (R, 2, N), (2, 2, N) changes by displacements about the discs and by their middles.

        by_star: (3, 2, N) those by the stars on the target.
        """
        middles, sizes = self._about_discs(self._bases(state))
        around = self.stars.around_discs
        about, along = around.displaced(middles), around.by_middle(middles, sizes)
        return tuple(np.einsum("acn,nar->rcn", by_star[:2], slopes) for slopes in (about, along))

    def moved(self, state: State, shared: Array, fields: Array, rotations: Array) -> State:
        """Return the state after steps: (S,) shared, (n, F) fields, (m, 3) rotation vectors on the camera's side."""
        values = state.shared + shared
        gimbal = state.gimbal
        if gimbal is not None:
            steps = dict(zip(self.gimbal, shared[self.gimbal_places].tolist(), strict=True))
            gimbal = gimbal.after_step({name: steps[name] for name in GIMBAL if name in steps})
            turned = [
                k
                for k, name in zip(self.gimbal_places, self.gimbal, strict=True)
                if name.startswith(("mounting", "standing"))
            ]
            values[turned] = 0.0
        return State(values, state.fields + fields, exp_map(rotations) @ state.rotations, gimbal)


class _ViewEquations(NamedTuple):
    """The compressed stars of m views; see `Equations`."""

    squares: Array  # (m, B, B)
    right: Array  # (m, B)
    cost: Array  # (m,)
    turn: Array  # (m, 3, 3)
    coupling: Array  # (m, 3, B)
    turned: Array  # (m, 3)

    @classmethod
    def zeros(cls, m: int, size: int) -> _ViewEquations:
        """Return m views without stars."""
        shapes = (size, size), (size,), (), (3, 3), (3, size), (3,)
        return cls(*(np.zeros((m, *shape)) for shape in shapes))

    def add(self, v: int, rows: Array, entries: Places) -> None:
        """Set a view from its rows: those of the K entries of its basis, of the residuals, and of the rotation."""
        size = len(entries)
        q, upper = np.linalg.qr(rows[size + 1 :].T)
        across = rows[: size + 1] @ q
        own = rows[: size + 1] - across @ q.T
        whole, solved = own @ own.T, np.linalg.solve(upper, across.T)
        self.squares[v, entries[:, None], entries] = whole[:size, :size]
        self.right[v, entries], self.cost[v] = whole[:size, size], whole[size, size]
        self.turn[v] = upper.T @ upper
        self.coupling[v][:, entries], self.turned[v] = solved[:, :size], solved[:, size]


def _of_pairs(at: NDArray[np.int64], weighted: Array, roots: Array) -> tuple[float, float]:
    """Return the sums of products of (2, N) residuals, and of (N,) roots, over all pairs within the same (N,) group."""
    sums = [np.bincount(at, row) for row in (*weighted, roots)]
    return (
        float((sums[0] ** 2 + sums[1] ** 2).sum() - (weighted**2).sum()),
        float((sums[2] ** 2).sum() - (roots**2).sum()),
    )


def _by_turn(in_camera: Array, by_point: Array) -> Array:
    """Return (3, 2, N) changes of the image by a rotation, from those by (N, 3) points in the camera, (3, 2, N)."""
    (x, y, z), (by_x, by_y, by_z) = in_camera.T, by_point
    return np.array([y * by_z - z * by_y, z * by_x - x * by_z, x * by_y - y * by_x])


def turns_of(rotations: Array, poses: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return turns and axes of each pose, those of its first view, from (m, 3, 3) rotations and (m,) poses."""
    first = np.unique(poses, return_index=True)[1]
    own = rotations[first]
    return own[:, 2, :2] / own[:, 2, 2:], own[:, :2, :2]


def sines_of(turns: Array) -> Array:
    """Return the (n, 2) sines of turns, from their tangents. A pupil before the pivot moves in proportion to them."""
    return np.asarray(turns / np.sqrt(1.0 + (turns**2).sum(axis=1, keepdims=True)))
