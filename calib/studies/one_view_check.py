"""A check of a calibration by one view of a plane target at an unknown place.

One view of which neither the place of the target nor the focal length of a collimator is known leaves six unknowns: a
pose. A change of the camera that a change of the pose imitates cannot be seen. The camera is held, the pose is
adjusted, and what changes of the camera could explain of the rest is judged by its chi-square (`CameraCheck` has the
comparison for views that determine the camera).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from calib.adjustment.bundle import Bundle, Observations
from calib.adjustment.initialization import pose_start
from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.adjustment.parameters import AdjustmentParameters
from calib.arrays import Array, Bools
from calib.compiled import on_one_thread
from calib.errors import DegenerateViews, InputMismatch
from calib.model.camera import PINHOLE, CameraModel
from calib.view import View

_COVERAGE = 0.95
#: Changes of the camera that a pose imitates to this share of their effect are not judged.
_UNSEEN = 1e-3
#: A point farther off than this many robust sigmas, after all changes are allowed, is a gross error.
_GROSS = 6.0
_MEDIAN_OF_NORMAL = 0.6745
_LEAST_POINTS = 20


@dataclass(frozen=True)
class OneViewCheck:
    """What one view at an unknown place can tell of a stated camera."""

    normalised: float  # Square root of the chi-square over its 95 % limit; above 1 the camera is not right
    rms_px: float  # Root mean square over the points of what the camera's changes explain after the best pose
    largest_px: float
    at_px: tuple[float, float]  # Where it is largest
    points: int
    # The least change of one parameter alone that the check would see: ``scale`` (share of fx and fy), ``cx``,
    # ``cy``, and each coefficient. Infinite if a pose imitates it.
    seen_from: Mapping[str, float]

    @property
    def right(self) -> bool:
        """Whether nothing contradicts the stated camera."""
        return self.normalised <= 1.0

    def to_dict(self) -> dict[str, Any]:
        """Return the content as JSON holds it; a change that cannot be seen is null."""
        seen = {name: size if np.isfinite(size) else None for name, size in self.seen_from.items()}
        return {
            "right": self.right,
            "one_view": True,
            "normalised": self.normalised,
            "rms_px": self.rms_px,
            "largest_px": self.largest_px,
            "at_px": list(self.at_px),
            "points": self.points,
            "seen_from": seen,
        }


@on_one_thread
def check_one_view(camera: CameraModel, covariance: Array | None, view: View) -> OneViewCheck:
    """Check a stated camera by one view; covariance as `CameraModel.parameter_names`, None is exact.

    Raises DegenerateViews: If there are too few points, or the stated camera sees no plane target there.
    """
    if camera.image_size != view.image_size:
        sizes = [" x ".join(str(side) for side in one.image_size) for one in (camera, view)]
        raise InputMismatch(
            f"The stated camera has {sizes[0]} px, this view has {sizes[1]} px.",
            remedy="Check a calibration of the same sensor and the same region of interest.",
        )
    kept = np.asarray(np.isfinite(camera.rays(view.points_px)).all(axis=1))
    seen = _Seen.of(camera, view, kept)
    if (gross := seen.gross()).any():
        kept[np.flatnonzero(kept)[gross]] = False
        seen = _Seen.of(camera, view, kept)
    # Stated covariances hold errors that neighbours share, too. Points of a file have none: unit covariances.
    least = 0.0 if (view.covariances_px2 == np.eye(2)).all() else 1.0
    return _judge(camera, covariance, view.points_px[kept], seen, least)


@dataclass(frozen=True)
class _Seen:
    """Whitened residuals of a view after the best pose, and how the camera's parameters move them."""

    residuals: Array  # (2 N,)
    columns: Array  # (2 N, K) without what a pose imitates
    basis: Array  # (2 N, d) orthonormal, of the changes that are judged
    whitening: Array  # (N, 2, 2)

    @classmethod
    def of(cls, camera: CameraModel, view: View, kept: Bools) -> _Seen:
        if kept.sum() < _LEAST_POINTS:
            raise DegenerateViews(
                f"Cannot check by one view: {kept.sum()} usable points; at least {_LEAST_POINTS} are needed.",
                remedy="Record the target so that it fills more of the image.",
            )
        bundle, posed = _best_pose(camera, view.part(kept))
        rows = bundle.derivatives(posed).transpose(2, 1, 0).reshape(-1, len(camera.values) + 6)
        by_camera, by_pose = rows[:, :-6], rows[:, -6:]
        residuals = bundle.weighted_residuals(posed).ravel()
        pose = np.linalg.qr(by_pose)[0]
        columns = by_camera - pose @ (pose.T @ by_camera)
        residuals = residuals - pose @ (pose.T @ residuals)
        whole = np.linalg.norm(by_camera, axis=0)
        left, sizes, _ = np.linalg.svd(columns / whole, full_matrices=False)
        return cls(residuals, columns, left[:, sizes > _UNSEEN], bundle.observations.whitening)

    def gross(self) -> Bools:
        """Return (N,) which points lie far off whatever the camera and the pose are."""
        over = self.residuals - self.basis @ (self.basis.T @ self.residuals)
        sigma = float(np.median(np.abs(over))) / _MEDIAN_OF_NORMAL
        return np.asarray(np.linalg.norm(over.reshape(-1, 2), axis=1) > _GROSS * max(sigma, 1e-12))


