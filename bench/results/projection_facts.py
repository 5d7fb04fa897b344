"""What the report says first: the uncertainty of a direction in the worst corner, and where stars support it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.report.support import reach_px, star_distance
from calib.model.camera import CameraModel
from calib.uncertainty.projection_uncertainty import ARCSEC, ProjectionMap, projection_uncertainty

Array = NDArray[np.float64]

URAD_PER_ARCSEC = 1e6 / ARCSEC
_CORNERS = {
    "top left": (0, 0),
    "top right": (0, -1),
    "bottom left": (-1, 0),
    "bottom right": (-1, -1),
}


def projection_facts(
    camera: CameraModel, covariance: Array, k: float, points: Sequence[Array]
) -> dict[str, Any] | None:
    """Return the expanded uncertainty of a direction over the sensor, and the part that stars support.

    Propagation of the camera's covariance (`calib.uncertainty.projection_uncertainty`), along the worse direction;
    U = k u (JCGM 100:2008, 6.2.1).

    covariance: (K, K) covariance of its parameters, in the order of `CameraModel.parameter_names`.
    points: For each view (N, 2) float64, px: its stars.
    Returns: ``projection`` of results.json (docs/results.md); None if no corner of the sensor has an
      uncertainty.
    """
    found, size = projection_uncertainty(camera, covariance), camera.image_size
    corners = {name: float(found.sigma_px[at]) for name, at in _CORNERS.items()}
    known = {name: sigma for name, sigma in corners.items() if np.isfinite(sigma)}
    if not known:
        return None
    worst = max(known, key=lambda name: known[name])
    middle_px, middle_arcsec = np.nanmedian(found.sigma_px), np.nanmedian(found.sigma_arcsec)
    return {
        "coverage_factor": k,
        "worst_corner": {
            "corner": worst,
            "expanded_px": k * known[worst],
            "expanded_urad": k * URAD_PER_ARCSEC * float(found.sigma_arcsec[_CORNERS[worst]]),
        },
        "median": {
            "expanded_px": k * float(middle_px),
            "expanded_urad": k * URAD_PER_ARCSEC * float(middle_arcsec),
        },
        "supported": _supported(found, np.concatenate(points), size, k) if points else None,
    }


def _supported(found: ProjectionMap, points: Array, size: tuple[int, int], k: float) -> dict[str, Any]:
    """Return how much of the sensor the stars support, and the largest uncertainty there."""
    distance, reach = star_distance(points, size), reach_px(size)
    grid = np.rint(found.grid_px).astype(int)
    near = (distance[grid[..., 1], grid[..., 0]] <= reach) & np.isfinite(found.sigma_px)
    inside = [
        float(np.max(values[near])) if near.any() else None for values in (found.sigma_px, found.sigma_arcsec)
    ]
    return {
        "reach_px": reach,
        "share": float(np.mean(distance <= reach)),
        "expanded_px": None if inside[0] is None else k * inside[0],
        "expanded_urad": None if inside[1] is None else k * URAD_PER_ARCSEC * inside[1],
    }
