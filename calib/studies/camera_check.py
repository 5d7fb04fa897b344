"""Is a calibration still right? The camera that new views give, against the camera that was stated.

Both are compared where they are used: in the projection over the sensor, after the best rotation between them, because
a camera that is mounted again is the same camera (`projection_uncertainty`). The difference is judged by the largest
E_n number over the sensor (ISO 13528:2022, 9.7), with an expanded uncertainty that holds at all places at once.

One view of which neither the place of the target nor the focal length of a collimator is known determines no camera: it
leaves six unknowns, a pose, and a change of the camera that a change of the pose imitates cannot be seen. Then the
stated camera is held, the pose is adjusted, and what changes of the camera could explain of the rest is judged by its
chi-square.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.special import fdtri

from calib.adjustment.bundle import Bundle, Observations
from calib.adjustment.initialization import pose_start
from calib.adjustment.levenberg_marquardt import refine
from calib.adjustment.loss import Loss
from calib.arrays import Array, Bools
from calib.calibration import CalibrationOptions
from calib.engine import calibrate
from calib.errors import DegenerateViews
from calib.model.camera import PINHOLE, CameraModel, require_image_size
from calib.model.result_parts import CameraCheck, RegionCheck
from calib.one_thread import on_one_thread
from calib.uncertainty.projection_uncertainty import (
    CameraDifference,
    camera_difference,
    projection_derivatives,
    projection_uncertainty,
    sensor_grid,
)
from calib.view import View

#: Coverage of the expanded uncertainty over the whole sensor.
_COVERAGE = 0.95
_DRAWS = 1000  # By chance, their quantile of 95 % is one of 93.6 % to 96.4 % (two sigma)
_POINTS_ACROSS = 17  # Of the grid of image points in which two cameras are compared
_REGIONS = 3  # Along each side: nine, as a photographer names them
_ROWS, _COLUMNS = ("top", "middle", "bottom"), ("left", "centre", "right")
#: Changes of the camera that a pose imitates to this share of their effect are not judged.
_UNSEEN = 1e-3
#: A point farther off than this many robust sigmas, after all changes are allowed, is a gross error: by chance, none
#: is.
_GROSS = 6.0
_MEDIAN_OF_NORMAL = 0.6745  # Median of |x| of a standard normal distribution
_LEAST_POINTS = 20  # Twice as many coordinates as a pose and a camera with eight coefficients have unknowns

#: Each half must determine a camera.
_MIN_VIEWS = 4


@on_one_thread
def check_camera(
    stated: CameraModel,
    stated_covariance: Array | None,
    seen_camera: CameraModel,
    found_covariance: Array,
    rng: np.random.Generator,
) -> CameraCheck:
    """Compare the camera of new views with a stated one, both with the same image size.

    Covariances are in the order of `CameraModel.parameter_names`; None is exact. The generator draws the changes that
    the uncertainties allow; the factor k follows from their largest ones.
    """
    require_image_size(stated, seen_camera.image_size, "these views have")
    grid = sensor_grid(seen_camera.image_size, _POINTS_ACROSS).reshape(-1, 2)
    offset = camera_difference(seen_camera, stated, _POINTS_ACROSS).offset_px.reshape(-1, 2)
    allowed, slope = np.zeros((_DRAWS, len(grid), 2)), np.zeros(0)
    for camera, covariance in ((stated, stated_covariance), (seen_camera, found_covariance)):
        derivatives, at = projection_derivatives(camera, _POINTS_ACROSS)
        slope = np.full((len(grid), 2, derivatives.shape[2]), np.nan)
        slope[at] = derivatives
        if covariance is not None:
            drawn = rng.multivariate_normal(np.zeros(len(covariance)), covariance, _DRAWS, method="eigh")
            allowed += np.einsum("pik,dk->dpi", slope, drawn)
    seen = np.isfinite(offset).all(axis=1) & np.isfinite(allowed[0]).all(axis=1)
    spread = np.sqrt((allowed[:, seen] ** 2).sum(axis=2).mean(axis=0))
    factor = float(np.quantile((np.linalg.norm(allowed[:, seen], axis=2) / spread).max(axis=1), _COVERAGE))
    length = np.linalg.norm(offset[seen], axis=1)
    return CameraCheck(
        _regions(grid[seen], length, factor * spread, seen_camera.image_size),
        float(np.sqrt(np.mean(length**2))),
        factor,
        _shares(seen_camera, slope[seen], offset[seen]),
    )


def _regions(
    places: Array, length: Array, expanded: Array, image_size: Sequence[int]
) -> tuple[RegionCheck, ...]:
    """Return the worst place of each of the nine parts of the sensor; a part without a ray is left out."""
    column, row = np.minimum((places / np.array(image_size) * _REGIONS).astype(int), _REGIONS - 1).T
    regions = []
    for number, (of_row, of_column) in enumerate(product(_ROWS, _COLUMNS)):
        here = np.flatnonzero(_REGIONS * row + column == number)
        if len(here):
            worst = here[np.argmax(length[here] / expanded[here])]
            x, y = places[worst].tolist()
            name = f"{of_row} {of_column}"
            regions.append(RegionCheck(name, (x, y), float(length[worst]), float(expanded[worst])))
    return tuple(regions)


def _shares(camera: CameraModel, slope: Array, offset: Array) -> dict[str, float]:
    """Return the share of the squared change that a change of one kind explains, by least squares."""
    flat, single = offset.ravel(), np.eye(len(camera.values))
    kinds = {"scale": _scaled(camera)[None], "principal point": single[2:4], "lens": single[4:]}
    shares = {}
    for kind, changes in kinds.items():
        if len(changes) and flat.any():
            basis = (slope @ changes.T).reshape(len(flat), -1)
            left = flat - basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]
            shares[kind] = 1.0 - float(left @ left) / float(flat @ flat)
    return shares


def _scaled(camera: CameraModel) -> Array:
    """Return the (K,) change of the parameters of a camera that is larger by a share."""
    return np.append([camera.fx, camera.fy], np.zeros(len(camera.values) - 2))


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
        return {"right": self.right, "one_view": True, **asdict(self), "seen_from": seen}


@on_one_thread
def check_one_view(camera: CameraModel, covariance: Array | None, view: View) -> OneViewCheck:
    """Check a stated camera by one view; covariance as `CameraModel.parameter_names`, None is exact.

    Raises DegenerateViews: If there are too few points, or the stated camera sees no plane target there.
    """
    require_image_size(camera, view.image_size, "this view has")
    # Stated covariances hold errors that neighbours share, too. Points of a file have none: unit covariances.
    least = 0.0 if (view.covariances_px2 == np.eye(2)).all() else 1.0
    view = view.part(np.asarray(np.isfinite(camera.rays(view.points_px)).all(axis=1)))
    seen = _Seen.of(camera, view)
    if (gross := seen.gross()).any():
        view = view.part(~gross)
        seen = _Seen.of(camera, view)
    return _judge(camera, covariance, view.points_px, seen, least)


@dataclass(frozen=True)
class _Seen:
    """Residuals of a view at its best pose, over their sigmas, and their derivatives by the camera's parameters."""

    residuals: Array  # (2 N,)
    columns: Array  # (2 N, K) without what a pose imitates
    basis: Array  # (2 N, d) orthonormal, of the changes that are judged
    whitening: Array  # (N, 2, 2)

    @classmethod
    def of(cls, camera: CameraModel, view: View) -> _Seen:
        if len(view) < _LEAST_POINTS:
            raise DegenerateViews(
                f"Cannot check by one view: {len(view)} usable points; at least {_LEAST_POINTS} are needed.",
                remedy="Record the target so that it fills more of the image.",
            )
        bundle = Bundle(Observations.from_views([view]), camera.parameter_names, free_centres=True)
        start = pose_start(camera, view)
        refined = refine(replace(bundle, names=()), start, Loss("l2")) if start else None
        if refined is None or not refined.converged:
            raise DegenerateViews("The stated camera does not see these points on a plane before it.")
        posed = refined.parameters
        residuals, slopes = bundle.linearised(posed)
        rows = slopes.transpose(2, 1, 0).reshape(-1, len(camera.values) + 6)
        by_camera, by_pose = rows[:, :-6], rows[:, -6:]
        pose = np.linalg.qr(by_pose)[0]
        columns = by_camera - pose @ (pose.T @ by_camera)
        residuals = residuals.ravel() - pose @ (pose.T @ residuals.ravel())
        whole = np.linalg.norm(by_camera, axis=0)
        left, sizes, _ = np.linalg.svd(columns / whole, full_matrices=False)
        return cls(residuals, columns, left[:, sizes > _UNSEEN], bundle.observations.whitening)

    def gross(self) -> Bools:
        """Return (N,) which points lie far off whatever the camera and the pose are."""
        over = self.residuals - self.basis @ (self.basis.T @ self.residuals)
        sigma = float(np.median(np.abs(over))) / _MEDIAN_OF_NORMAL
        return np.asarray(np.linalg.norm(over.reshape(-1, 2), axis=1) > _GROSS * max(sigma, 1e-12))


