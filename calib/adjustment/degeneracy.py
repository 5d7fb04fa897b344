"""Recognition of views that do not constrain a camera, and the reason in words.

The decision rests on the computed uncertainties. The geometry (same pose, one axis, narrow beam) explains it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.adjustment.parameters import AdjustmentParameters
from calib.errors import DegenerateViews
from calib.model.rotation import log_map
from calib.view import View

Array = NDArray[np.float64]

#: Largest acceptable 1-sigma of a focal length, as a share of it.
MAX_FOCAL_SIGMA = 0.05
_SAME_POSE_DEG = 0.5
_PARALLEL_SINE = 0.05
_NARROW_DEG = 5.0


def require_distinct_poses(parameters: AdjustmentParameters) -> None:
    """Refuse views that all show the same pose, within half a degree: only noise would determine the focal length.

    The chord between two rotations turned by an angle t is |R - S| = sqrt(8) sin(t / 2), in the Frobenius norm.
    """
    away = (parameters.rotations - parameters.rotations[0]).reshape(-1, 9)
    chord = np.sqrt(8.0) * np.sin(np.deg2rad(_SAME_POSE_DEG) / 2.0)
    if np.linalg.norm(away, axis=1).max() < chord:
        raise DegenerateViews(
            f"All {len(parameters.rotations)} views show the same pose.",
            remedy="Turn the camera by some degrees between views.",
        )


def require_constrained(
    parameters: AdjustmentParameters, names: Sequence[str], covariance: Array, why: str = ""
) -> None:
    """Refuse a focal length with a 1-sigma over 5 % (own limit); ``why`` explains the geometry, and may be empty."""
    sigmas = dict(zip(names, np.sqrt(np.diag(covariance)), strict=True))
    for name, value in (("fx", parameters.camera.fx), ("fy", parameters.camera.fy)):
        if name in sigmas and not sigmas[name] <= MAX_FOCAL_SIGMA * value:
            share = 200.0 * sigmas[name] / value
            raise DegenerateViews(
                f"These views determine {name} only to ±{share:.0f} % (k = 2). {why}".strip(),
                remedy="Add views turned about other axes, with the stars elsewhere in the image.",
            )


def explain_weak_geometry(views: Sequence[View], parameters: AdjustmentParameters) -> str:
    """Explain in one sentence why views may constrain little; empty if the geometry looks sound.

    Own rules: a roll, if the parts of all rotation vectors across the axis are below 0.05 of the longest vector; one
    axis, if the second singular value of the vectors is.
    """
    turns = relative_rotations_deg(parameters.rotations)
    lengths = np.linalg.norm(turns, axis=1)
    if len(views) > 1 and (np.linalg.norm(turns[:, :2], axis=1) < _PARALLEL_SINE * lengths.max()).all():
        return "The views differ only by a roll about the optical axis."
    if len(views) > 2 and np.linalg.svd(turns, compute_uv=False)[1] < _PARALLEL_SINE * lengths.max():
        return "All views are turned about one axis."
    beam = beam_half_angle_deg(parameters, views)
    if beam < _NARROW_DEG:
        return f"The stars span only +-{beam:.1f} degrees: the beam is too narrow."
    return ""


def relative_rotations_deg(rotations: Array) -> Array:
    """Return (n - 1, 3) vectors, degrees, of the rotations R_i R_1^T from the first view to another (Diebel, 2006)."""
    return np.asarray(np.rad2deg(log_map(rotations[1:] @ rotations[0].T)))


def beam_half_angle_deg(parameters: AdjustmentParameters, views: Sequence[View]) -> float:
    """Return the largest angle, degrees, between the ray of a star and the mean ray of its view (own definition)."""
    widest = 0.0
    for view, centre in zip(views, parameters.centres, strict=True):
        x, y = (view.target_mm - centre[:2]).T
        rays = np.array([x, y, np.full(len(view), -centre[2])]) / np.sqrt(x * x + y * y + centre[2] ** 2)
        middle = rays.mean(axis=1) / np.linalg.norm(rays.mean(axis=1))
        widest = max(widest, float(np.rad2deg(np.arccos(np.clip((middle @ rays).min(), -1, 1)))))
    return widest
