"""Boards at finite distance that two cameras of a rig saw at once: the adjustment of both cameras, the rig, the boards.

Each camera has a bundle of the boards with free centres (`calib.adjustment.bundle`). The pose of a board before the
second camera follows from that before the first one and from the rig, so the equations of the second bundle are mapped
to these. The noise of the points is scaled by what each camera alone leaves, so that points without a stated
uncertainty are weighed rightly. A board that looks the same after half a turn is numbered from either end: the poses of
all boards together tell which end of the second camera's boards is that of the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from calib.adjustment.bundle import Bundle, Observations, ViewEquations
from calib.adjustment.initialization import pose_start
from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array, Bools, rms_length
from calib.boards.board import Board
from calib.errors import DegenerateViews, InputMismatch, NotConverged
from calib.model.camera import CameraModel, require_image_size
from calib.model.rotation import exp_map, nearest_rotation, skew
from calib.one_thread import on_one_thread
from calib.studies.rig import Rig, common_names
from calib.uncertainty.covariance import inverse_information
from calib.view import View

_MIN_POINTS = 6  # Twice as many coordinates as a pose has unknowns
_NOISE_ROUNDS = 3  # Noise and poses depend on each other: each round begins where the last one ended
#: Another numbering of a board must agree with the other boards so many times better.
_DECIDES = 3.0
#: A pose contradicts the rig if both cameras together fit it so many times worse than each alone.
_CONTRADICTS = 5.0


@dataclass(frozen=True)
class _State:
    """Both cameras with the poses of the m boards before each; the second ones follow from the rig."""

    first: AdjustmentParameters
    camera: CameraModel  # The second one
    rotation: Array
    translation: Array
    away: Array  # (G,) from where the prior lies

    @property
    def second(self) -> AdjustmentParameters:
        """The boards before the second camera: P = rotation R (X - c) + translation."""
        rotations = self.rotation @ self.first.rotations
        offsets = self.first.offsets - self.translation @ rotations
        return replace(self.first, camera=self.camera, rotations=rotations, offsets=offsets)

    def after_step(self, names: Sequence[str], shared: Array, local: Array) -> _State:
        """Return the state after a step. shared: (G,). local: (m + 1, 6); the last row is that of the prior."""
        k = len(self.first.camera.values)
        return _State(
            self.first.after_step(names[:k], shared[:k], local[:-1]),
            self.camera.with_values(self.camera.values + shared[k:-6]),
            exp_map(shared[-6:-3]) @ self.rotation,
            self.translation + shared[-3:],
            self.away + shared,
        )


@dataclass(frozen=True)
class _Boards:
    """What is adjusted: (G, G) information of what is known before, and the boards in both images."""

    information: Array
    first: Bundle
    second: Bundle

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the G shared unknowns: values of both cameras, rotation vector and translation of the rig."""
        rig = ("turn_x", "turn_y", "turn_z", "x", "y", "z")
        return (*self.first.names, *self.second.names, *rig)

    def squares(self, state: _State) -> Array:
        """Return the (m, 2) sums of squares of each board in each image; NaN behind a camera."""
        return _squares((self.first, self.second), (state.first, state.second))

    def equations(self, state: _State, loss: Loss) -> ViewEquations:
        """Return the normal equations; the prior stands as a board of its own, whose pose does not matter.

        The second camera's poses follow from a turn t and a shift s of the board before the first camera, a turn u and
        a shift v of the rig: they turn by R t + u, and their centres move by s + R_2^T ((R t + u) x T - v).
        """
        first, second = self.first, self.second
        k, size, boards = len(first.names), len(self.information), len(state.first.rotations)
        normal, right = np.zeros((boards + 1, size + 6, size + 6)), np.zeros((boards + 1, size + 6))
        to = np.zeros((boards, len(second.names) + 6, size + 6))
        to[:, : len(second.names), k : size - 6] = np.eye(len(second.names))
        turns = np.hstack([np.eye(3), np.zeros((3, 3)), state.rotation, np.zeros((3, 3))])
        back = np.swapaxes(state.second.rotations, 1, 2)
        to[:, -6:-3, -12:] = turns
        to[:, -3:, -12:] = -back @ skew(state.translation) @ turns
        to[:, -3:, -9:-6] -= back
        to[:, -3:, -3:] += np.eye(3)
        other = second.equations(state.second, loss)
        normal[:-1] = np.swapaxes(to, 1, 2) @ other.normal @ to
        right[:-1] = np.einsum("mab,ma->mb", to, other.right)
        own, at = first.equations(state.first, loss), np.r_[0:k, size : size + 6]
        normal[:-1, at[:, None], at] += own.normal
        right[:-1, at] += own.right
        normal[-1, :size, :size], normal[-1, size:, size:] = self.information, np.eye(6)
        right[-1, :size] = -self.information @ state.away
        prior = 0.5 * state.away @ self.information @ state.away
        return ViewEquations(normal, right, size, np.append(own.costs + other.costs, prior))

    def rounding(self, cost: float) -> float:
        """Return how much rounding of the image points changes the cost."""
        return max(self.first.rounding(cost), self.second.rounding(cost))

    def covariance(self, state: _State) -> Array:
        """Return the (G, G) covariance of the shared unknowns at the optimum; `DegenerateViews` if there is none."""
        try:
            known = self.equations(state, Loss("l2")).eliminated().information.sum(axis=0)
            return inverse_information(known, self.names)
        except DegenerateViews as error:
            raise DegenerateViews(
                "The boards do not determine the rig.",
                remedy="Show the board at more angles and distances to both cameras.",
            ) from error


