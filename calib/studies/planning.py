"""Planning: the uncertainty that a set of poses will give, and the best pose to add next.

The information of the views adds up. A pose is judged by the projection uncertainty that remains at the worst point of
the sensor (the G-optimality of experimental design; Kiefer and Wolfowitz, 1960). The forecast contains star noise only,
not the inconsistency of real views.
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
    """Expected uncertainty of a calibration from a set of poses.

    Attributes
    ----------
    sigma
        Expected 1-sigma of each parameter.
    covariance
        (G, G) float64 expected covariance of the parameters, in the order of `sigma`.
    projection_map
        Expected projection uncertainty over the sensor, at infinity.
    stars
        Number of stars that each pose will show.
    """

    sigma: Mapping[str, float]
    covariance: Array
    projection_map: ProjectionMap
    stars: tuple[int, ...]


def forecast(bench: ExpectedBench, poses_deg: Sequence[Mapping[str, float]]) -> Forecast:
    """Return the expected uncertainty of a calibration from a set of poses.

    The covariance is the inverse of the sum of the views' Fisher information: the Cramér-Rao bound (Rao, 1945).

    Parameters
    ----------
    bench
        The expected bench.
    poses_deg
        For each pose ``pan_deg``, ``tilt_deg``, ``roll_deg``, degrees; missing angles are zero.

    Returns
    -------
    Forecast
        Expected uncertainties, and the number of stars of each pose.

    Raises
    ------
    TooFewStars
        If a pose shows too few stars, or not the tag if it is needed; names the pose.
    DegenerateViews
        If the poses do not constrain the camera.
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
    """Return the poses that lower the worst projection uncertainty most, chosen one after the other (greedy).

    Criterion: G-optimality (Kiefer and Wolfowitz, 1960). The greedy choice is this project's own.

    Parameters
    ----------
    bench
        The expected bench.
    taken_deg
        Poses already planned, degrees; may be empty.
    candidates_deg
        Poses to choose from, degrees, within the station's limits; those that show too little are skipped.
    count
        Number of poses to choose; each candidate is chosen at most once.

    Returns
    -------
    tuple of Mapping
        The chosen poses, the best first.

    Raises
    ------
    TooFewStars
        If a planned pose shows too few stars, or not the tag if it is needed.
    DegenerateViews
        If too few candidates show the target.
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
    """Return the names of the parameters that the views share."""
    return (*bench.camera.parameter_names, *CENTRE)


def _information(bench: ExpectedBench, view: View, rotation: Array) -> Array:
    """Return (G, G) information of a view on the shared parameters, with its rotation unknown."""
    ideal = Collimator(bench.collimator.x, bench.collimator.y, bench.collimator.r)
    bundle = Bundle(Observations.from_views([view]), _names(bench))
    parameters = AdjustmentParameters(bench.camera, ideal, rotation[None], np.zeros((1, 3)))
    ((information, _),) = bundle.scores(parameters, np.zeros((len(view), 2)))
    return information


def _no_information(bench: ExpectedBench) -> Array:
    """Return (G, G) zeros: the information before any view."""
    return np.zeros((len(_names(bench)), len(_names(bench))))


def _covariance(bench: ExpectedBench, information: Array) -> Array:
    """Return (G, G) covariance of the shared parameters for this information, with a passport held."""
    if bench.passport is None:
        return inverse_information(information, _names(bench))
    return consider_covariance(information, _names(bench), bench.passport.subset(CENTRE))


def _map(bench: ExpectedBench, covariance: Array) -> ProjectionMap:
    """Return the projection uncertainty for a (G, G) covariance of the shared parameters."""
    size = len(bench.camera.parameter_names)
    return projection_uncertainty(bench.camera, covariance[:size, :size], 9)


def _worst(bench: ExpectedBench, information: Array) -> float:
    """Return the worst projection uncertainty, px; with too little information, a large number that falls with it.

    G-optimality: Kiefer and Wolfowitz (1960). Own substitute if the information is singular: a large number minus the
    sum of the logarithms of the eigenvalues.
    """
    try:
        return _map(bench, _covariance(bench, information)).worst_px
    except DegenerateViews:
        # Not solvable yet: the pose that determines the most directions is best; any solvable pose is better.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
        eigenvalues = np.linalg.eigvalsh(information * np.outer(scale, scale))
        return float(1e12 - np.log(np.maximum(eigenvalues, 1e-15)).sum())
