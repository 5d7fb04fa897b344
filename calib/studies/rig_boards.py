"""Boards at finite distance that two cameras of a rig saw at once: the adjustment of both cameras, the rig, the boards.

Bundle adjustment (Triggs et al., 2000) by Gauss-Newton steps; the boards' poses are eliminated. The noise of the points
is scaled by what each camera alone leaves, so that points without a stated uncertainty are weighed rightly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.errors import DegenerateViews
from calib.model.camera import CameraModel
from calib.model.rotation import exp_map, nearest_rotation, skew
from calib.view import View

Array = NDArray[np.float64]

_MIN_POINTS = 6
_IN_A_LINE = 1e-6
_ROUNDS = 60
_SMALL = 1e-3
"""Last step, in sigmas."""
_SINGULAR = 1e-13
_POSE_STEPS = 5
_HALVINGS = 12
_NOISE_ROUNDS = 3


@dataclass(frozen=True)
class BoardPair:
    """One board in the images of both cameras."""

    first: View
    second: View


@dataclass(frozen=True)
class BoardsFound:
    """The end of the adjustment."""

    first: CameraModel
    second: CameraModel
    rotation: Array  # (3, 3) second <- first
    translation: Array  # (3,) mm
    covariance: Array  # (G, G) of the values of both cameras, rotation vector, translation
    rms_px: Array  # (m, 2)
    together: Array  # (m,) sum of squares of each board, whitened
    apart: Array  # (m,) the same if each camera had its own pose of the board
    converged: bool


@dataclass(frozen=True)
class _State:
    cameras: tuple[CameraModel, CameraModel]
    rotation: Array
    translation: Array
    turns: Array  # (m, 3, 3) first camera <- board
    places: Array  # (m, 3) mm
    away: Array  # (G,) from where the prior lies

    def moved(self, shared: Array, own: Array) -> _State:
        """Return the state after a step. shared: (G,). own: (m, 6) rotation vector and place."""
        k = len(self.cameras[0].values)
        first, second = self.cameras
        return _State(
            (
                first.with_values(first.values + shared[:k]),
                second.with_values(second.values + shared[k:-6]),
            ),
            exp_map(shared[-6:-3]) @ self.rotation,
            self.translation + shared[-3:],
            exp_map(own[:, :3]) @ self.turns,
            self.places + own[:, 3:],
            self.away + shared,
        )


def adjusted(
    first: CameraModel,
    second: CameraModel,
    rotation: Array | None,
    information: Array,
    pairs: Sequence[BoardPair],
) -> BoardsFound:
    """Return cameras, rig, with the rotation second <- first, and their covariance.

    ``information`` is (G, G), of both cameras' values, rotation vector and translation, about the start.
    Raises DegenerateViews: If a view has too few points, or the boards do not determine the rig.
    """
    for pair in pairs:
        for view in (pair.first, pair.second):
            if len(view) < _MIN_POINTS:
                raise DegenerateViews(
                    f"The view {view.name} has {len(view)} points of the board; at least {_MIN_POINTS} are needed."
                )
    alone = [
        [_pose(camera, view) for camera, view in ((first, pair.first), (second, pair.second))]
        for pair in pairs
    ]
    found = _start((first, second), rotation, alone)
    points = np.array([[len(pair.first), len(pair.second)] for pair in pairs])
    left = 2.0 * points.sum(axis=0) - 6 * len(pairs)
    apart = _apart(found, pairs)
    for _ in range(_NOISE_ROUNDS):
        noise = np.sqrt(apart.sum(axis=0) / left)
        found, covariance, squares, converged = _searched(found, pairs, information, noise)
        now = _apart(found, pairs)
        apart = np.where(
            now.sum(axis=0) < apart.sum(axis=0), now, apart
        )  # cameras that were bent to fit count not
    return BoardsFound(
        *found.cameras,
        found.rotation,
        found.translation,
        covariance,
        _rms_px(found, pairs),
        squares.sum(axis=1),
        (apart / noise**2).sum(axis=1),
        converged,
    )


def _apart(state: _State, pairs: Sequence[BoardPair]) -> Array:
    """Return the (m, 2) sums of squares of each board with a pose for each camera alone, in units of the stated noise.

    What is left there is noise, also if the rig is not rigid.
    """
    return np.array(
        [
            [
                _alone(camera, view)
                for camera, view in zip(state.cameras, (pair.first, pair.second), strict=True)
            ]
            for pair in pairs
        ]
    )


def _start(
    cameras: tuple[CameraModel, CameraModel],
    rotation: Array | None,
    alone: Sequence[Sequence[tuple[Array, Array]]],
) -> _State:
    """Return a start from the poses that each camera finds alone; medians, since a flat board may be seen turned."""
    pairs = np.array([turn_b @ turn_a.T for (turn_a, _), (turn_b, _) in alone])
    if rotation is None:
        apart = np.arccos(np.clip((np.einsum("iab,jab->ij", pairs, pairs) - 1.0) / 2.0, -1.0, 1.0))
        rotation = nearest_rotation(pairs[np.median(apart, axis=1).argmin()])
    places = np.array([place - rotation @ at for (_, at), (_, place) in alone])
    return _State(
        cameras,
        rotation,
        np.median(places, axis=0),
        np.array([turn for (turn, _), _ in alone]),
        np.array([at for (_, at), _ in alone]),
        np.zeros(sum(len(camera.values) for camera in cameras) + 6),
    )


def _pose(camera: CameraModel, view: View) -> tuple[Array, Array]:
    """Return rotation and translation from the board to the camera, in closed form (Collins and Bartoli, 2014)."""
    rays = camera.rays(view.points_px)
    seen = np.isfinite(rays).all(axis=1)
    flat = np.column_stack([view.target_mm, np.zeros(len(view))])[seen]
    spread = (
        np.linalg.svd(flat - flat.mean(axis=0), compute_uv=False) if len(flat) >= _MIN_POINTS else np.zeros(2)
    )
    plane = np.ascontiguousarray(rays[seen, :2] / rays[seen, 2:])
    done = bool(spread[1] > _IN_A_LINE * spread[0])
    if done:
        done, vector, place = cv2.solvePnP(flat, plane, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    if not done:
        raise DegenerateViews(
            f"The view {view.name} does not show how the board stands.",
            remedy="Show more of the board, and check that the calibration is of this camera.",
        )
    return exp_map(np.asarray(vector.ravel(), np.float64)), np.asarray(place.ravel(), np.float64)


def _whitening(view: View, sigma: float) -> Array:
    """Return (N, 2, 2) factors that make the noise of the points one."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(view.covariances_px2)) / sigma)


