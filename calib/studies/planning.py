"""What a set of poses will be worth before anything moves, and which pose to add next.

Knows an expected camera, collimator, beam and star noise; images nothing. Information adds up over views, so a pose is
judged by the projection uncertainty that is left at the worst point of the sensor once its stars
are counted in. The plan is for noise: what views will disagree on, only the views can tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.bundle import Bundle
from calib.adjustment.observations import Observations
from calib.adjustment.parameters import AdjustmentParameters
from calib.errors import DegenerateViews, TooFewStars
from calib.model.collimator import CENTRE, Collimator
from calib.studies.predicted_views import ExpectedBench, predicted_view
from calib.uncertainty.covariance import inverse_information
from calib.uncertainty.passport_propagation import consider_covariance
from calib.uncertainty.projection_uncertainty import ProjectionMap, projection_uncertainty
from calib.view import View

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Forecast:
    """What poses will be worth.

    Attributes
    ----------
    sigma
        Expected 1-sigma of each parameter.
    covariance
        Of the parameters, in the order of `sigma`.
    projection_map
        Expected projection uncertainty over the sensor, at infinity.
    stars
        Number of stars each pose will show.
    """

    sigma: Mapping[str, float]
    covariance: Array
    projection_map: ProjectionMap
    stars: tuple[int, ...]


def forecast(bench: ExpectedBench, poses_deg: Sequence[Mapping[str, float]]) -> Forecast:
    """Return what a set of poses will be worth.

    Parameters
    ----------
    bench
        The bench as expected.
    poses_deg
        For each pose ``pan_deg``, ``tilt_deg``, ``roll_deg``; those missing are zero.

    Raises
    ------
    TooFewStars
        When a pose shows too few stars, or not the tag where it is needed; names it.
    DegenerateViews
        When the poses will not constrain the camera.
    """
    views = [predicted_view(bench, pose, f"pose {i}") for i, pose in enumerate(poses_deg, start=1)]
    information = sum((_information(bench, *view) for view in views), start=_no_information(bench))
    covariance = _covariance(bench, information)
    names = _names(bench)
    sigma = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    return Forecast(sigma, covariance, _map(bench, covariance), tuple(len(view) for view, _ in views))


def next_poses(
    bench: ExpectedBench,
    taken_deg: Sequence[Mapping[str, float]],
    candidates_deg: Sequence[Mapping[str, float]],
    count: int = 1,
) -> tuple[Mapping[str, float], ...]:
    """Return the poses, one after the other, that lower the worst projection uncertainty most.

    Parameters
    ----------
    bench
        The bench as expected.
    taken_deg
        Poses already decided on; may be empty.
    candidates_deg
        Poses to choose from, inside the station's limits; those that show too little are passed over.
    count
        How many to choose; each may be chosen once.

    Raises
    ------
    DegenerateViews
        When the candidates show too little to choose from.
    """
    known = _no_information(bench)
    for pose in taken_deg:
        known = known + _information(bench, *predicted_view(bench, pose, "taken"))
    possible = []
    for pose in candidates_deg:
        try:
            possible.append((pose, _information(bench, *predicted_view(bench, pose, "candidate"))))
        except TooFewStars:
            continue
    if len(possible) < count:
        raise DegenerateViews(
            f"Only {len(possible)} of the candidate poses show the target; {count} are needed."
        )
    chosen: list[Mapping[str, float]] = []
    for _ in range(count):
        remaining = [_worst(bench, known + information) for _, information in possible]
        pose, information = possible.pop(int(np.argmin(remaining)))
        chosen.append(pose)
        known = known + information
    return tuple(chosen)


def _names(bench: ExpectedBench) -> tuple[str, ...]:
    """Return the parameters that the views share."""
    return (*bench.camera.parameter_names, *CENTRE)


def _information(bench: ExpectedBench, view: View, rotation: Array) -> Array:
    """Return what a view tells of the shared parameters, its own rotation unknown."""
    ideal = Collimator(bench.collimator.x, bench.collimator.y, bench.collimator.r)
    bundle = Bundle(Observations.from_views([view]), _names(bench))
    parameters = AdjustmentParameters(bench.camera, ideal, rotation[None], np.zeros((1, 3)))
    ((information, _),) = bundle.scores(parameters, np.zeros((len(view), 2)))
    return information


def _no_information(bench: ExpectedBench) -> Array:
    """Return the information before any view."""
    return np.zeros((len(_names(bench)), len(_names(bench))))


def _covariance(bench: ExpectedBench, information: Array) -> Array:
    """Return the covariance of the shared parameters that information leaves, a passport's held."""
    if bench.passport is None:
        return inverse_information(information, _names(bench))
    return consider_covariance(information, _names(bench), bench.passport.subset(CENTRE))


def _map(bench: ExpectedBench, covariance: Array) -> ProjectionMap:
    """Return the projection uncertainty of a covariance of the shared parameters."""
    size = len(bench.camera.parameter_names)
    return projection_uncertainty(bench.camera, covariance[:size, :size], 9)


def _worst(bench: ExpectedBench, information: Array) -> float:
    """Return the worst projection uncertainty left; with too little told, how much is missing."""
    try:
        return _map(bench, _covariance(bench, information)).worst_px
    except DegenerateViews:
        # Not solvable yet: the pose that determines the most directions is best; any solvable pose is better.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
        eigenvalues = np.linalg.eigvalsh(information * np.outer(scale, scale))
        return float(1e12 - np.log(np.maximum(eigenvalues, 1e-15)).sum())
