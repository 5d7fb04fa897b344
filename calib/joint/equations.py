"""The linearised stars and readings of each view, compressed to small matrices.

A star moves with the basis c of its pose (camera, radius, one field) and with the rotation w of its view. What a
rotation does is projected out of all columns of a view (least squares in the metric of its stars), so that nothing
cancels later: the stars say ``J' c = e'`` and, apart, ``w = w_e - G c``. A reading says where w lies, and therefore
``G c + J_g g = y``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import mapped
from calib.arrays import Array
from calib.joint.effects.effect import Turned
from calib.joint.effects.gimbal import GimbalErrors
from calib.joint.effects.rim import BEYOND, Rim, about_disc, by_middle
from calib.joint.layout import Layout
from calib.joint.readings import Readings
from calib.model.camera import CameraModel
from calib.model.gimbal import GIMBAL, Gimbal
from calib.model.rim_fit import Disc
from calib.model.rotation import exp_map
from calib.view import View

#: Near the rim the noise of the stars is sqrt(1 + (c rho^12)^2) times larger, rho in radii of the disc. In the
#: published recordings it is 1.1 times larger at 0.8, 3 times at 0.92, 14 times at 1.05. These c are tried.
_RIM_NOISE_POWER = 12
_RIM_NOISES = np.concatenate([[0.0], np.geomspace(0.25, 32.0, 15)])
#: The noise at the rim counts so many times: it is alike in neighbouring stars and in other poses, and the smooth
#: fields take a part of it. Left-out poses of the published recordings are predicted a seventh better than with 1.
_RIM_ALIKE = 2.0
#: So many px rho^24 are added to it always. The fields can take the displacements of a few stars that all poses see at
#: the rim, and then no noise would be left to see: on the shipped station, cx was wrong by up to 3 sigma.
_RIM_EDGE_PX = 1.0
#: No residual counts as longer than this when c is looked for, sigmas of its noise: one gross error would decide.
_LONGEST = 10.0
#: Stars beyond this number of sigma lose their weight, with the sixth power of the distance.
_LIMIT_SIGMAS = 3.5
#: Smallest median length of the residuals, sigmas: points without any noise all count.
_LEAST_LENGTH = 1e-9
#: Steps to the best rotations.
_ALIGNMENTS = 2
#: Stars whose places agree to so many decimals of a millimetre are the same.
_SAME_STAR = 6
_NOTHING = 1e-30
#: Median length of a residual of two components over their sigma.
_RAYLEIGH_MEDIAN = 1.1774


@dataclass(frozen=True)
class State:
    """A point of the search: all unknowns."""

    shared: Array  # (S,)
    fields: Array  # (n, F) own fields of the poses
    rotations: Array  # (m, 3, 3) of the views, camera <- target
    gimbal: Gimbal | None = None


@dataclass(frozen=True)
class RimNoise:
    """Noise at the rim of the disc, in the px in which the noise of the stars is stated."""

    wide_px: float = 0.0  # Times rho^12
    edge_px: float = 0.0  # Times rho^24


@dataclass(frozen=True)
class ViewStars:
    """What does not change of a view."""

    target_mm: Array  # (N, 2)
    points_px: Array  # (N, 2)
    whitening: Array  # (N, 2, 2) W with W^T W the inverse covariance
    polynomials: Array  # (N, K)
    disc: Disc | None
    sigma_px: Array  # (N,) stated noise of each star: its covariance's geometric mean
    at_rim: Array  # (N,) rho^12, rho in radii of the disc; 0 without one

    @classmethod
    def of(cls, view: View, layout: Layout, disc: Disc | None = None) -> ViewStars:
        """Return the fixed part of a view."""
        whitening = np.linalg.inv(np.linalg.cholesky(view.covariances_px2))
        sigma_px = np.linalg.det(whitening) ** -0.5
        at_rim = np.zeros(len(view))
        if disc is not None:
            rho = np.hypot(*(view.target_mm - disc.centre_mm).T) / disc.radius_mm
            at_rim = np.minimum(rho, BEYOND) ** _RIM_NOISE_POWER
        polynomials = layout.basis.polynomials(view.target_mm)
        return cls(view.target_mm, view.points_px, whitening, polynomials, disc, sigma_px, at_rim)

    def precision(self, rim: RimNoise) -> Array:
        """Return (N,) how precise stars are, 1 in the disc's middle."""
        added = (rim.wide_px * self.at_rim) ** 2 + (rim.edge_px * self.at_rim**2) ** 2
        return np.asarray(1.0 / (1.0 + added / self.sigma_px**2))


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
    lengths: tuple[Array, ...]  # For each view (N,) whitened lengths of the residuals
    weights: tuple[Array, ...]  # For each view (N,) robust weights times its share and the precisions
    precisions: tuple[Array, ...]  # For each view (N,) of `ViewStars.precision`
    rim: RimNoise
    shares: Array  # (m,) share of each view that is new; 1 without repeats of a pose
    of_views: Array  # (m, B, B) what each view adds to ``squares``
    right_of_views: Array  # (m, B) what each view adds to ``right``

    @cached_property
    def observed(self) -> float:
        """Number of star coordinates, each with its robust weight."""
        return sum(2.0 * float((w / p).sum()) for w, p in zip(self.weights, self.precisions, strict=True))

    @cached_property
    def logarithm(self) -> float:
        """Logarithms of the precisions of all star coordinates."""
        pairs = zip(self.weights, self.precisions, strict=True)
        return sum(2.0 * float((w / p) @ np.log(p)) for w, p in pairs)


