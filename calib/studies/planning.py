"""Planning: the uncertainty that a set of poses will give, and the best poses to add.

A forecast is the posterior of the joint adjustment on predicted views (`calib.studies.expected_posterior`). Repeats of
a pose count as one. A pose to add is judged by the projection uncertainty that remains at the worst point of the sensor
(the G-optimality of experimental design; Kiefer and Wolfowitz, 1960).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.parameters import SAME_POSE_DEG, AdjustmentParameters, members, poses_of
from calib.calibration import CalibrationOptions
from calib.errors import DegenerateViews, TooFewStars
from calib.joint.budget import budget_rows, row_gradients, variances
from calib.joint.layout import CENTRE, RADIAL
from calib.joint.words import require_determined
from calib.model import result_parts as rows
from calib.model.result_parts import ROW_QUANTITIES, WORST_CORNER, BudgetRow
from calib.studies.expected_posterior import (
    Angles,
    PoseGains,
    distance_deg,
    expected_posterior,
    share_of_news,
    with_distortion,
)
from calib.studies.predicted_views import ExpectedBench, predicted_view, rim_share
from calib.threads import on_one_thread
from calib.uncertainty.projection_uncertainty import ProjectionMap, projection_uncertainty
from calib.view import View

Array = NDArray[np.float64]

#: Rows of the uncertainty budget that further poses lower; all others stay about as they are.
REDUCED_BY_POSES = frozenset(
    {
        rows.STARS,
        rows.READINGS,
        rows.POSE_FIELDS,
        rows.TURN_FIELDS,
        rows.AMPLITUDES,
        rows.LENS,
        rows.PRIORS,
        rows.GIMBAL_AXES,
    }
)


@dataclass(frozen=True)
class Forecast:
    """Expected uncertainty of a calibration from a set of poses."""

    sigma: Mapping[str, float]  # Expected 1-sigma of each parameter, without those of the gimbal
    covariance: Array  # (G, G) float64 expected covariance of the parameters, in the order of `sigma`
    # The k for which value +- k sigma is expected to cover 95.45 %, by name of the parameter and for `WORST_CORNER`.
    coverage_factors: Mapping[str, float]
    projection_map: ProjectionMap  # Expected projection uncertainty over the sensor, at infinity, 1 sigma
    stars: tuple[int, ...]
    model: str
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
    """
    bench = with_distortion(bench)
    views = [predicted_view(bench, pose, f"pose {i}") for i, pose in enumerate(poses_deg, start=1)]
    rotations = np.array([rotation for _, rotation in views])
    firsts = [repeats[0] for repeats in members(poses_of(rotations))]
    kept, turned = [views[i][0] for i in firsts], rotations[firsts]
    found = expected_posterior(bench, kept, turned, [poses_deg[i] for i in firsts])
    layout = found.optimum.marginal.problem.bench.layout
    names, size = (*layout.camera, *CENTRE, *RADIAL), len(layout.camera)
    at = layout.places(names)
    covariance = found.covariance[np.ix_(at, at)]
    centred = AdjustmentParameters(bench.camera, bench.collimator, turned, np.zeros((len(kept), 3)))
    require_determined(found, kept, centred, CalibrationOptions(passport=bench.passport))
    gradients = row_gradients(found, covariance[:size, :size])
    parts = variances(found, gradients)
    sigmas = np.sqrt(sum(parts.values()))
    factors = [found.expanded(row) / sigma for row, sigma in zip(gradients, sigmas, strict=True)]
    camera = found.optimum.marginal.problem.bench.camera(found.mean)
    return Forecast(
        dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        covariance,
        dict(zip(ROW_QUANTITIES, factors, strict=True)),
        projection_uncertainty(camera, covariance[:size, :size]),
        tuple(len(view) for view, _ in views),
        "joint",
        budget_rows(found, gradients, parts),
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


@dataclass(frozen=True)
class SuggestedPose:
    """A pose to add."""

    angles_deg: Angles  # Angles of the gimbal, degrees
    # Largest projection uncertainty over the sensor with this pose and those before it, 1 sigma, px.
    worst_px: float
    rim_share: float  # Share of the rim of the beam that the pose shows, 0 to 1


@on_one_thread
def next_poses(
    bench: ExpectedBench,
    taken_deg: Sequence[Angles],
    candidates_deg: Sequence[Angles],
    count: int = 1,
) -> tuple[SuggestedPose, ...]:
    """Return the poses that lower the worst projection uncertainty most, chosen one after the other (greedy).

    Criterion: G-optimality (Kiefer and Wolfowitz, 1960). The greedy choice is this project's own. No pose
    repeats another one.

    taken_deg: Poses already planned, degrees; may be empty.
    candidates_deg: Poses to choose from, degrees, within the station's limits; those that show too little are
      skipped.
    count: Number of poses to choose; each candidate is chosen at most once.
    Returns: The chosen poses, the best first.
    Raises TooFewStars: If a planned pose shows too few stars, or not the tag if it is needed.
    Raises DegenerateViews: If too few candidates show the target.
    """
    bench = with_distortion(bench)
    taken = [_Shown(pose, *predicted_view(bench, pose, "taken")) for pose in taken_deg]
    possible = list(_possible(bench, candidates_deg))
    choice = _Choice(bench, [*taken, *possible], len(taken)) if possible else None
    chosen: list[SuggestedPose] = []
    for _ in range(count):
        best = choice.best() if choice else None
        if best is None:
            raise DegenerateViews(
                f"Only {len(chosen)} of the candidate poses show the target and repeat no other pose; {count} are "
                "needed."
            )
        chosen.append(best)
    return tuple(chosen)


@dataclass(frozen=True)
class _Shown:
    """A pose that shows enough stars."""

    angles_deg: Angles
    view: View
    rotation: Array


def _possible(bench: ExpectedBench, candidates_deg: Sequence[Angles]) -> Iterator[_Shown]:
    """Yield the candidates that show enough stars."""
    for pose in candidates_deg:
        try:
            yield _Shown(pose, *predicted_view(bench, pose, "candidate"))
        except TooFewStars:
            continue


class _Choice:
    """Poses chosen one after the other, and what they leave; the first `taken` poses are chosen already.

    A pose next to a chosen one counts less: neighbouring poses share errors.
    """

    def __init__(self, bench: ExpectedBench, poses: Sequence[_Shown], taken: int) -> None:
        self._bench, self._poses = bench, poses
        self._gains = PoseGains(
            bench,
            [pose.view for pose in poses],
            np.array([pose.rotation for pose in poses]),
            [pose.angles_deg for pose in poses],
        )
        self._weights = np.zeros(len(poses))
        self._taken: list[int] = []
        for place in range(taken):
            self._take(place)

    def _take(self, place: int) -> None:
        """Add a pose; a repeat adds nothing."""
        self._weights[place] = self._weight(place)
        self._taken.append(place)

    def best(self) -> SuggestedPose | None:
        """Take the best of the poses that are left; None if each of them repeats a pose."""
        free = [place for place in range(len(self._poses)) if not self._repeats(place)]
        if not free:
            return None
        before = self._gains.covariance(self._weights)
        left = {place: self._gains.with_pose(before, place, self._weight(place)).worst_px for place in free}
        place = min(free, key=lambda p: left[p])
        self._take(place)
        pose = self._poses[place]
        return SuggestedPose(pose.angles_deg, left[place], rim_share(self._bench, pose.rotation))

    def _weight(self, place: int) -> float:
        """Return how much of its information a pose brings."""
        if self._repeats(place):
            return 0.0
        return share_of_news(self._poses[place].angles_deg, (self._poses[p].angles_deg for p in self._taken))

    def _repeats(self, place: int) -> bool:
        own = self._poses[place].angles_deg
        return any(distance_deg(own, self._poses[p].angles_deg) < SAME_POSE_DEG for p in self._taken)