@on_one_thread
def with_boards(
    start: Rig,
    first: Sequence[View],
    second: Sequence[View],
    board: Board | None = None,
    *,
    free: bool = False,
) -> Rig:
    """Adjust the rig to boards that both cameras saw at once; if ``free``, intrinsics are only a start.

    ``start`` is what is known of the cameras, and of the rotation if it has poses behind a collimator. If ``board`` is
    symmetric, the second camera may have numbered it from its other end.
    Raises DegenerateViews: If no board was seen by both, a view has too few points, or the boards do not determine the
      rig.
    Raises InputMismatch: If image sizes differ, or a board was not seen at the same time by both.
    """
    cameras = start.first, start.second
    for camera, views in zip(cameras, (first, second), strict=True):
        for view in views:
            require_image_size(camera, view.image_size, f"the view {view.name} has")
    by_name = [{view.name: view for view in views} for views in (first, second)]
    names = common_names(*(list(centres) for centres in by_name))
    seen = [[centres[name] for name in names] for centres in by_name]
    known = len(start.covariance) > sum(len(camera.values) for camera in cameras)
    turned = np.zeros(len(names), bool)
    if board is not None and board.symmetric:
        turned = _numbered_from_the_other_end(cameras, seen, start.rotation if known else None)
        seen[1] = [
            _half_turned(view, board) if end else view for view, end in zip(seen[1], turned, strict=True)
        ]
    of_cameras = np.zeros_like(start.covariance) if free else np.linalg.inv(start.covariance)
    information = linalg.block_diag(of_cameras, np.zeros((3 if known else 6,) * 2))
    bundles, alone = zip(*(_alone(*pair) for pair in zip(cameras, seen, strict=True)), strict=True)
    state = _start(alone, start.rotation if known else None, len(information))
    left = 2.0 * np.array([len(bundle.observations.view) for bundle in bundles]) - 6 * len(names)
    apart = _apart(bundles, alone)
    for _ in range(_NOISE_ROUNDS):
        noise = np.sqrt(apart.sum(axis=0) / left)
        boards = _Boards(information, *map(_with_noise, bundles, noise))
        refined = refine(boards, state, Loss("l2"))
        state = refined.parameters
        now = _apart(bundles, (state.first, state.second))
        # Cameras that were bent to fit count not.
        apart = np.where(now.sum(axis=0) < apart.sum(axis=0), now, apart)
    covariance = boards.covariance(state)
    _require_one_time(names, boards.squares(state).sum(axis=1), (apart / noise**2).sum(axis=1))
    if not refined.converged:
        raise NotConverged(
            "The calculation of the rig did not come to an end.", remedy="Show the board at more angles."
        )
    return replace(
        start,
        first=state.first.camera,
        second=state.camera,
        rotation=state.rotation,
        translation_mm=state.translation,
        covariance=covariance,
        boards=names,
        boards_rms_px=_rms_px(bundles, (state.first, state.second)),
        half_turned=tuple(name for name, end in zip(names, turned, strict=True) if end),
    )


def _numbered_from_the_other_end(
    cameras: Sequence[CameraModel], seen: Sequence[Sequence[View]], rotation: Array | None
) -> Bools:
    """Tell for (m,) boards whether the second camera numbered them from the other end than the first.

    On one rig all boards give one rotation between the cameras, which ``rotation`` is if it is known. The numbering as
    it is stays unless another one is decidedly better: boards that are all parallel decide nothing.
    """
    first, second = (_alone(*pair)[1].rotations for pair in zip(cameras, seen, strict=True))
    back = np.swapaxes(first, 1, 2)
    # As numbered, and half turned.
    pairs = np.array([second @ back, second @ np.diag([-1.0, -1.0, 1.0]) @ back])
    rigs = pairs if rotation is None else np.broadcast_to(rotation, (1, 1, 3, 3))
    cosines = (np.einsum("rkab,eiab->rkei", rigs, pairs) - 1.0) / 2.0
    angles = np.arccos(np.clip(cosines, -1.0, 1.0))  # (rig, its board, end, board)
    spread = np.median(angles.min(axis=2), axis=2)
    best = spread.argmin(axis=1)
    end = 1 if len(rigs) > 1 and _DECIDES * spread[1, best[1]] < spread[0, best[0]] else 0
    as_numbered, turned = angles[end, best[end]]
    return np.asarray(_DECIDES * turned < as_numbered, bool)