@dataclass(frozen=True)
class Bench:
    """All that the search reads: stars, readings, layout, poses."""

    layout: Layout
    image_size: tuple[int, int]
    stars: tuple[ViewStars, ...]
    poses: NDArray[np.int64]  # (m,) pose of each view
    times: Array  # (m,) when the views were recorded, 0 the first and 1 the last
    readings: Readings | None
    turns: Array  # (n, 2) tangents of each pose's turn along X and Y; data, so that no step changes them
    axes: Array  # (n, 2, 2) the camera's x and y axes on the target; data as well
    # (n, 2) place of the pupil in the beam, in sines of a turn that would bring it there.
    pupils: Array
    discs: tuple[Disc, ...] = ()  # Visible disc of each view, if the rim is in view

    @cached_property
    def maps(self) -> Array:
        """(n, B, S) what the shared unknowns do to the bases of the poses."""
        return self.layout.maps(Turned(self.turns, self.axes, self.pupils))

    @cached_property
    def n_poses(self) -> int:
        """Number of poses."""
        return int(self.poses.max()) + 1

    @cached_property
    def usual_sigma_px(self) -> float:
        """Median stated noise of the stars."""
        return float(np.median(np.concatenate([star.sigma_px for star in self.stars])))

    @property
    def gimbal(self) -> tuple[str, ...]:
        """Names of the gimbal's unknowns."""
        return self.layout.names_of(GimbalErrors)

    @cached_property
    def gimbal_places(self) -> NDArray[np.int64]:
        """Places of the gimbal's unknowns."""
        return self.layout.places(self.gimbal)

    @cached_property
    def _rows(self) -> list[slice]:
        """Rows of each view among those of all stars."""
        ends = np.cumsum([len(star.points_px) for star in self.stars]).tolist()
        return [slice(end - len(star.points_px), end) for end, star in zip(ends, self.stars, strict=True)]

    @cached_property
    def _points_px(self) -> Array:
        """(N, 2) the stars of all views."""
        return np.concatenate([star.points_px for star in self.stars])

    @cached_property
    def _factors(self) -> Array:
        """(2, 2, N) the whitening of all stars, for `mapped`."""
        return np.ascontiguousarray(
            np.concatenate([star.whitening for star in self.stars]).transpose(1, 2, 0)
        )

    def _of_views(self, values: Array) -> list[Array]:
        """Return values (N, ...) of all stars for each view."""
        return [values[rows] for rows in self._rows]

    def camera(self, shared: Array) -> CameraModel:
        """Return the camera of given shared unknowns."""
        names = self.layout.pose.camera
        lens = dict(zip(names[4:], shared[4 : len(names)].tolist(), strict=True))
        fx, fy, cx, cy = shared[:4].tolist()
        return CameraModel(fx, fy, cx, cy, self.image_size, lens)

    def named_gimbal(self, shared: Array) -> dict[str, float]:
        """Return the gimbal's unknowns by name."""
        return dict(zip(self.gimbal, shared[self.gimbal_places].tolist(), strict=True))

    def fields(self, state: State) -> Array:
        """Return (n, 2, K) the coefficients of each pose's field; the shift by the centre is in it."""
        field = self.layout.pose.field
        whole, own = self.maps[:, field] @ state.shared, self.layout.own_of(field)
        whole[:, self.layout.own.places[own] - field.start] += state.fields[:, own]
        return np.asarray(whole.reshape(self.n_poses, 2, -1))

    def points(self, state: State) -> list[Array]:
        """Return for each view (N, 3) its displaced stars, from the centre, in the target's axes, mm."""
        fields = self.fields(state)
        return [self._points(v, state, fields) for v in range(len(self.stars))]

    def _points(self, v: int, state: State, fields: Array) -> Array:
        """Return (N, 3) the displaced stars of a view, as `points`."""
        star = self.stars[v]
        depth = self.maps[self.poses[v], self.layout.pose.radius] @ state.shared
        moved = self.layout.basis.reference[2] * star.polynomials @ fields[self.poses[v]].T
        if self.layout.pose.about_disc and star.disc is not None:
            moved += about_disc(star.disc, star.target_mm, self._middle(v, state)) @ self._rims(v, state)
        return np.column_stack([star.target_mm + moved, np.full(len(moved), depth)])

    def _rims(self, v: int, state: State) -> Array:
        """Return (R,) the sizes of the displacements about the middle of a view's disc."""
        own = state.fields[self.poses[v], self.layout.own_of(self.layout.pose.rim)]
        return np.asarray(state.shared[self.layout.places(self.layout.names_of(Rim))] + own)

    def _middle(self, v: int, state: State) -> Array:
        """Return (2,) the middle of a view's disc from where it was found, in sigmas."""
        return np.asarray(state.fields[self.poses[v], self.layout.own_of(self.layout.pose.middle)])

    def view_residuals(self, state: State, v: int) -> Array:
        """Return (N, 2) the residuals of one view, as `residuals`."""
        fields = self.fields(state)
        points = self._points(v, state, fields)
        return self.stars[v].points_px - self.camera(state.shared).project(points @ state.rotations[v].T)

    def _in_camera(self, state: State) -> Array:
        """Return (N, 3) the stars of all views in the camera's axes, mm."""
        of_views = zip(self.points(state), state.rotations, strict=True)
        return np.concatenate([points @ rotation.T for points, rotation in of_views])

    def _off_px(self, state: State) -> Array:
        """Return (N, 2) the residuals of the stars of all views, as `residuals`."""
        return np.asarray(self._points_px - self.camera(state.shared).project(self._in_camera(state)))

    def residuals(self, state: State) -> list[Array]:
        """Return for each view (N, 2) image points found minus predicted, px; NaN behind the camera."""
        return self._of_views(self._off_px(state))

    def whitened(self, state: State) -> list[Array]:
        """Return for each view (N,) the lengths of the residuals over their sigma."""
        return self._of_views(np.hypot(*mapped(self._factors, self._off_px(state).T)))

    def aligned(self, state: State, weights: Sequence[Array]) -> State:
        """Return the state with the rotations that fit the weighted stars best, by Gauss and Newton; all else stays."""
        camera, roots = self.camera(state.shared), np.sqrt(np.concatenate(list(weights)))
        for _ in range(_ALIGNMENTS):
            in_camera = self._in_camera(state)
            predicted, by_point, _ = camera.project_with_jacobians(in_camera)
            slopes = roots * mapped(self._factors, _by_turn(in_camera, by_point.transpose(2, 1, 0)))
            left = roots * mapped(self._factors, (self._points_px - predicted).T)
            turns = np.zeros((len(self.stars), 3))
            for v, own in enumerate(self._rows):
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

    def linearised(self, state: State, limit: float, before: Equations | None = None) -> Equations:
        """Return the equations; ``limit`` is the stars' sigma over the stated one; weights are those of ``before``."""
        in_camera = self._in_camera(state)
        predicted, by_point, by_camera = self.camera(state.shared).project_with_jacobians(in_camera)
        residuals = mapped(self._factors, (self._points_px - predicted).T)
        lengths = np.where(in_camera[:, 2] > 0.0, np.hypot(*residuals), np.nan)
        of_views = self._of_views(lengths)
        rim = before.rim if before else self._rim_noise(of_views)
        precisions = tuple(star.precision(rim) for star in self.stars)
        weights = before.weights if before else _weights(of_views, limit, precisions)
        slopes = mapped(self._factors, np.concatenate([by_camera, by_point], axis=2).transpose(2, 1, 0))
        views = [
            self._view(v, state, in_camera[rows], residuals[:, rows], slopes[:, :, rows], weights[v])
            for v, rows in enumerate(self._rows)
        ]
        shares = before.shares if before else self._shares(views)
        views = views if before else [view.times(share) for view, share in zip(views, shares, strict=True)]
        squares, right = np.array([view.squares for view in views]), np.array([view.right for view in views])
        turned = np.array([view.turned for view in views])
        off, jacobian = np.zeros((0, 3)), np.zeros((0, 3, 0))
        if self.readings is not None and state.gimbal is not None:
            off = self.readings_off(state) + turned
            jacobian = self.readings.jacobian(state.gimbal, self.named_gimbal(state.shared))
        return Equations(
            self.by_pose(squares),
            self.by_pose(right),
            sum(view.cost for view in views),
            np.array([view.turn for view in views]),
            np.array([view.coupling for view in views]),
            turned,
            self.maps,
            off,
            jacobian,
            tuple(view.lengths for view in views),
            tuple(view.weights for view in views),
            precisions,
            rim,
            shares,
            squares,
            right,
        )

    def by_pose(self, values: Array) -> Array:
        """Return (n, ...) the sums over the views of each pose of (m, ...) values."""
        if len(values) == self.n_poses:
            return values
        sums = np.zeros((self.n_poses, *values.shape[1:]))
        np.add.at(sums, self.poses, values)
        return sums

    def _rim_noise(self, lengths: Sequence[Array]) -> RimNoise:
        """Return `_RIM_ALIKE` times the most probable noise at the rim of the visible discs; none without discs."""
        if not self.discs:
            return RimNoise()
        spread = robust_sigma(lengths)
        scaled = (np.concatenate(lengths) / spread) ** 2
        costs, edge_px = [], _RIM_EDGE_PX / spread
        usual = self.usual_sigma_px
        for size in usual * _RIM_NOISES:
            own = np.concatenate([star.precision(RimNoise(size, edge_px)) for star in self.stars])
            costs.append(float(np.minimum(own * scaled, _LONGEST**2).sum()) - 2.0 * float(np.log(own).sum()))
        return RimNoise(_RIM_ALIKE * usual * float(_RIM_NOISES[np.argmin(costs)]), edge_px)

    def _shares(self, view_equations: Sequence[_ViewEquations]) -> Array:
        """Return (m,) the share of each view that is new: 1 / (1 + (n - 1) rho) in a pose of n views.

        rho is the correlation of the residuals of one star in the views of a pose: what no smooth field holds, an error
        at the rim or of finding this star, comes again in each repeat. n views of correlation rho determine what they
        have in common as well as n times this share (Kish, 1965, design effect).
        """
        views = np.bincount(self.poses)
        if (views == 1).all():
            return np.ones(len(self.poses))
        both, pairs = 0.0, 0.0
        for pose in np.flatnonzero(views > 1):
            members = np.flatnonzero(self.poses == pose).tolist()
            places = np.round(np.concatenate([self.stars[v].target_mm for v in members]), _SAME_STAR)
            star = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1)
            roots = np.sqrt(np.concatenate([view_equations[v].weights for v in members]))
            residuals = roots[:, None] * np.concatenate([view_equations[v].residuals for v in members])
            sums = [np.bincount(star, column) for column in (*residuals.T, roots)]
            both += float((sums[0] ** 2 + sums[1] ** 2).sum() - (residuals**2).sum())
            pairs += float((sums[2] ** 2).sum() - (roots**2).sum())
        squares = sum(float(view.weights @ view.lengths**2) for view in view_equations)
        alike = (
            both * sum(float(view.weights.sum()) for view in view_equations) / max(pairs * squares, _NOTHING)
        )
        return np.asarray(1.0 / (1.0 + (views[self.poses] - 1) * min(max(alike, 0.0), 1.0)))

    def _view(
        self, v: int, state: State, in_camera: Array, residuals: Array, slopes: Array, weights: Array
    ) -> _ViewEquations:
        """Linearise the N stars of one view.

        residuals: (2, N), whitened. slopes: (P + 3, 2, N) their changes by the camera and by the points in its axes.
        """
        star, pose, rotation = self.stars[v], self.layout.pose, state.rotations[v]
        size, k = pose.size, len(slopes) - 3
        root = np.sqrt(weights)
        by_point = root * slopes[k:]
        by_star = np.tensordot(rotation, by_point, (0, 0))
        columns = np.empty((size + 4, 2, len(weights)))
        np.multiply(root, slopes[:k], out=columns[:k])
        columns[k] = by_star[2]
        if pose.about_disc and star.disc is not None:
            middle = self._middle(v, state)
            moved = about_disc(star.disc, star.target_mm, middle)
            columns[pose.rim] = np.einsum("acn,nar->rcn", by_star[:2], moved)
            along = by_middle(star.disc, star.target_mm, middle).transpose(0, 1, 3, 2) @ self._rims(v, state)
            columns[pose.middle] = np.einsum("acn,nad->dcn", by_star[:2], along)
        fields = columns[pose.field].reshape(2, -1, 2, len(weights))
        across_mm = pose.fields.reference[2] * by_star[:2]
        np.multiply(across_mm[:, None], star.polynomials.T[:, None], out=fields)
        np.multiply(root, residuals, out=columns[size])
        columns[size + 1 :] = _by_turn(in_camera, by_point)
        rows = columns.reshape(size + 4, -1)
        q, upper = np.linalg.qr(rows[size + 1 :].T)
        across = rows[: size + 1] @ q
        own = rows[: size + 1] - across @ q.T
        whole = own @ own.T
        solved = np.linalg.solve(upper, across.T)
        return _ViewEquations(
            whole[:size, :size],
            whole[:size, size],
            float(whole[size, size]),
            upper.T @ upper,
            solved[:, :size],
            solved[:, size],
            np.hypot(*residuals),
            weights,
            residuals.T,
        )

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


