"""Choice of the next pose during a measurement: what each possible pose would add to the poses already recorded.

The information of the views adds up, as in `calib.studies.planning`. The gimbal's angles of a possible pose become the
rotation that the camera will see, by a gimbal model fitted to the poses recorded so far. Two neighbouring poses share
most errors of the collimator and of the pixel grid, so the information of a pose next to a recorded one counts less.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters
from calib.errors import CalibrationError, DegenerateViews, TooFewStars
from calib.model.collimator import CENTRE, Collimator
from calib.model.rotation import euler_zxy, nearest_rotation
from calib.studies.hand_eye import check_hand_eye
from calib.studies.predicted_views import ExpectedBench, predicted_view
from calib.uncertainty.covariance import inverse_information
from calib.uncertainty.passport_propagation import consider_covariance
from calib.uncertainty.projection_uncertainty import projection_derivatives
from calib.view import View

Array = NDArray[np.float64]
Angles = Mapping[str, float]

#: Distance at which two poses share about a third of their errors, degrees.
SHARED_ERROR_DEG = 1.5
#: Poses closer than this are repeats: the second one brings no new information, degrees.
REPEAT_DEG = 0.2
#: A fitted gimbal model is used if its rotations agree with those seen to this, arc seconds.
_POINTING_ARCSEC = 1800.0
_MIN_VIEWS = 3
_RIM_POINTS = 72
_GRID_POINTS = 9
_SMALLEST_EIGENVALUE = 1e-15


@dataclass(frozen=True)
class GimbalModel:
    """The rotation that the camera sees for given angles of the gimbal: R = A Rz(roll) Rx(tilt) Ry(pan) B.

    Attributes
    ----------
    camera_from_head
        (3, 3) float64 rotation A, camera <- gimbal's head.
    base_from_target
        (3, 3) float64 rotation B, gimbal's base <- target.
    """

    camera_from_head: Array
    base_from_target: Array

    def rotation(self, angles_deg: Angles) -> Array:
        """Return the rotation, camera <- target, at a pose.

        Parameters
        ----------
        angles_deg
            ``pan_deg``, ``tilt_deg``, ``roll_deg``, degrees; missing angles are zero.

        Returns
        -------
        Array
            (3, 3) rotation.
        """
        return np.asarray(self.camera_from_head @ _head(angles_deg) @ self.base_from_target)


def fit_gimbal_model(rotations: Array, covariance: Array, readings_deg: Sequence[Angles]) -> GimbalModel:
    """Fit the model of the gimbal to the poses recorded so far, well enough to predict what a pose shows.

    From three views on, both rotations are fitted (`calib.studies.hand_eye`). With fewer views, or if that fit does not
    follow the views, the camera is assumed to be mounted straight, and only the base is fitted: the mean of the
    rotations that the views give, projected on the rotations (Moakher, 2002).

    Parameters
    ----------
    rotations
        (n, 3, 3) rotations of the views, camera <- target.
    covariance
        (3 n, 3 n) joint covariance of their rotation vectors, rad^2.
    readings_deg
        For each view, ``pan_deg``, ``tilt_deg``, ``roll_deg``, degrees; missing angles are zero.

    Returns
    -------
    GimbalModel
        The model; without views, a gimbal that stands straight before the target.
    """
    if not len(rotations):
        return GimbalModel(np.eye(3), np.eye(3))
    if len(rotations) >= _MIN_VIEWS:
        try:
            check = check_hand_eye(rotations, covariance, readings_deg)
        except CalibrationError:  # no axis moved
            pass
        else:
            if check.rms_arcsec < _POINTING_ARCSEC:
                return GimbalModel(check.camera_from_head, check.base_from_target)
    bases = [_head(angles).T @ seen for angles, seen in zip(readings_deg, rotations, strict=True)]
    return GimbalModel(np.eye(3), nearest_rotation(np.mean(bases, axis=0)))


@dataclass(frozen=True)
class Sigmas:
    """Standard uncertainties that the star noise of some poses leaves; infinite if the poses do not suffice.

    Attributes
    ----------
    fx_px
        1-sigma of the focal length fx, px.
    worst_px
        Largest projection uncertainty over the sensor, 1 sigma, px.
    missing
        0 if the poses determine the camera; otherwise a measure, at least 1, of how far they are from that.
    """

    fx_px: float
    worst_px: float
    missing: float = 0.0


@dataclass(frozen=True)
class WeighedPose:
    """What a possible pose would add.

    Attributes
    ----------
    angles_deg
        Angles of the gimbal, degrees.
    after
        Uncertainties with this pose added.
    rim_share
        Share of the rim of the beam's disc that would be in view, 0 to 1.
    """

    angles_deg: Angles
    after: Sigmas
    rim_share: float


class PoseWeigher:
    """Weighs possible poses against the poses recorded so far.

    Uncertainties are those of star noise (Cramér-Rao bound; Rao, 1945), with a passport's values held as exact: the
    uncertainty of a passport is the same after every pose. The discount for neighbouring poses is this project's own.

    Parameters
    ----------
    bench
        Bench as it is known now: camera and collimator of the last calibration, or the expected ones.
    gimbal
        Model of the gimbal.
    taken_deg
        Angles of the poses recorded so far, degrees.
    refused_deg
        Angles of the poses that failed, degrees.
    min_stars
        Fewest stars that a pose must show.

    Attributes
    ----------
    before
        Uncertainties of the recorded poses.
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
        self._bench = bench
        self._gimbal = gimbal
        self._taken = tuple(taken_deg)
        self._refused = tuple(refused_deg)
        self._min_stars = min_stars
        self._names = (*bench.camera.parameter_names, *CENTRE)
        self._by_parameters = projection_derivatives(bench.camera, _GRID_POINTS)[1]
        self._known = np.zeros((len(self._names),) * 2)
        for i, pose in enumerate(self._taken):
            if (view := self._view(pose)) is not None:
                self._known += _share_of_news(pose, self._taken[:i]) * self._information(view, pose)
        self.before = self._sigmas(self._known)

    def possible(self, candidates_deg: Iterable[Angles]) -> list[Angles]:
        """Return the poses that show enough of the target and repeat no recorded or failed pose.

        Parameters
        ----------
        candidates_deg
            Poses, degrees.

        Returns
        -------
        list of Mapping
            The possible ones, in their order.
        """
        return [pose for pose in candidates_deg if self._possible_view(pose) is not None]

    def weigh(self, candidates_deg: Iterable[Angles]) -> list[WeighedPose]:
        """Return what each possible pose would add.

        Parameters
        ----------
        candidates_deg
            Poses, degrees; those that are not possible are left out.

        Returns
        -------
        list of WeighedPose
            The possible poses, in their order.
        """
        weighed = []
        for pose in candidates_deg:
            view = self._possible_view(pose)
            if view is None:
                continue
            news = _share_of_news(pose, self._taken) * self._information(view, pose)
            share = rim_share(self._bench, self._gimbal.rotation(pose))
            weighed.append(WeighedPose(pose, self._sigmas(self._known + news), share))
        return weighed

    def _possible_view(self, pose: Angles) -> View | None:
        if any(_distance_deg(pose, other) < REPEAT_DEG for other in (*self._taken, *self._refused)):
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

    def _information(self, view: View, pose: Angles) -> Array:
        """Return (G, G) information of a view on the shared parameters, with its rotation unknown."""
        centre = self._bench.collimator
        ideal = Collimator(centre.x, centre.y, centre.r)
        rotation = self._gimbal.rotation(pose)[None]
        bundle = Bundle(Observations.from_views([view]), self._names)
        parameters = AdjustmentParameters(self._bench.camera, ideal, rotation, np.zeros((1, 3)))
        ((information, _),) = bundle.scores(parameters, np.zeros((len(view), 2)))
        return np.asarray(information)

    def _sigmas(self, information: Array) -> Sigmas:
        """Return the uncertainties that this (G, G) information leaves, with a passport's values held as exact.

        With too little information, the logarithms of its eigenvalues, scaled to a unit diagonal, order the poses: the
        pose that determines the most directions is the best one (own substitute).
        """
        try:
            covariance = self._covariance(information)
        except DegenerateViews:
            scale = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
            eigenvalues = np.linalg.eigvalsh(information * np.outer(scale, scale))
            missing = -np.log(np.clip(eigenvalues, _SMALLEST_EIGENVALUE, 1.0)).sum()
            return Sigmas(np.inf, np.inf, 1.0 + float(missing))
        left = self._by_parameters
        size = left.shape[2]
        variances = left @ covariance[:size, :size] @ np.swapaxes(left, 1, 2)
        worst = float(np.linalg.eigvalsh(variances)[:, 1].max())
        fx = self._names.index("fx")
        return Sigmas(float(np.sqrt(covariance[fx, fx])), float(np.sqrt(max(worst, 0.0))))

    def _covariance(self, information: Array) -> Array:
        """Return the (G, G) covariance that this information leaves; raises DegenerateViews if it is too little."""
        if self._bench.passport is None:
            return inverse_information(information, self._names)
        passport = self._bench.passport.subset(CENTRE)
        exact = replace(passport, covariance=0.0 * passport.covariance)
        return consider_covariance(information, self._names, exact)


