"""Planning: the uncertainty that a set of poses will give, and what each possible pose would add to it.

A forecast is the posterior of the joint adjustment on predicted views (`calib.joint.forecast`); repeats of
a pose count as one. A possible pose's rotation comes from a gimbal fitted to the poses so far. A pose is judged by what
remains at the worst point of the sensor (the G-optimality of experimental design; Kiefer and Wolfowitz, 1960).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from calib.adjustment.parameters import SAME_POSE_DEG, views_of_poses
from calib.arrays import Array, ReadOnlyArrays
from calib.errors import DegenerateViews, TooFewStars
from calib.model.gimbal import Gimbal, aligned_gimbal
from calib.model.gimbal_readings import MIN_VIEWS, MOVED_DEG, angles_of
from calib.model.result_parts import WORST_CORNER, BudgetRow
from calib.model.rotation import nearest_rotation
from calib.one_thread import on_one_thread
from calib.studies.pose_gains import (
    Angles,
    PoseGains,
    Sigmas,
    distance_deg,
    expected_amplitudes,
    predicted_views,
    share_of_news,
    with_distortion,
)
from calib.studies.predicted_views import ExpectedBench, predicted_view, rim_share, view_at
from calib.uncertainty.projection_uncertainty import ProjectionMap, projection_uncertainty
from calib.view import View

#: Poses are weighed again so many at a time: one at a time is slower for each, and all at once weighs many in vain.
_AT_ONCE = 12


@dataclass(frozen=True)
class Forecast(ReadOnlyArrays):
    """Expected uncertainty of a calibration from a set of poses."""

    sigma: Mapping[str, float]  # Expected 1-sigma of each parameter, without those of the gimbal
    covariance: Array  # (G, G) float64 expected covariance of the parameters, in the order of `sigma`
    # The k for which value +- k sigma is expected to cover 95.45 %, by name of the parameter and for `WORST_CORNER`.
    coverage_factors: Mapping[str, float]
    projection_map: ProjectionMap  # Expected projection uncertainty over the sensor, at infinity, 1 sigma
    stars: tuple[int, ...]
    budget_rows: tuple[BudgetRow, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def coverage_factor(self) -> float:
        """The k of fx."""
        return self.coverage_factors["fx"]

    @property
    def limited(self) -> Mapping[str, float]:
        """Expected numbers that the limits and goals of a sequence judge, by name without unit."""
        k = self.coverage_factors
        corners = self.projection_map.sigma_px[[0, 0, -1, -1], [0, -1, 0, -1]]
        return {
            **{f"sigma_{name}": sigma for name, sigma in self.sigma.items()},
            **{f"expanded_{name}": k[name] * self.sigma[name] for name in ("fx", "fy")},
            WORST_CORNER: k[WORST_CORNER] * float(np.nanmax(corners, initial=0.0)),
        }


@on_one_thread
def forecast(bench: ExpectedBench, poses_deg: Sequence[Angles]) -> Forecast:
    """Return the expected uncertainty of a calibration from a set of poses.

    Parameters
    ----------
    bench
        The expected bench.
    poses_deg
        For each pose ``pan_deg``, ``tilt_deg``, ``roll_deg``, degrees; missing angles are zero.

    Returns
    -------
    Forecast
        Expected uncertainties by source, and the number of stars of each pose.

    Raises
    ------
    TooFewStars
        If a pose shows too few stars, or not the tag if it is needed; names the pose.
    DegenerateViews
        If the poses do not constrain the camera.
    InputMismatch
        If an axis is unknown, or an angle is not finite.
    """
    if not len(angles_of(poses_deg)):
        raise DegenerateViews("No pose is planned.", remedy="Plan poses.")
    bench = with_distortion(bench)
    views = [predicted_view(bench, pose, f"pose {i}") for i, pose in enumerate(poses_deg, start=1)]
    rotations = np.array([rotation for _, rotation in views])
    firsts = [repeats[0] for repeats in views_of_poses(rotations)]
    kept, turned = [views[i][0] for i in firsts], rotations[firsts]
    predicted = predicted_views(bench, kept, turned, [poses_deg[i] for i in firsts])
    expected = predicted.summary(expected_amplitudes(bench, predicted.hyper))
    sigmas = np.sqrt(np.diag(expected.covariance)).tolist()
    return Forecast(
        dict(zip(expected.names, sigmas, strict=True)),
        expected.covariance,
        expected.coverage_factors,
        projection_uncertainty(expected.camera, expected.camera_covariance),
        tuple(len(view) for view, _ in views),
        expected.rows,
        _remarks(bench),
    )


def _remarks(bench: ExpectedBench) -> tuple[str, ...]:
    """Return what limits a forecast: readings whose parallax nothing bounds, and a focal length that nothing states."""
    remarks = []
    if bench.readings is not None and bench.readings.parallax is None:
        remarks.append(
            "The station does not bound the parallax of the gimbal's readings (collimator: {defocus}, "
            "gimbal: {pupil_off_pivot_mm}), so they say little about the focal length."
        )
    bounded = bench.readings is not None and bench.readings.parallax is not None
    if bench.passport is None and not bounded and bench.errors.rms_px > 0:
        remarks.append(
            "Nothing but the stars determines the focal length, so it rests on how large errors are expected. A "
            "certificate of the collimator, or the gimbal's readings with a bounded parallax, would lower its "
            "uncertainty."
        )
    return tuple(remarks)


@on_one_thread
def next_poses(
    bench: ExpectedBench, taken_deg: Sequence[Angles], candidates_deg: Sequence[Angles], count: int = 1
) -> tuple[WeighedPose, ...]:
    """Return the poses that lower the worst projection uncertainty most, the best first, before a straight gimbal.

    The candidates, degrees, lie within the station's limits; those that show too little are skipped; each is chosen at
    most once.
    Raises TooFewStars: If a planned pose shows too few stars, or not the tag if it is needed.
    Raises DegenerateViews: If too few candidates show the target.
    """
    for pose in taken_deg:
        predicted_view(bench, pose, "taken")
    poses = PoseWeigher(bench, Gimbal(), taken_deg).best(candidates_deg, count)
    if len(poses) < count:
        raise DegenerateViews(
            f"Only {len(poses)} of the candidate poses show the target and repeat no other pose; {count} are needed."
        )
    return poses


def fit_gimbal(rotations: Array, readings_deg: Sequence[Angles]) -> Gimbal:
    """Fit the gimbal to the poses recorded so far, well enough to predict what a pose shows.

    Without three or more views turned about two axes, the camera is assumed to be mounted straight, and only the base
    is fitted: the mean of the rotations that the views give, projected on the rotations (Moakher, 2002). Without views,
    the gimbal stands straight before the target. Missing angles are zero.
    """
    if not len(rotations):
        return Gimbal()
    angles = angles_of(readings_deg)
    if len(rotations) < MIN_VIEWS or (np.ptp(angles, axis=0) > MOVED_DEG).sum() < 2:
        back = np.swapaxes(Gimbal().heads(angles), 1, 2)
        return Gimbal(base_from_target=nearest_rotation(np.mean(back @ rotations, axis=0)))
    return aligned_gimbal(rotations, angles)


@dataclass(frozen=True)
class WeighedPose:
    """What a possible pose would add."""

    angles_deg: Angles  # Angles of the gimbal, degrees
    after: Sigmas
    rim_share: float  # Share of the rim of the beam's disc that would be in view, 0 to 1


class PoseWeigher:
    """Weighs possible poses, none that failed, against those recorded so far; each must show ``min_stars``.

    Uncertainties are those of the joint adjustment for the expected amplitudes, with camera and collimator of the last
    calibration, or the expected ones. The discount for neighbouring poses is this project's own.
    """

    def __init__(
        self,
        bench: ExpectedBench,
        gimbal: Gimbal,
        taken_deg: Sequence[Angles],
        *,
        refused_deg: Sequence[Angles] = (),
        min_stars: int = 0,
    ) -> None:
        self._bench = with_distortion(bench)
        self._gimbal = gimbal
        self._taken, self._refused = tuple(taken_deg), tuple(refused_deg)
        self._min_stars = min_stars
        views = self._views(self._taken)
        self._shown = [(self._taken[i], view) for i, view in views.items()]
        self._news = np.array([share_of_news(self._taken[i], self._taken[:i]) for i in views])
        self.before: Sigmas | None = None
        if self._shown:
            gains = self._gains(self._shown)
            self.before = gains.sigmas(gains.covariance(gains.information(self._news)))

    def best(self, candidates_deg: Iterable[Angles], count: int) -> tuple[WeighedPose, ...]:
        """Return the poses that leave the least at the worst point, one after the other (greedy; own), none twice.

        They are fewer than ``count`` if no more show the target. What a pose gains falls as others are chosen, so only
        those are weighed again that gained more than the best one does now (the lazy greedy choice; Minoux, 1978).
        """
        shown = self._possible(candidates_deg)
        if not shown:
            return ()
        gains = self._gains([*self._shown, *shown])
        first, taken, chosen = len(self._shown), list(self._taken), list[WeighedPose]()
        information = gains.information(self._news)
        gained = dict.fromkeys(range(len(shown)), np.inf)
        for _ in range(count):
            gained = {k: gain for k, gain in gained.items() if not _repeats(shown[k][0], taken)}
            if not gained:
                break
            covariance, after = gains.covariance(information), dict[int, Sigmas]()
            now, order = gains.sigmas(covariance).worst_px, sorted(gained, key=lambda k: -gained[k])
            for at in range(0, len(order), _AT_ONCE):
                if gained[order[at]] <= max((gained[k] for k in after), default=-np.inf):
                    break
                some = order[at : at + _AT_ONCE]
                news = [share_of_news(shown[k][0], taken) for k in some]
                after |= zip(some, gains.with_poses(covariance, [first + k for k in some], news), strict=True)
                gained |= {k: now - after[k].worst_px for k in some}
            best = min((after[k].worst_px, k) for k in after)[1]
            information = information + gains.added(first + best, share_of_news(shown[best][0], taken))
            taken.append(shown[best][0])
            chosen.append(self._weighed(shown[best][0], after[best]))
        return tuple(chosen)

    def visible(self, candidates_deg: Iterable[Angles]) -> list[Angles]:
        """Return the poses that show enough of the target, in their order; recorded and failed ones count, too."""
        return [pose for pose, _ in self._visible(list(candidates_deg))]

    def weigh(self, candidates_deg: Iterable[Angles]) -> list[WeighedPose]:
        """Return what each possible pose would add, in their order; others are left out."""
        shown = self._possible(candidates_deg)
        if not shown:
            return []
        gains = self._gains([*self._shown, *shown])
        first, news = len(self._shown), [share_of_news(pose, self._taken) for pose, _ in shown]
        covariance = gains.covariance(gains.information(self._news))
        after = gains.with_poses(covariance, range(first, first + len(shown)), news)
        return [self._weighed(pose, left) for (pose, _), left in zip(shown, after, strict=True)]

    def _weighed(self, pose: Angles, after: Sigmas) -> WeighedPose:
        return WeighedPose(pose, after, rim_share(self._bench, self._rotations([pose])[0]))

    def _possible(self, candidates_deg: Iterable[Angles]) -> list[tuple[Angles, View]]:
        """Return the possible poses, each with what it shows."""
        others = (*self._taken, *self._refused)
        return self._visible([pose for pose in candidates_deg if not _repeats(pose, others)])

    def _visible(self, poses: Sequence[Angles]) -> list[tuple[Angles, View]]:
        """Return the poses that show enough of the target, each with what it shows."""
        return [(poses[i], view) for i, view in self._views(poses).items() if len(view) >= self._min_stars]

    def _views(self, poses: Sequence[Angles]) -> dict[int, View]:
        """Return the stars that the poses show, by their places; poses that show too few are left out."""
        views = {}
        for i, rotation in enumerate(self._rotations(poses)):
            with suppress(TooFewStars):
                views[i] = view_at(self._bench, rotation, "possible")
        return views

    def _rotations(self, poses: Sequence[Angles]) -> Array:
        """Return the (n, 3, 3) rotations of the camera at some poses."""
        return self._gimbal.rotations(angles_of(poses))

    def _gains(self, shown: Sequence[tuple[Angles, View]]) -> PoseGains:
        """Return what the views of some poses say."""
        poses = [pose for pose, _ in shown]
        return PoseGains(self._bench, [view for _, view in shown], self._rotations(poses), poses)


def _repeats(pose: Angles, others: Iterable[Angles]) -> bool:
    return any(distance_deg(pose, other) < SAME_POSE_DEG for other in others)
