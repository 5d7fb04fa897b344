"""What an expected bench expects: predicted views with its amplitudes, and what each of many poses would add.

What each of many poses would add to others is a sum of information (`PoseGains`): a pose tells of the shared unknowns
what its stars and its reading say, with its rotation and its own field eliminated. So a pose to add is judged without
another adjustment. Neighbouring poses share most errors of the collimator and of the pixel grid, so a pose next to
another one brings less than its stars promise (`share_of_news`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array
from calib.calibration import CalibrationOptions
from calib.joint.forecast import PredictedViews
from calib.joint.forecast import amplitudes as amp
from calib.model.lens import is_fisheye
from calib.studies.predicted_views import ExpectedBench
from calib.uncertainty.projection_uncertainty import projection_derivatives
from calib.view import View

Angles = Mapping[str, float]

#: Amplitudes of the errors that follow the collimator, and of those that follow the turn.
_COMMON = (amp.RADIAL, amp.SHIFTED, amp.ANAMORPHIC, *amp.COMMON)
_BY_TURN = (amp.CURVATURE_TURN, amp.SCALE_TURN_2, *amp.TURN, *amp.TURN_2)
#: A bad collimator may be badly focused, too. A good one is not better focused than others.
_FOCUS = (amp.PARALLAX, amp.ASIDE)
#: Distortion of a lens at the corner of the sensor, as a share of the distance from the axis: as large as that of the
#: camera of arXiv:2512.16092.
_THIRD_ORDER, _FIFTH_ORDER = 0.003, -0.002
_GRID_POINTS = 9  # Across the sensor: a coarse grid has its corners, where the uncertainty is usually largest
#: Poses are compared with about so many of their stars; each then counts for those that are left out.
_STARS = 80

#: Distance at which two poses share about a third of their errors, degrees.
SHARED_ERROR_DEG = 1.5


def predicted_views(
    bench: ExpectedBench, views: Sequence[View], rotations: Array, angles_deg: Sequence[Angles]
) -> PredictedViews:
    """Return the adjustment of predicted views with (n, 3, 3) rotations, camera <- target, at the expected bench."""
    start = AdjustmentParameters(bench.camera, bench.collimator, rotations, np.zeros((len(views), 3)))
    readings, axes = bench.readings, {axis for pose in angles_deg for axis in pose}
    whole = tuple({axis: pose.get(axis, 0.0) for axis in axes} for pose in angles_deg)
    options = CalibrationOptions(
        passport=bench.passport,
        gimbal=replace(readings, angles_deg=whole) if readings else None,
        budget=bench.terms,
        radial_sigma=bench.radial_sigma,
    )
    return PredictedViews(views, start, options)


def with_distortion(bench: ExpectedBench) -> ExpectedBench:
    """Return the bench with a typical distortion if none is stated; without any, nothing separates cx and p1."""
    camera = bench.camera
    if any(camera.distortion.values()) or is_fisheye(camera.distortion):
        return bench
    square = (0.5 * float(np.hypot(*camera.image_size)) / camera.fx) ** 2
    lens = {**camera.distortion, "k1": _THIRD_ORDER / square, "k2": _FIFTH_ORDER / square**2}
    return replace(bench, camera=replace(camera, distortion=lens))


def expected_amplitudes(bench: ExpectedBench, hyper: amp.Hyperprior) -> Array:
    """Return the (A,) logarithms of the amplitudes that a bench expects.

    They are those of the run so far, if one is under way. Else they are the medians of the hyperprior, times the size
    of the errors that the station states over that of a good collimator. Own: a pupil that wanders by w turns the
    pattern by defocus w / r, which readings and stars see differently.
    """
    eta = hyper.mean.copy()
    if bench.amplitudes is not None:
        known = {name: value for name, value in bench.amplitudes.items() if name in hyper.names}
        eta[hyper.places(tuple(known))] = np.log(list(known.values()))
        return eta
    errors, edge = bench.errors, float(np.tan(np.radians(bench.half_angle_deg)))
    times = errors.times_good(bench.camera.fx, bench.star_sigma_px, bench.collimator.r, edge)
    by_turn = [name for name in _BY_TURN if name in hyper.names]
    for names, larger in zip((_COMMON, by_turn, amp.POSE), times, strict=True):
        eta[hyper.places(names)] += np.log(larger)
    eta[hyper.places(_FOCUS)] += max(np.log(times[1]), 0.0)
    if bench.readings is not None:
        wander_deg = np.degrees(errors.defocus * errors.pupil_wander_mm / bench.collimator.r)
        scatter = np.hypot(1.0, wander_deg / bench.readings.reading_sigma_deg)
        eta[hyper.at(amp.READING)] += np.log(scatter)
    bounds = np.array(hyper.bounds).T
    return np.clip(eta, *bounds)


@dataclass(frozen=True)
class Sigmas:
    """Standard uncertainties that some poses leave, for the expected amplitudes."""

    fx_px: float  # 1-sigma of the focal length fx, px
    worst_px: float  # Largest projection uncertainty over the sensor, 1 sigma, px


class PoseGains:
    """The information of poses, a predicted view and a rotation, camera <- target, each; some will be recorded."""

    def __init__(
        self, bench: ExpectedBench, views: Sequence[View], rotations: Array, angles_deg: Sequence[Angles]
    ) -> None:
        predicted = predicted_views(bench, [_thinned(view) for view in views], rotations, angles_deg)
        self._poses = predicted.information(expected_amplitudes(bench, predicted.hyper))
        self._by_camera = projection_derivatives(self._poses.camera, _GRID_POINTS)[0]

    def information(self, weights: Array) -> Array:
        """Return the (S, S) information of all priors and of the first poses, which count by (k,) weights."""
        return sum(map(self.added, range(len(weights)), weights), start=self._poses.prior)

    def added(self, place: int, weight: float) -> Array:
        """Return the (S, S) information that a pose adds."""
        maps = self._poses.maps[place]
        return np.asarray(weight * maps.T @ self._poses.own[place] @ maps)

    def covariance(self, information: Array) -> Array:
        """Return the (S, S) covariance of the shared unknowns; scaled to a unit diagonal (van der Sluis, 1969)."""
        scale = 1.0 / np.sqrt(np.diag(information))
        inverse = np.linalg.inv(information * np.outer(scale, scale))
        return np.asarray(inverse * np.outer(scale, scale))

    def sigmas(self, covariance: Array) -> Sigmas:
        """Return what a covariance of the shared unknowns, or of the camera alone, leaves.

        The criterion of the worst point is the G-optimality of Kiefer and Wolfowitz (1960).
        """
        size = self._poses.camera_size
        camera = covariance[:size, :size]
        spread = self._by_camera @ camera @ np.swapaxes(self._by_camera, 1, 2)
        worst = float(np.linalg.eigvalsh(spread)[:, 1].max())
        return Sigmas(float(np.sqrt(max(camera[0, 0], 0.0))), float(np.sqrt(max(worst, 0.0))))

    def with_poses(self, covariance: Array, places: Sequence[int], weights: Sequence[float]) -> list[Sigmas]:
        """Return what each of some further poses leaves of the (S, S) covariance without it (Woodbury, 1950)."""
        maps, camera = self._poses.maps[list(places)], self._poses.camera_size
        own = np.asarray(weights)[:, None, None] * self._poses.own[list(places)]
        moved = (maps.reshape(-1, maps.shape[2]) @ covariance).reshape(maps.shape)
        at = moved[:, :, :camera]
        inside = np.eye(own.shape[1]) + own @ (moved @ np.swapaxes(maps, 1, 2))
        left = covariance[:camera, :camera] - np.swapaxes(at, 1, 2) @ np.linalg.solve(inside, own @ at)
        return [self.sigmas(pose) for pose in left]


def _thinned(view: View) -> View:
    """Return the view with every n-th star, each with the information of n."""
    step = max(1, len(view) // _STARS)
    part = view.part(np.arange(len(view)) % step == 0)
    return replace(part, covariances_px2=part.covariances_px2 / step)


def distance_deg(angles: Angles, other: Angles) -> float:
    """Return the largest difference, degrees, between the angles of two poses; missing angles are zero."""
    return max((abs(angles.get(axis, 0.0) - other.get(axis, 0.0)) for axis in {*angles, *other}), default=0.0)


def share_of_news(pose: Angles, others: Iterable[Angles]) -> float:
    """Return the share of a pose's information, 0 to 1, that others do not hold yet (own choice of function)."""
    nearest = min((distance_deg(pose, other) for other in others), default=np.inf)
    return float(1.0 - np.exp(-((nearest / SHARED_ERROR_DEG) ** 2)))