def rim_share(bench: ExpectedBench, rotation: Array) -> float:
    """Return the share of the rim of the beam's disc that is in view at a pose.

    Parameters
    ----------
    bench
        Bench as it is known now.
    rotation
        (3, 3) rotation of the pose, camera <- target.

    Returns
    -------
    float
        Share of the circumference, 0 to 1.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, _RIM_POINTS, endpoint=False)
    radius = bench.collimator.r * np.tan(np.deg2rad(bench.half_angle_deg))
    # The rim as seen from the collimator's centre (x, y, -r).
    rim = np.column_stack(
        [radius * np.cos(angles), radius * np.sin(angles), np.full(len(angles), bench.collimator.r)]
    )
    pixels = bench.camera.project(rim @ rotation.T)
    limit = np.array(bench.camera.image_size) - 1.0
    with np.errstate(invalid="ignore"):
        return float(((pixels > 0) & (pixels < limit)).all(axis=1).mean())


def _head(angles_deg: Angles) -> Array:
    """Return the (3, 3) rotation of the gimbal's head at a pose."""
    return euler_zxy(
        angles_deg.get("pan_deg", 0.0), angles_deg.get("tilt_deg", 0.0), angles_deg.get("roll_deg", 0.0)
    )


def _distance_deg(one: Angles, other: Angles) -> float:
    """Return the largest difference between the angles of two poses, degrees."""
    return max((abs(one.get(axis, 0.0) - other.get(axis, 0.0)) for axis in {*one, *other}), default=0.0)


def _share_of_news(pose: Angles, others: Sequence[Angles]) -> float:
    """Return the share of a pose's information that recorded poses do not hold yet, 0 to 1."""
    nearest = min((_distance_deg(pose, other) for other in others), default=np.inf)
    return float(1.0 - np.exp(-((nearest / SHARED_ERROR_DEG) ** 2)))


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
