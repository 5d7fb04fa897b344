"""Choice of the next pose during a measurement: what each possible pose would add to the poses already recorded.

The information of the views adds up (`calib.studies.expected_posterior`). The gimbal's angles of a possible pose become
the rotation that the camera will see, by a gimbal model fitted to the poses recorded so far.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.parameters import SAME_POSE_DEG
from calib.errors import TooFewStars
from calib.model.gimbal_readings import AXES
from calib.model.rotation import euler_zxy, log_map, nearest_rotation
from calib.studies.expected_posterior import PoseGains, Sigmas, distance_deg, share_of_news, with_distortion
from calib.studies.gimbal_model import GimbalModel as ReadGimbal
from calib.studies.hand_eye_fit import starts
from calib.studies.predicted_views import ExpectedBench, predicted_view, rim_share
from calib.view import View

Array = NDArray[np.float64]
Angles = Mapping[str, float]

_MIN_VIEWS = 3
_MOVED_DEG = 0.5
#: Number of closed forms among the starts of the hand-eye fit.
_CLOSED_FORMS = 3


@dataclass(frozen=True)
class GimbalModel:
    """The rotation that the camera sees for given angles of the gimbal: R = A Rz(roll) Rx(tilt) Ry(pan) B."""

    camera_from_head: Array  # (3, 3) float64 rotation A, camera <- gimbal's head
    base_from_target: Array  # (3, 3) float64 rotation B, gimbal's base <- target

    def rotation(self, angles_deg: Angles) -> Array:
        """Return the rotation, camera <- target, at a pose.

        angles_deg: ``pan_deg``, ``tilt_deg``, ``roll_deg``, degrees; missing angles are zero.
        Returns: (3, 3) rotation.
        """
        return np.asarray(self.camera_from_head @ _head(angles_deg) @ self.base_from_target)


def fit_gimbal_model(rotations: Array, readings_deg: Sequence[Angles]) -> GimbalModel:
    """Fit the model of the gimbal to the poses recorded so far, well enough to predict what a pose shows.

    If three or more views turned about two axes, both rotations come from closed forms (`calib.studies.hand_eye_fit`;
    Park and Martin, 1994), without a fit of the gimbal's errors. Otherwise, or if they do not follow the views, the
    camera is assumed to be mounted straight, and only the base is fitted: the mean of the rotations that the views
    give, projected on the rotations (Moakher, 2002).

    rotations: (n, 3, 3) rotations of the views, camera <- target.
    readings_deg: For each view, ``pan_deg``, ``tilt_deg``, ``roll_deg``, degrees; missing angles are zero.
    Returns: The model; without views, a gimbal that stands straight before the target.
    """
    if not len(rotations):
        return GimbalModel(np.eye(3), np.eye(3))
    heads = np.array([_head(angles) for angles in readings_deg])
    straight = np.eye(3), nearest_rotation(np.mean(np.swapaxes(heads, 1, 2) @ rotations, axis=0))
    angles = np.array([[reading.get(axis, 0.0) for axis in AXES] for reading in readings_deg])
    if len(rotations) < _MIN_VIEWS or (np.ptp(angles, axis=0) > _MOVED_DEG).sum() < 2:
        return GimbalModel(*straight)
    read = ReadGimbal(angles, ())
    pairs = [*islice(starts(rotations, read, read.start, 0), _CLOSED_FORMS), straight]
    return GimbalModel(*min(pairs, key=lambda pair: _mean_off(rotations, heads, *pair)))


def _mean_off(rotations: Array, heads: Array, camera_from_head: Array, base_from_target: Array) -> float:
    """Return the mean square angle between rotations seen and rotations read, rad^2."""
    read = camera_from_head @ heads @ base_from_target
    return float((log_map(rotations @ np.swapaxes(read, 1, 2)) ** 2).sum(axis=1).mean())


@dataclass(frozen=True)
class WeighedPose:
    """What a possible pose would add."""

    angles_deg: Angles  # Angles of the gimbal, degrees
    after: Sigmas
    rim_share: float  # Share of the rim of the beam's disc that would be in view, 0 to 1


class PoseWeigher:
    """Weighs possible poses against the poses recorded so far.

    Uncertainties are those of the joint adjustment for the expected amplitudes. The discount for neighbouring poses is
    this project's own.

    bench: Bench as it is known now: camera and collimator of the last calibration, or the expected ones.
    taken_deg: Angles of the poses recorded so far, degrees.
    refused_deg: Angles of the poses that failed, degrees.
    min_stars: Fewest stars that a pose must show.
    """

    def __init__(
        self,
        bench: ExpectedBench,
        gimbal: GimbalModel,
        taken_deg: Sequence[Angles],
        *,
        refused_deg: Sequence[Angles] = (),
        min_stars: int = 0,
    ) -> None:
        self._bench = with_distortion(bench)
        self._gimbal = gimbal
        self._taken = tuple(taken_deg)
        self._refused = tuple(refused_deg)
        self._min_stars = min_stars
        views = [self._view(pose) for pose in self._taken]
        self._shown = [
            (pose, view) for pose, view in zip(self._taken, views, strict=True) if view is not None
        ]
        self._news = np.array(
            [
                share_of_news(self._taken[i], self._taken[:i])
                for i, view in enumerate(views)
                if view is not None
            ]
        )
        self.before: Sigmas | None = None
        if self._shown:
            gains = self._gains(self._shown)
            self.before = gains.sigmas(gains.covariance(self._news))

    def possible(self, candidates_deg: Iterable[Angles]) -> list[Angles]:
        """Return the poses that show enough of the target and repeat no recorded or failed pose.

        candidates_deg: Poses, degrees.
        Returns: The possible ones, in their order.
        """
        return [pose for pose in candidates_deg if self._possible_view(pose) is not None]

    def weigh(self, candidates_deg: Iterable[Angles]) -> list[WeighedPose]:
        """Return what each possible pose would add.

        candidates_deg: Poses, degrees; those that are not possible are left out.
        Returns: The possible poses, in their order.
        """
        shown = [(pose, view) for pose in candidates_deg if (view := self._possible_view(pose)) is not None]
        if not shown:
            return []
        gains = self._gains([*self._shown, *shown])
        known = gains.covariance(self._news)
        return [
            WeighedPose(
                pose,
                gains.with_pose(known, len(self._shown) + k, share_of_news(pose, self._taken)),
                rim_share(self._bench, self._gimbal.rotation(pose)),
            )
            for k, (pose, _) in enumerate(shown)
        ]

    def _possible_view(self, pose: Angles) -> View | None:
        if any(distance_deg(pose, other) < SAME_POSE_DEG for other in (*self._taken, *self._refused)):
            return None
        view = self._view(pose)
        return view if view is not None and len(view) >= self._min_stars else None

    def _view(self, pose: Angles) -> View | None:
        """Return the stars that a pose shows; None if it shows too few."""
        try:
            angles = _equivalent_angles(self._gimbal.rotation(pose))
            return predicted_view(self._bench, angles, "possible")[0]
        except TooFewStars:
            return None

    def _gains(self, shown: Sequence[tuple[Angles, View]]) -> PoseGains:
        """Return what the views of some poses say."""
        poses = [pose for pose, _ in shown]
        rotations = np.array([self._gimbal.rotation(pose) for pose in poses])
        return PoseGains(self._bench, [view for _, view in shown], rotations, poses)


def _head(angles_deg: Angles) -> Array:
    """Return the (3, 3) rotation of the gimbal's head at a pose."""
    return euler_zxy(
        angles_deg.get("pan_deg", 0.0), angles_deg.get("tilt_deg", 0.0), angles_deg.get("roll_deg", 0.0)
    )


def _equivalent_angles(rotation: Array) -> dict[str, float]:
    """Return pan, tilt and roll of a gimbal that stands straight and gives this rotation, degrees.

    With R = Rz(roll) Rx(tilt) Ry(pan), the last row of R is (-sin(pan) cos(tilt), sin(tilt), cos(pan) cos(tilt)), and
    its second column is (-sin(roll) cos(tilt), cos(roll) cos(tilt), sin(tilt)).
    """
    tilt = np.arcsin(np.clip(rotation[2, 1], -1.0, 1.0))
    pan = np.arctan2(-rotation[2, 0], rotation[2, 2])
    roll = np.arctan2(-rotation[0, 1], rotation[1, 1])
    return {
        "pan_deg": float(np.degrees(pan)),
        "tilt_deg": float(np.degrees(tilt)),
        "roll_deg": float(np.degrees(roll)),
    }