def _equations(state: _State, at: int, view: View, which: int, sigma: float) -> tuple[Array, Array, Array]:
    """Return (2N,) whitened residuals of a board in one image, and their (2N, G) and (2N, 6) slopes."""
    arm = view.target_mm @ state.turns[at][:, :2].T
    points, by_own = arm + state.places[at], np.zeros((len(view), 3, 6))
    by_own[:, :, :3], by_own[:, :, 3:] = -skew(arm), np.eye(3)
    by_rig = np.zeros((len(view), 3, 6))
    if which:
        turned = points @ state.rotation.T
        by_rig[:, :, :3], by_rig[:, :, 3:] = -skew(turned), np.eye(3)
        points, by_own = turned + state.translation, state.rotation @ by_own
    pixels, by_points, by_camera = state.cameras[which].project_with_jacobians(points)
    k = [len(camera.values) for camera in state.cameras]
    shared = np.zeros((len(view), 2, sum(k) + 6))
    shared[:, :, which * k[0] : which * k[0] + k[which]] = by_camera
    shared[:, :, -6:] = by_points @ by_rig
    white = _whitening(view, sigma)
    residual = np.einsum("nab,nb->na", white, view.points_px - pixels)
    return (
        residual.ravel(),
        (white @ shared).reshape(2 * len(view), -1),
        (white @ by_points @ by_own).reshape(-1, 6),
    )


def _residuals(state: _State, pairs: Sequence[BoardPair], noise: Array) -> Array:
    """Return the (m, 2) sums of squares of each board in each image; infinite behind a camera."""
    squares = np.empty((len(pairs), 2))
    for at, pair in enumerate(pairs):
        for which, view in enumerate((pair.first, pair.second)):
            points = view.target_mm @ state.turns[at][:, :2].T + state.places[at]
            if which:
                points = points @ state.rotation.T + state.translation
            off = view.points_px - state.cameras[which].project(points)
            white = np.einsum("nab,nb->na", _whitening(view, noise[which]), off)
            squares[at, which] = np.nan_to_num((white**2).sum(), nan=np.inf)
    return squares