def _judge(
    camera: CameraModel, covariance: Array | None, points: Array, seen: _Seen, least: float
) -> OneViewCheck:
    """Tell whether a change of the camera explains more than noise and covariance do.

    T^2 = a^T (noise I + M C M^T)^-1 a (Hotelling, 1931), with the part a of the residuals along the d changes that are
    judged, the covariance C of the camera, and M its effect along these; limit: d times the quantile of F(d, freedom).

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
    limit = len(along) * float(fdtri(len(along), freedom, _COVERAGE))
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
    single = dict(zip(camera.parameter_names, np.eye(len(camera.values)), strict=True))
    limits = {}
    for kind, change in {"scale": _scaled(camera), **single}.items():
        squares = float(moved @ change @ inverse @ (moved @ change))
        if kind not in PINHOLE[:2]:
            limits[kind] = float(np.sqrt(limit / squares)) if squares > 0 else np.inf
    return limits


@dataclass(frozen=True)
class SplitHalf:
    """How two calibrations of one camera differ, at infinity."""

    difference: CameraDifference
    # Root mean square difference over the sensor that their uncertainties let expect, px.
    expected_px: float

    @property
    def ratio(self) -> float:
        """Difference found over difference expected: 1 or below if the uncertainties are right.

        Below 1 where both halves have an error in common, such as that of the collimator, which their difference lacks.
        """
        return self.difference.rms_px / self.expected_px


def split_half(views: Sequence[View], options: CalibrationOptions | None = None) -> SplitHalf:
    """Calibrate every other view of at least 4, and the rest, and compare.

    Own statistic: the expected difference is the root of the mean of s1^2 + s2^2 over the sensor, with the projection
    uncertainties s1 and s2. Each half must constrain the camera.
    """
    if len(views) < _MIN_VIEWS:
        raise DegenerateViews(f"{len(views)} views; two halves need at least {_MIN_VIEWS}.")
    first, second = (calibrate(views[begin::2], _every_other(options, begin)) for begin in (0, 1))
    maps = [projection_uncertainty(half.camera, half.camera_covariance).sigma_px for half in (first, second)]
    expected = float(np.sqrt(np.nanmean(maps[0] ** 2 + maps[1] ** 2)))
    return SplitHalf(camera_difference(first.camera, second.camera), expected)


def _every_other(options: CalibrationOptions | None, begin: int) -> CalibrationOptions | None:
    """Return the options for every other view: the gimbal's readings are those of these views."""
    if options is None or options.gimbal is None:
        return options
    return replace(options, gimbal=options.gimbal.part(range(begin, len(options.gimbal.angles_deg), 2)))
