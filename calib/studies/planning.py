"""Planning: the uncertainty that a set of poses will give; repeats of a pose count as one.

A forecast is the posterior of the joint adjustment on predicted views (`calib.studies.expected_posterior`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.parameters import AdjustmentParameters, members, poses_of
from calib.calibration import CalibrationOptions
from calib.joint.budget import budget_rows, row_gradients, variances
from calib.joint.layout import CENTRE, RADIAL
from calib.joint.words import require_determined
from calib.model import result_parts as rows
from calib.model.result_parts import ROW_QUANTITIES, WORST_CORNER, BudgetRow
from calib.studies.expected_posterior import (
    Angles,
    expected_posterior,
    with_distortion,
)
from calib.studies.predicted_views import ExpectedBench, predicted_view
from calib.threads import on_one_thread
from calib.uncertainty.projection_uncertainty import ProjectionMap, projection_uncertainty

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