def _best_pose(camera: CameraModel, view: View) -> tuple[Bundle, AdjustmentParameters]:
    """Adjust the pose before the camera, which is held; return also the bundle in which the camera is free."""
    bundle = Bundle(Observations.from_views([view]), camera.parameter_names, free_centres=True)
    start = pose_start(camera, view)
    found = refine(replace(bundle, names=()), start, Loss("l2")) if start else None
    if found is None or not found.converged:
        raise DegenerateViews("The stated camera does not see these points on a plane before it.")
    return bundle, found.parameters


def _judge(
    camera: CameraModel, covariance: Array | None, points: Array, seen: _Seen, least: float
) -> OneViewCheck:
    """Tell whether a change of the camera explains more than noise and covariance do.

    least: Smallest variance of the noise.
    """
    along = seen.basis.T @ seen.residuals
    over = seen.residuals - seen.basis @ along
    freedom = len(over) - 6 - len(along)
    noise = max(float(over @ over) / freedom, least)
    allowed = noise * np.eye(len(along))
    moved = seen.basis.T @ seen.columns
    if covariance is not None:
        allowed += moved @ covariance @ moved.T
    # One variance is estimated: Hotelling's limit by the F distribution.
    limit = len(along) * float(stats.f.ppf(_COVERAGE, len(along), freedom))
    field = np.linalg.solve(seen.whitening, (seen.basis @ along).reshape(-1, 2, 1))[..., 0]
    lengths = np.linalg.norm(field, axis=1)
    worst = int(np.argmax(lengths))
    inverse = np.asarray(np.linalg.inv(allowed), np.float64)
    x, y = points[worst].tolist()
    return OneViewCheck(
        float(np.sqrt(along @ inverse @ along / limit)),
        float(np.sqrt(np.mean(lengths**2))),
        float(lengths[worst]),
        (x, y),
        len(points),
        _seen_from(camera, moved, inverse, limit),
    )


def _seen_from(camera: CameraModel, moved: Array, inverse: Array, limit: float) -> dict[str, float]:
    """Return the least change of each kind that reaches the limit by itself."""
    names = camera.parameter_names
    kinds = {"scale": np.array([{"fx": camera.fx, "fy": camera.fy}.get(name, 0.0) for name in names])}
    kinds |= {name: np.eye(len(names))[at] for at, name in enumerate(names) if name not in PINHOLE[:2]}
    found = {}
    for kind, change in kinds.items():
        squares = float(moved @ change @ inverse @ (moved @ change))
        found[kind] = float(np.sqrt(limit / squares)) if squares > 0 else np.inf
    return found