@dataclass(frozen=True)
class _ViewEquations:
    """The compressed stars of one view; see `Equations`."""

    squares: Array
    right: Array
    cost: float
    turn: Array
    coupling: Array
    turned: Array
    lengths: Array
    weights: Array
    residuals: Array  # (N, 2) whitened

    def times(self, share: float) -> _ViewEquations:
        """Return the same stars with a share of their weights."""
        return replace(
            self,
            squares=share * self.squares,
            right=share * self.right,
            cost=share * self.cost,
            turn=share * self.turn,
            weights=share * self.weights,
        )


def _by_turn(in_camera: Array, by_point: Array) -> Array:
    """Return (3, 2, N) changes of the image by a rotation, from those by (N, 3) points in the camera, (3, 2, N)."""
    (x, y, z), (by_x, by_y, by_z) = in_camera.T, by_point
    return np.array([y * by_z - z * by_y, z * by_x - x * by_z, x * by_y - y * by_x])


def _weights(lengths: Sequence[Array], limit: float, precisions: Sequence[Array]) -> list[Array]:
    """Return for each view (N,) the weights of the stars: robust ones times their precision near the rim."""
    return [
        own * robust_weights(np.sqrt(own) * length, limit)
        for own, length in zip(precisions, lengths, strict=True)
    ]


def robust_weights(lengths: Array, limit: float) -> Array:
    """Return the weights of stars: 1 for small residuals, falling smoothly beyond 3.5 sigma."""
    return np.asarray(1.0 / (1.0 + (lengths / (_LIMIT_SIGMAS * limit)) ** 6))


def robust_sigma(lengths: Sequence[Array]) -> float:
    """Return the sigma of the stars over the stated one, from the median length of their residuals."""
    return max(float(np.median(np.concatenate(list(lengths)))), _LEAST_LENGTH) / _RAYLEIGH_MEDIAN


def turns_of(rotations: Array, poses: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return turns and axes of each pose, those of its first view, from (m, 3, 3) rotations and (m,) poses."""
    first = np.unique(poses, return_index=True)[1]
    own = rotations[first]
    return own[:, 2, :2] / own[:, 2, 2:], own[:, :2, :2]


def sines_of(turns: Array) -> Array:
    """Return the (n, 2) sines of turns, from their tangents. A pupil before the pivot moves in proportion to them."""
    return np.asarray(turns / np.sqrt(1.0 + (turns**2).sum(axis=1, keepdims=True)))
