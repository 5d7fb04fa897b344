"""Planning: the uncertainty that a set of poses will give, and the best poses to add.

A forecast contains star noise, the errors of the collimator, the gimbal's readings, priors, a passport, and the type B
terms of the budget. Repeats of a pose count as one. A pose to add is judged by the projection uncertainty that remains
at the worst point of the sensor (the G-optimality of experimental design; Kiefer and Wolfowitz, 1960).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.levenberg_marquardt import Loss
from calib.adjustment.poses import SAME_POSE_DEG, members, poses_of
from calib.calibration import CalibrationOptions
from calib.errors import DegenerateViews, TooFewStars
from calib.model.aberrations import LADDER, PARALLAX, needs_rim
from calib.model.budget_row import WORST_CORNER, BudgetRow
from calib.studies.expected_fit import entering_readings, model_to_expect, reading_scatter
from calib.studies.expected_uncertainty import PoseJudge, expected_estimate, expected_fit
from calib.studies.pose_distance import distance_deg, share_of_news
from calib.studies.predicted_views import RIM_IN_VIEW, ExpectedBench, predicted_view, rim_share
from calib.uncertainty.budget_parts import GIMBAL_AXES, PRIORS, READINGS, STARS, covariance_parts
from calib.uncertainty.budget_rows import budget_rows, not_included
from calib.uncertainty.covariance import INCONSISTENCY
from calib.uncertainty.passport_propagation import UNBOUNDED_PARALLAX
from calib.uncertainty.projection_uncertainty import ProjectionMap, projection_uncertainty
from calib.uncertainty.target_response import target_response
from calib.uncertainty.type_b import add_terms
from calib.view import View

Array = NDArray[np.float64]
Angles = Mapping[str, float]

#: Sources of the uncertainty budget that further poses lower; all others stay about as they are.
REDUCED_BY_POSES = frozenset({STARS, PRIORS, READINGS, GIMBAL_AXES, INCONSISTENCY})
#: Share of the poses that should show the rim of the beam if the model needs it.
_SHOWING_RIM = 0.5


@dataclass(frozen=True)
class Forecast:
    """Expected uncertainty of a calibration from a set of poses."""

    sigma: Mapping[str, float]  # Expected 1-sigma of each parameter, without those of the gimbal
    covariance: Array  # (G, G) float64 expected covariance of the parameters, in the order of `sigma`
    coverage_factor: float  # The k for which value +- k sigma is expected to cover 95.45 %
    projection_map: ProjectionMap  # Expected projection uncertainty over the sensor, at infinity, 1 sigma
    stars: tuple[int, ...]
    model: str
    budget_rows: tuple[BudgetRow, ...] = ()
    not_included: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def limited(self) -> Mapping[str, float]:
        """Expected numbers that the limits and goals of a sequence judge, by name without unit."""
        k = self.coverage_factor
        corners = self.projection_map.sigma_px[[0, 0, -1, -1], [0, -1, 0, -1]]
        return {
            **{f"sigma_{name}": sigma for name, sigma in self.sigma.items()},
            **{f"expanded_{name}": k * self.sigma[name] for name in ("fx", "fy")},
            WORST_CORNER: k * float(np.nanmax(corners, initial=0.0)),
        }


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
    views = [predicted_view(bench, pose, f"pose {i}") for i, pose in enumerate(poses_deg, start=1)]
    rotations = np.array([rotation for _, rotation in views])
    firsts = [repeats[0] for repeats in members(poses_of(rotations))]
    fit = expected_fit(
        bench, [views[i][0] for i in firsts], rotations[firsts], [poses_deg[i] for i in firsts]
    )
    loss = Loss("l2")
    estimate = expected_estimate(fit, fit.shares)
    response = target_response(fit.bundle, fit.parameters, loss, estimate.names)
    applied = add_terms(response, estimate, bench.terms)
    parts = covariance_parts(fit.bundle, fit.parameters, loss, estimate)
    whole = applied.uncertainty
    shown = (*bench.camera.parameter_names, *fit.parameters.collimator.parameter_names)
    at = [i for i, name in enumerate(whole.names) if name in shown and name not in PARALLAX]
    covariance = whole.covariance[np.ix_(at, at)]
    size = len(bench.camera.parameter_names)
    return Forecast(
        dict(zip([whole.names[i] for i in at], np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        covariance,
        whole.coverage_factor,
        projection_uncertainty(bench.camera, covariance[:size, :size]),
        tuple(len(view) for view, _ in views),
        model_to_expect(bench),
        budget_rows(bench.camera, applied, parts),
        not_included(bench.camera, applied),
        _remarks(bench, rotations, UNBOUNDED_PARALLAX in whole.budget),
    )


def _remarks(bench: ExpectedBench, rotations: Array, any_parallax: bool) -> tuple[str, ...]:
    """Return what limits a forecast: readings that will not enter, parallax, and rims that too few poses show."""
    found = []
    if bench.readings is not None and bench.readings.parallax is None:
        found.append(
            "The gimbal's readings will not enter: the station does not bound their parallax (collimator: {defocus}, "
            "gimbal: {pupil_off_pivot_mm})."
        )
    elif bench.readings is not None and entering_readings(bench) is None:
        found.append(
            f"The gimbal's readings will not enter: they will scatter {reading_scatter(bench):.0f} times more than "
            "stated, because the pupil wanders across the beam."
        )
    if bench.errors.field_px(bench.star_sigma_px) > 0 and not _knows_focal_length(bench):
        found.append(
            "Nothing but the stars determines the focal length. A certificate of the collimator, or the gimbal's "
            "readings with a bounded parallax, would lower its uncertainty."
        )
    if any_parallax:
        share = 100 * CalibrationOptions.parallax_sigma
        found.append(
            f"A parallax of about {share:g} % cannot be excluded, and more poses do not show it. The forecast includes "
            "it."
        )
    if needs_rim(LADDER.get(bench.model, ())):
        shown = sum(_shows_rim(bench, rotation) for rotation in rotations)
        if shown < _SHOWING_RIM * len(rotations):
            found.append(
                f"The {bench.model} model needs the rim of the beam, but only {shown} of {len(rotations)} poses show "
                "enough of it. The calibration will refuse this model."
            )
    return tuple(found)


@dataclass(frozen=True)
class SuggestedPose:
    """A pose to add."""

    angles_deg: Angles  # Angles of the gimbal, degrees
    # Largest projection uncertainty over the sensor with this pose and those before it, 1 sigma, px, without
    # type B terms; infinite if these poses do not determine the camera yet.
    worst_px: float
    rim_share: float  # Share of the rim of the beam that the pose shows, 0 to 1
    # Why the rim must be in view, if the pose was chosen because it shows the rim; empty otherwise.
    rim_reason: str = ""


def next_poses(
    bench: ExpectedBench,
    taken_deg: Sequence[Angles],
    candidates_deg: Sequence[Angles],
    count: int = 1,
) -> tuple[SuggestedPose, ...]:
    """Return the poses that lower the worst projection uncertainty most, chosen one after the other (greedy).

    Criterion: G-optimality (Kiefer and Wolfowitz, 1960). The greedy choice is this project's own. If the model needs
    the rim of the beam and too few poses show it, poses that show it come first. No pose repeats another one.

    taken_deg: Poses already planned, degrees; may be empty.
    candidates_deg: Poses to choose from, degrees, within the station's limits; those that show too little are
      skipped.
    count: Number of poses to choose; each candidate is chosen at most once.
    Returns: The chosen poses, the best first.
    Raises TooFewStars: If a planned pose shows too few stars, or not the tag if it is needed.
    Raises DegenerateViews: If too few candidates show the target.
    """
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

    A pose next to a chosen one counts less if the collimator has errors, which neighbouring poses share.
    """

    def __init__(self, bench: ExpectedBench, poses: Sequence[_Shown], taken: int) -> None:
        self._bench, self._poses = bench, poses
        self._fit = expected_fit(
            bench,
            [pose.view for pose in poses],
            np.array([pose.rotation for pose in poses]),
            [pose.angles_deg for pose in poses],
            candidates=True,
        )
        self._judge = PoseJudge(self._fit)
        self._neighbours_share = bench.errors.field_px(bench.star_sigma_px) > 0
        self._taken: list[int] = []
        self._information, self._noise = np.zeros((2, len(self._fit.names), len(self._fit.names)))
        for place in range(taken):
            self._take(place)

    def _take(self, place: int) -> None:
        """Add a pose; a repeat adds nothing."""
        self._information, self._noise = self._with(place)
        self._taken.append(place)

    def best(self) -> SuggestedPose | None:
        """Take the best of the poses that are left; None if each of them repeats a pose."""
        free = [place for place in range(len(self._poses)) if not self._repeats(place)]
        reason = self._rim_reason()
        free = [p for p in free if reason and self._rim(p) >= RIM_IN_VIEW] or free
        if not free:
            return None
        left = {place: self._judge.sigmas(*self._with(place)) for place in free}
        place = min(free, key=lambda p: (left[p].missing, left[p].worst_px))
        share = self._rim(place)
        self._take(place)
        return SuggestedPose(
            self._poses[place].angles_deg, left[place].worst_px, share, reason if share >= RIM_IN_VIEW else ""
        )

    def _with(self, place: int) -> tuple[Array, Array]:
        """Return the sums of information and noise with a pose."""
        weight = 0.0 if self._repeats(place) else 1.0
        if weight and self._neighbours_share:
            weight = share_of_news(
                self._poses[place].angles_deg, (self._poses[p].angles_deg for p in self._taken)
            )
        share = self._fit.shares[place]
        noise = share.noise + share.field_noise
        return self._information + weight * share.information, self._noise + weight * noise

    def _repeats(self, place: int) -> bool:
        own = self._poses[place].angles_deg
        return any(distance_deg(own, self._poses[p].angles_deg) < SAME_POSE_DEG for p in self._taken)

    def _rim_reason(self) -> str:
        """Return why the next pose should show the rim; empty if no model needs it, or enough poses show it."""
        bench = self._bench
        if sum(self._rim(p) >= RIM_IN_VIEW for p in self._taken) >= _SHOWING_RIM * (len(self._taken) + 1):
            return ""
        if needs_rim(LADDER.get(bench.model, ())):
            return f"the {bench.model} model needs"
        if bench.model == "auto" and self._neighbours_share and not _knows_focal_length(bench):
            return (
                "lets the data choose a model with the collimator's aberrations: nothing but the stars determines the "
                "focal length (no certificate, and no readings with a bounded parallax)"
            )
        return ""

    def _rim(self, place: int) -> float:
        return rim_share(self._bench, self._poses[place].rotation)


def _knows_focal_length(bench: ExpectedBench) -> bool:
    """Return whether anything but the stars determines the focal length."""
    return bench.passport is not None or entering_readings(bench) is not None


def _shows_rim(bench: ExpectedBench, rotation: Array) -> bool:
    return rim_share(bench, rotation) >= RIM_IN_VIEW