def _half_turned(view: View, board: Board) -> View:
    """Return a view of a board that is numbered from the other end."""
    last = board.points_mm[-1] + board.points_mm[0]
    return replace(view, ids=len(board.nodes) - 1 - view.ids, target_mm=last - view.target_mm)


def _require_one_time(names: Sequence[str], together: Array, apart: Array) -> None:
    """Refuse boards that moved: (m,) sums of squares with one pose for both cameras, and with one for each."""
    times = np.sqrt(together / np.maximum(apart, np.median(apart)))
    if (times > _CONTRADICTS).any():
        worst = int(times.argmax())
        raise InputMismatch(
            f"{int((times > _CONTRADICTS).sum())} of {len(names)} boards do not fit one rig: at {names[worst]}, both"
            f" cameras together fit {times[worst]:.0f} times worse than each alone.",
            remedy="Record both cameras at the same time; keep the rig rigid, and give equal names to equal times.",
        )


def _rms_px(bundles: Sequence[Bundle], seen: Sequence[AdjustmentParameters]) -> Array:
    """Return the (m, 2) root mean square residuals of each board in each image, px."""
    residuals_px = [
        [rms_length(bundle.residuals_px(own)[rows]) for rows in bundle.observations.slices]
        for bundle, own in zip(bundles, seen, strict=True)
    ]
    return np.transpose(residuals_px)


def _squares(bundles: Sequence[Bundle], seen: Sequence[AdjustmentParameters]) -> Array:
    """Return the (m, 2) sums of squares of each board in each image, in units of the bundles' noise."""
    pairs = zip(bundles, seen, strict=True)
    return 2.0 * np.column_stack([bundle.costs(own, Loss("l2")) for bundle, own in pairs])


def _with_noise(bundle: Bundle, sigma: float) -> Bundle:
    """Return the bundle of points whose noise is so many times the stated one."""
    seen = bundle.observations
    return replace(bundle, observations=replace(seen, whitening=seen.whitening / sigma))


def _alone(camera: CameraModel, views: Sequence[View]) -> tuple[Bundle, AdjustmentParameters]:
    """Return the boards before a camera, and their poses from each image alone."""
    poses = []
    for view in views:
        if len(view) < _MIN_POINTS:
            raise DegenerateViews(
                f"The view {view.name} has {len(view)} points of the board; at least {_MIN_POINTS} are needed."
            )
        pose = pose_start(camera, view)
        if pose is None:
            raise DegenerateViews(
                f"The view {view.name} does not show how the board stands.",
                remedy="Show more of the board, and check that the calibration is of this camera.",
            )
        poses.append(pose)
    bundle = Bundle(Observations.from_views(views), camera.parameter_names, free_centres=True)
    rotations = np.concatenate([pose.rotations for pose in poses])
    offsets = np.concatenate([pose.offsets for pose in poses])
    return bundle, replace(poses[0], rotations=rotations, offsets=offsets)


def _apart(bundles: Sequence[Bundle], seen: Sequence[AdjustmentParameters]) -> Array:
    """Return the (m, 2) sums of squares of each board with a pose for each camera alone, in units of the stated noise.

    What is left there is noise, also if the rig is not rigid.
    """
    held = [replace(bundle, names=()) for bundle in bundles]
    ends = [refine(bundle, own, Loss("l2")).parameters for bundle, own in zip(held, seen, strict=True)]
    return _squares(held, ends)


def _start(alone: Sequence[AdjustmentParameters], rotation: Array | None, size: int) -> _State:
    """Return a start from the poses that each camera finds alone; medians, since a flat board may be seen turned."""
    first, second = alone
    pairs = second.rotations @ np.swapaxes(first.rotations, 1, 2)
    if rotation is None:
        apart = np.arccos(np.clip((np.einsum("iab,jab->ij", pairs, pairs) - 1.0) / 2.0, -1.0, 1.0))
        rotation = nearest_rotation(pairs[np.median(apart, axis=1).argmin()])
    at, there = (-np.einsum("nij,nj->ni", of_camera.rotations, of_camera.offsets) for of_camera in alone)
    return _State(first, second.camera, rotation, np.median(there - at @ rotation.T, axis=0), np.zeros(size))