def _searched(
    state: _State, pairs: Sequence[BoardPair], information: Array, noise: Array
) -> tuple[_State, Array, Array, bool]:
    """Return the optimum, the (G, G) covariance, the (m, 2) sums of squares, and whether it is an optimum."""
    squares, damping = _residuals(state, pairs, noise), 1e-6
    for _ in range(_ROUNDS):
        cost = squares.sum() + state.away @ information @ state.away
        normal, right, follow, back = _normal_equations(state, pairs, noise)
        normal, right = normal + information, right - information @ state.away
        covariance = _inverse(normal)
        for _ in range(_HALVINGS):
            shared: Array = np.asarray(
                np.linalg.solve(normal + damping * np.diag(np.diag(normal)), right), np.float64
            )
            moved = state.moved(shared, back - follow @ shared)
            squares = _residuals(moved, pairs, noise)
            if squares.sum() + moved.away @ information @ moved.away <= cost * (1.0 + 1e-12):
                break
            damping = max(10.0 * damping, 1e-4)
        else:
            break
        state, damping = moved, damping / 10.0
        if np.sqrt(shared @ normal @ shared / len(shared)) < _SMALL:
            return state, covariance, squares, True
    return state, covariance, _residuals(state, pairs, noise), False


def _normal_equations(
    state: _State, pairs: Sequence[BoardPair], noise: Array
) -> tuple[Array, Array, Array, Array]:
    """Return (G, G) and (G,) equations of the shared unknowns, and the (m, 6, G) and (m, 6) of the boards' poses.

    Elimination of the poses: Triggs et al. (2000), section 6.
    """
    size = len(state.away)
    normal, right = np.zeros((size, size)), np.zeros(size)
    follow, back = np.empty((len(pairs), 6, size)), np.empty((len(pairs), 6))
    for at, pair in enumerate(pairs):
        parts = [_equations(state, at, view, c, noise[c]) for c, view in enumerate((pair.first, pair.second))]
        off, shared, own = (np.concatenate(part) for part in zip(*parts, strict=True))
        inverse = np.linalg.inv(own.T @ own)
        follow[at], back[at] = inverse @ own.T @ shared, inverse @ own.T @ off
        normal += shared.T @ shared - shared.T @ own @ follow[at]
        right += shared.T @ off - shared.T @ own @ back[at]
    return normal, right, follow, back


def _inverse(information: Array) -> Array:
    """Return the covariance, or raise `DegenerateViews` if the boards leave an unknown free."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    unit = information / np.outer(scale, scale)
    if np.linalg.eigvalsh(unit)[0] < _SINGULAR:
        raise DegenerateViews(
            "The boards do not determine the rig.",
            remedy="Show the board at more angles and distances to both cameras.",
        )
    return np.asarray(np.linalg.inv(unit) / np.outer(scale, scale))


def _alone(camera: CameraModel, view: View) -> float:
    """Return the sum of squares of a board with a pose for this camera alone."""
    turn, place = _pose(camera, view)
    nothing = np.zeros(2 * len(camera.values) + 6)
    state = _State((camera, camera), np.eye(3), np.zeros(3), turn[None], place[None], nothing)
    for _ in range(_POSE_STEPS):
        off, _, own = _equations(state, 0, view, 0, 1.0)
        step: Array = np.asarray(np.linalg.lstsq(own, off)[0], np.float64)
        state = state.moved(nothing, step[None])
    off, _, _ = _equations(state, 0, view, 0, 1.0)
    return float(off @ off)


def _rms_px(state: _State, pairs: Sequence[BoardPair]) -> Array:
    """Return the (m, 2) root mean square lengths of the residuals, px."""
    plain = [
        BoardPair(*(replace(view, covariances_px2=np.tile(np.eye(2), (len(view), 1, 1))) for view in views))
        for views in ((pair.first, pair.second) for pair in pairs)
    ]
    numbers = np.array([[len(pair.first), len(pair.second)] for pair in pairs])
    return np.asarray(np.sqrt(_residuals(state, plain, np.ones(2)) / numbers))
