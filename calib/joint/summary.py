"""What a posterior states: values, covariance and coverage factors by name, and the rows of the budget."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import Array
from calib.joint.budget import budget_rows, row_gradients, variances
from calib.joint.effects.collimator import CENTRE, RADIAL
from calib.joint.posterior import Posterior
from calib.joint.reported import reported
from calib.model.camera import CameraModel
from calib.model.result_parts import WORST_CORNER, BudgetRow


@dataclass(frozen=True)
class Summary:
    """The results of a posterior: of the camera, of the collimator's centre, and of its radial terms."""

    names: tuple[str, ...]
    estimates: Array  # (K,)
    covariance: Array  # (K, K)
    coverage_factors: dict[str, float]  # By name, and of `WORST_CORNER`
    budget: dict[str, dict[str, float]]  # 1-sigma contributions by group and name
    rows: tuple[BudgetRow, ...]
    camera: CameraModel  # With the term of r^8
    camera_covariance: Array  # (C, C) of its unknowns


def summarised(posterior: Posterior) -> Summary:
    """Return what a posterior states."""
    stated = reported(posterior, (*CENTRE, *RADIAL))
    covariance = stated.rows @ posterior.covariance @ stated.rows.T
    factors = stated.factors(posterior, np.sqrt(np.diag(covariance)))
    bench, number = posterior.optimum.marginal.problem.bench, len(stated.names)
    size = len(bench.layout.pose.camera)
    camera_covariance = posterior.covariance[:size, :size]
    gradients = row_gradients(posterior, camera_covariance)
    parts = variances(posterior, np.concatenate([stated.rows, gradients]))
    corner = posterior.expanded(gradients[-1]) / np.sqrt(gradients[-1] @ posterior.covariance @ gradients[-1])
    return Summary(
        stated.names,
        stated.rows @ posterior.mean,
        covariance,
        {**dict(zip(stated.names, factors, strict=True)), WORST_CORNER: float(corner)},
        {group: _contributions(stated.names, part[:number]) for group, part in parts.items()},
        budget_rows(posterior, gradients, {group: part[number:] for group, part in parts.items()}),
        bench.camera(posterior.mean),
        camera_covariance,
    )


def _contributions(names: tuple[str, ...], part: Array) -> dict[str, float]:
    """Return by name the 1-sigma contributions of a group, from its variances."""
    return dict(zip(names, np.sqrt(np.maximum(part, 0.0)).tolist(), strict=True))
